"""Detection of markers: from files or pictures to the store."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mocap.data.detections import Detections
from mocap.errors import MocapError
from mocap.foreground.marker_detector import (
    MarkerColour,
    MarkerDetectorSettings,
    detect_markers,
    learn_marker_colour,
)
from mocap.io.detections import LABELS_FILE, read_marker_labels
from mocap.io.session import Session
from mocap.io.session.reading import detections_of, pictures_of
from mocap.pipeline.config import MarkersConfig
from mocap.pipeline.stage import (
    Ending,
    FrameWork,
    Job,
    Row,
    Seen,
    Sources,
    Stage,
    StageReport,
)
from mocap.products.detections import PRODUCT, detection_row

_FEW_DETECTIONS = 4.0  # per picture, on average: less is no marker set


@dataclass(frozen=True, eq=False)
class _Detecting:
    """given : detections that are taken over; else colour and settings say how to find them."""

    settings: MarkerDetectorSettings
    given: Detections | None = None
    colour: MarkerColour | None = None


def _reads(job: Job) -> Sources:
    return {} if job.session.detection_sources else {"pictures": pictures_of(job.session)}


def _start(job: Job) -> _Detecting:
    session, config = job.session, job.config.markers
    settings = MarkerDetectorSettings(
        mahalanobis=config.mahalanobis, min_area_px=config.min_area_px, max_area_px=config.max_area_px
    )
    if session.detection_sources:
        given = detections_of(session)
        return _Detecting(settings, given=given)
    if not session.image_sources:
        raise MocapError(
            "markers cannot be detected without pictures",
            path=session.root,
            remedy="add videos/ or images/, or detections/CAM.csv",
        )
    return _Detecting(settings, colour=_learnt_colour(session, config))


def _step(state: _Detecting, seen: Seen) -> tuple[_Detecting, Seen, Sequence[Row]]:
    if state.given is not None:
        found = state.given.at(seen.frame)
    else:
        assert seen.pictures is not None
        assert state.colour is not None
        found = [detect_markers(image, state.colour, state.settings) for image in seen.pictures]
    return state, seen, [Row(PRODUCT, seen.frame, detection_row(found))]


def _finish(state: _Detecting) -> Ending:
    if state.colour is None:
        return Ending(attrs={PRODUCT: {"source": "detections"}})
    attrs = {
        "source": "colour",
        "cr_cb": np.round(state.colour.mean, 2).tolist(),
        "covariance": np.round(state.colour.covariance, 2).tolist(),
    }
    return Ending(attrs={PRODUCT: attrs})


def labels_path(session: Session) -> Path:
    """The file of labelled markers, which need not be there."""
    return session.root / LABELS_FILE


def _learnt_colour(session: Session, config: MarkersConfig) -> MarkerColour:
    """The markers' colour from the labelled pictures."""
    path = labels_path(session)
    labels = read_marker_labels(path, session.rig)
    frames = sorted({int(f) for frame, _ in labels.values() for f in frame})
    # On clocks of their own the clips are known up to the last frame that is worked on.
    n_frames = session.frames.stop if session.clip_frames else min(c.n_frames for c in session.clips.values())
    images, points = [], []
    for frame in frames:
        if frame >= n_frames:
            raise MocapError(
                f"the labels are of frame {frame}, but the clips have {n_frames} frames",
                path=path,
                frame=frame,
                remedy="label a frame of these clips",
            )
        with pictures_of(session, range(frame, frame + 1)) as reader:
            _, pictures = next(iter(reader))
        for camera, picture in zip(session.rig, pictures, strict=True):
            if camera.name in labels:
                of_frame, uv = labels[camera.name]
                images.append(picture)
                points.append(uv[of_frame == frame])
    try:
        return learn_marker_colour(images, points, radius_px=config.label_radius_px)
    except ValueError as error:
        raise MocapError(
            f"the markers' colour cannot be learnt: {error}",
            path=path,
            remedy="label more markers, or raise markers.label_radius_px",
        ) from error


def detect_report(job: Job) -> StageReport:
    """Warnings about cameras that see few markers."""
    session, reader = job.session, job.store.reader(PRODUCT)
    counts = np.array([np.bincount(a["camera"], minlength=len(session.rig)) for _, a in reader])
    mean = counts.mean(axis=0)
    warnings = [
        f"camera {camera.name}: {mean[c]:.1f} detections per picture; few markers are seen there"
        for c, camera in enumerate(session.rig)
        if mean[c] < _FEW_DETECTIONS
    ]
    numbers: dict[str, float | int | str] = {
        "source": reader.attrs["source"],
        "mean_detections_per_picture": round(float(mean.mean()), 2),
    }
    return StageReport(tuple(warnings), numbers)


DETECT = Stage(
    name="detect",
    until="segment",
    products=(PRODUCT,),
    # Marker detections of every frame: taken over, or found by their colour. Source: CF 6.4.1.1, 6.6.2.
    work=FrameWork(_reads, _start, _step, _finish),
    report=detect_report,
    sections=("markers",),
)
