"""Marker observation: detections from files or pictures, and poses from detections, in the store."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mocap.body import load_body_model, scale_body
from mocap.body.markers import load_marker_set, place_markers
from mocap.data import Tracks
from mocap.data.detections import Detections
from mocap.errors import MocapError
from mocap.foreground.marker_detector import (
    MarkerColour,
    MarkerDetectorSettings,
    detect_markers,
    learn_marker_colour,
)
from mocap.io.detections import LABELS_FILE, read_detections, read_marker_labels
from mocap.io.session import Session
from mocap.io.store import StageStore, StageWriter
from mocap.io.video import FrameReader
from mocap.likelihood.markers import MarkerObservation, marker_views, observe
from mocap.pipeline.config import Config, MarkersConfig
from mocap.pipeline.markers import flesh_centroids, follow_markers
from mocap.pipeline.pose import PersonPoses
from mocap.pipeline.pose_settings import check_filter
from mocap.pipeline.stages.pose import store_poses
from mocap.pipeline.stages.report import Progress, StageReport

Array = NDArray[np.float64]

_FEW_DETECTIONS = 4.0  # per picture, on average: less is no marker set


def observation_kind(session: Session, config: Config) -> str:
    """`markers` or `voxels`: what the configuration asks for, or what the session offers.

    Raises MocapError when the session has nothing for what is asked for.
    """
    if config.observation == "voxels" or (config.observation == "auto" and not session.detection_sources):
        if not session.image_sources and not session.mask_sources:
            raise MocapError(
                "the session has marker detections alone: there is no volume to work on",
                path=session.root,
                remedy="use --observation markers, or add videos/, images/ or masks/",
            )
        return "voxels"
    if not session.detection_sources and not _labels_path(session).exists():
        raise MocapError(
            "the session has neither marker detections nor labels to learn the markers' colour from",
            path=session.root,
            remedy=f"add detections/CAM.csv, or videos and {LABELS_FILE} (frame,camera,u_px,v_px)",
        )
    return "markers"


def check_marker_config(config: Config) -> None:
    """The marker set against the body, and the filter against the likelihood, before any work is done."""
    body = scale_body(load_body_model(config.body_model("markers")), 1.0)
    place_markers(load_marker_set(config.body.marker_set), body)
    check_filter(config.pose, "markers", factorised=config.markers.factorised)


def marker_inputs(session: Session) -> list[Path]:
    """Files that the detections come from, besides the pictures."""
    labels = _labels_path(session)
    files = [session.detection_sources[name] for name in sorted(session.detection_sources)]
    return files if files or not labels.exists() else [labels]


def detect_stage(
    session: Session, config: Config, store: StageStore, key: str, *, progress: Progress
) -> None:
    """Marker detections of every frame into the store: taken over from detections/, or found by their colour.

    Store: per frame `uv` (n, 2) float64 raw px and `camera` (n,) uint16, the index in the rig.
    Source: CF 6.4.1.1, 6.6.2.
    """
    frames, n = session.frames, len(session.frames)
    if session.detection_sources:
        found = read_detections(session.detection_sources, session.rig, frames)
        with store.writer("detect", key, {"source": "detections"}) as out:
            for i, frame in enumerate(frames):
                _append(out, frame, found.at(frame))
                progress("detect", i + 1, n)
        return
    if not session.image_sources:
        raise MocapError(
            "markers cannot be detected without pictures",
            path=session.root,
            remedy="add videos/ or images/, or detections/CAM.csv",
        )
    colour = _learnt_colour(session, config.markers)
    settings = MarkerDetectorSettings(
        mahalanobis=config.markers.mahalanobis,
        min_area_px=config.markers.min_area_px,
        max_area_px=config.markers.max_area_px,
    )
    attrs = {
        "source": "colour",
        "cr_cb": np.round(colour.mean, 2).tolist(),
        "covariance": np.round(colour.covariance, 2).tolist(),
    }
    with (
        store.writer("detect", key, attrs) as out,
        FrameReader(session.image_sources, session.rig, frames) as images_of,
    ):
        for i, (frame, images) in enumerate(images_of):
            _append(out, frame, [detect_markers(image, colour, settings) for image in images])
            progress("detect", i + 1, n)


def _append(out: StageWriter, frame: int, detections: list[Array]) -> None:
    camera = np.repeat(np.arange(len(detections)), [len(uv) for uv in detections])
    out.append(frame, uv=np.concatenate(detections).reshape(-1, 2), camera=camera.astype(np.uint16))


def _labels_path(session: Session) -> Path:
    return session.root / LABELS_FILE


def _learnt_colour(session: Session, config: MarkersConfig) -> MarkerColour:
    """The markers' colour from the labelled pictures."""
    path = _labels_path(session)
    labels = read_marker_labels(path, session.rig)
    frames = sorted({int(f) for frame, _ in labels.values() for f in frame})
    n_frames = min(clip.n_frames for clip in session.clips.values())
    images, points = [], []
    for frame in frames:
        if frame >= n_frames:
            raise MocapError(
                f"the labels are of frame {frame}, but the clips have {n_frames} frames",
                path=path,
                frame=frame,
                remedy="label a frame of these clips",
            )
        with FrameReader(session.image_sources, session.rig, range(frame, frame + 1)) as reader:
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


