"""Keypoints: from files of other tools to the figures of persons, associated over views and time, in the store."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from mocap.data.camera import CameraRig
from mocap.data.keypoints import Figures
from mocap.io.session import Session
from mocap.io.session.reading import keypoints_of
from mocap.likelihood.markers import MarkerViews, marker_views, undistort
from mocap.pipeline.stage import ClipWork, Job, Stage, StageReport
from mocap.products.keypoints import PRODUCT, keypoint_row, persons_in
from mocap.tracking.figure_faults import (
    Clip,
    FaultSettings,
    FigureFault,
    find_figure_faults,
    without_pictures,
)
from mocap.tracking.figures import FigurePerson, FigureSettings, FigureViews, View2D, persons_of_figures
from mocap.tracking.lone import lone_persons

# A camera that shows nobody in so many frames adds little, or its files are of another clip.
_FEW_FIGURES = 0.6


def keypoint_stage(job: Job) -> None:
    """The figures of all frames, with the persons that they are of.

    It needs the whole clip: who is there too briefly is nobody.
    """
    session = job.session
    read = keypoints_of(session)
    persons, faults = persons_of_keypoints(session, read, session.frames)
    attrs = {
        "faults": [f"{fault.message}. Remedy: {fault.remedy}" for fault in faults],
        "is_mirrored": any(fault.is_mirrored for fault in faults),
    }
    with job.writer(PRODUCT, attrs) as out:
        for i, frame in enumerate(session.frames):
            of = np.zeros(len(read[frame]), dtype=np.int64)
            for person in persons:
                chosen = person.views.get(frame, np.zeros(0, dtype=np.int64))
                of[chosen[chosen >= 0]] = person.number
            points = {p.number: p.points[frame] for p in persons if frame in p.points}
            out.append(frame, **keypoint_row(read[frame], of, points))
            job.progress("keypoints", i + 1, len(session.frames))


def persons_of_keypoints(
    session: Session, read: Mapping[int, Figures], frames: Sequence[int]
) -> tuple[list[FigurePerson], list[FigureFault]]:
    """The persons of some frames of a session, numbered from 1, and what is wrong with the keypoints.

    read : frame -> its figures, as of `keypoints_of`.
    """
    views, settings = figure_views(marker_views(session.rig)), FigureSettings()
    figures = {frame: undistorted(read[frame], session.rig) for frame in frames}
    persons = persons_of_figures(figures, views, session.fps, settings)
    faults = find_figure_faults(
        Clip(figures, persons, views, session.rig.names, session.fps, settings, FaultSettings())
    )
    persons = without_pictures(persons, faults)
    strange = [fault.camera for fault in faults if fault.is_unexplained and fault.camera is not None]
    lone = lone_persons(figures, persons, strange, views, session.fps)
    return [*persons, *lone.values()], [_of_lone(fault, lone, session.rig) for fault in faults]


def _of_lone(fault: FigureFault, lone: Mapping[int, FigurePerson], rig: CameraRig) -> FigureFault:
    """What is said of a camera that shows somebody whom no other camera shows, where that is a person."""
    person = lone.get(-1 if fault.camera is None else fault.camera)
    if person is None or not fault.is_unexplained:
        return fault
    return FigureFault(
        f"camera {rig.names[fault.camera or 0]} shows somebody whom no other camera shows: person {person.number} is "
        "followed by this camera alone, its place is known from where the feet stand only",
        "detect all persons in all pictures; where there is no such person, the keypoints are of another camera, clip "
        "or calibration",
        fault.camera,
    )


def figure_views(views: MarkerViews) -> FigureViews:
    """What the association needs of the cameras."""
    return FigureViews(views.P, views.focal)


def undistorted(figures: Figures, rig: CameraRig) -> list[View2D]:
    """The figures of one frame as ideal pinholes would see them."""
    return [
        View2D(int(c), undistort(rig[int(c)], figures.uv[i]), figures.confidence[i])
        for i, c in enumerate(figures.camera)
    ]


def keypoint_report(job: Job) -> StageReport:
    """How many persons there are, and which cameras hardly contribute."""
    session, reader = job.session, job.store.reader(PRODUCT)
    rows = list(reader)
    frames = persons_in(rows)
    n_figures, n_used = np.zeros(len(session.rig)), np.zeros(len(session.rig))
    for _, arrays in rows:
        np.add.at(n_figures, arrays["camera"].astype(np.int64), 1)
        np.add.at(n_used, arrays["camera"][arrays["person"] > 0].astype(np.int64), 1)
    numbers = {
        "n_persons": len(frames),
        "figures_per_picture": round(float(n_figures.sum() / max(1, len(rows) * len(session.rig))), 2),
        "figures_of_persons_percent": round(100.0 * float(n_used.sum() / max(1.0, n_figures.sum())), 1),
    }
    share = n_figures / max(len(rows), 1)
    seldom = np.flatnonzero(share < _FEW_FIGURES)
    warnings = []
    if len(seldom):
        names = ", ".join(session.rig.names[c] for c in seldom)
        what = f"camera{'s' * (len(seldom) > 1)} {names}: keypoints/ has somebody in"
        warnings = [f"{what} {100 * share[seldom].min():.0f} % of the frames only"]
    return StageReport((*reader.attrs["faults"], *warnings), numbers)


KEYPOINTS_STAGE = Stage(
    name="keypoints",
    until="segment",
    products=(PRODUCT,),
    work=ClipWork(keypoint_stage),
    report=keypoint_report,
    facts=("fps",),
)
