"""Keypoints: from files of other tools to the figures of persons, associated over views and time, in the store."""

from __future__ import annotations

import numpy as np

from mocap.data.camera import CameraRig
from mocap.data.keypoints import Figures
from mocap.io.session.reading import keypoints_of
from mocap.likelihood.markers import MarkerViews, marker_views, undistort
from mocap.pipeline.stage import ClipWork, Job, Stage, StageReport
from mocap.products.keypoints import PRODUCT, keypoint_row, persons_in
from mocap.tracking.figure_faults import Clip, FaultSettings, find_figure_faults, without_pictures
from mocap.tracking.figures import FigureSettings, FigureViews, View2D, persons_of_figures

# A camera that shows nobody in so many frames adds little, or its files are of another clip.
_FEW_FIGURES = 0.6


def keypoint_stage(job: Job) -> None:
    """The figures of all frames, with the persons that they are of.

    It needs the whole clip: who is there too briefly is nobody.
    """
    session, views = job.session, marker_views(job.session.rig)
    read = keypoints_of(session)
    figures = {frame: undistorted(read[frame], session.rig) for frame in session.frames}
    settings = FigureSettings()
    persons = persons_of_figures(figures, figure_views(views), session.fps, settings)
    clip = Clip(
        figures, persons, figure_views(views), session.rig.names, session.fps, settings, FaultSettings()
    )
    faults = find_figure_faults(clip)
    persons = without_pictures(persons, faults)
    attrs = {"faults": [f"{fault.message}. Remedy: {fault.remedy}" for fault in faults]}
    with job.writer(PRODUCT, attrs) as out:
        for i, frame in enumerate(session.frames):
            own = figures[frame]
            of = np.zeros(len(own), dtype=np.int64)
            for person in persons:
                chosen = person.views.get(frame, np.zeros(0, dtype=np.int64))
                of[chosen[chosen >= 0]] = person.number
            points = {p.number: p.points[frame] for p in persons if frame in p.points}
            out.append(frame, **keypoint_row(read[frame], of, points))
            job.progress("keypoints", i + 1, len(session.frames))


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
    seldom = n_figures < _FEW_FIGURES * len(rows)
    warnings = [
        f"camera {name}: keypoints/ has somebody in {100 * n_figures[c] / len(rows):.0f} % of the frames only"
        for c, name in enumerate(session.rig.names)
        if seldom[c]
    ]
    return StageReport((*reader.attrs["faults"], *warnings), numbers)


KEYPOINTS_STAGE = Stage(
    name="keypoints",
    until="segment",
    products=(PRODUCT,),
    work=ClipWork(keypoint_stage),
    report=keypoint_report,
    facts=("fps",),
)