def detections_at(store: StageStore, session: Session, frame: int) -> list[Array]:
    """Detections of one frame from the store, one (n, 2) array of raw pixels per camera."""
    return _split(store.reader("detect").read(frame), len(session.rig))


def _split(arrays: dict[str, NDArray[np.generic]], n_cameras: int) -> list[Array]:
    camera, uv = arrays["camera"], arrays["uv"].astype(np.float64, copy=False)
    return [uv[camera == c] for c in range(n_cameras)]


def stored_detections(store: StageStore, session: Session) -> Detections:
    """All detections from the store."""
    frame: list[list[int]] = [[] for _ in session.rig]
    uv: list[list[Array]] = [[] for _ in session.rig]
    for f, arrays in store.reader("detect"):
        for c, found in enumerate(_split(arrays, len(session.rig))):
            frame[c] += [f] * len(found)
            uv[c].append(found)
    return Detections(
        session.rig.names,
        tuple(np.array(f, dtype=np.int64) for f in frame),
        tuple(np.concatenate([np.zeros((0, 2)), *u]) for u in uv),
    )


def detect_report(store: StageStore, session: Session) -> StageReport:
    """Warnings about cameras that see few markers."""
    reader = store.reader("detect")
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


def marker_pose_stage(
    session: Session, config: Config, store: StageStore, key: str, *, seed: int, progress: Progress
) -> None:
    """Poses of the person who wears the markers, and its track, into the store.

    One person per session: a second one is not followed, and a warning says so.
    Source: CF 6.4.
    """
    reader = store.reader("detect")
    views = marker_views(session.rig)

    @lru_cache(maxsize=128)
    def observation_of(frame: int) -> MarkerObservation:
        return observe(views, _split(reader.read(frame), len(session.rig)))

    found = follow_markers(
        session.frames,
        observation_of,
        session.fps,
        config,
        height_m=config.body.height_m
        or load_body_model(config.body_model("markers")).height_m
        or session.person_height_m,
        seed=seed,
        progress=lambda done, total: progress("pose", done, total),
    )
    results: list[PersonPoses] = [] if found is None else [found]
    tracks = _track_of(found, session.fps)
    with store.writer("track", key, {}) as out:
        for frame in session.frames:
            rows = tracks.frame == frame
            out.append(frame, person=tracks.person[rows], xyz=tracks.xyz[rows])
    store_poses(store, key, config.body_model("markers"), results)


def _track_of(poses: PersonPoses | None, fps: float) -> Tracks:
    """The person's path: centre of its flesh."""
    if poses is None:
        return Tracks(np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64), np.zeros(0), np.zeros((0, 3)))
    person = np.full(len(poses.frames), poses.person, dtype=np.int64)
    return Tracks(poses.frames, person, poses.frames / fps, flesh_centroids(poses.body, poses.states))
