"""Pose from markers: from detections to the poses and the track of the person who wears them."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from mocap.body import load_body_model
from mocap.data import Tracks
from mocap.likelihood.markers import MarkerObservation, marker_views, observe
from mocap.pipeline.pose_settings import make_marker_tools
from mocap.pipeline.stage import ClipWork, Job, Stage, StageReport
from mocap.pipeline.stages.pose import poses_report
from mocap.pose.marker_person import flesh_centroids, follow_markers
from mocap.pose.result import PersonPoses
from mocap.products import detections as detections_product
from mocap.products import poses as poses_product
from mocap.products import tracks as tracks_product
from mocap.products.detections import detections_from_arrays
from mocap.products.poses import store_poses
from mocap.products.tracks import stored_tracks, track_row


def marker_pose_stage(job: Job) -> None:
    """Poses of the person who wears the markers, and its track, into the store.

    One person per session: a second one is not followed, and a warning says so.
    Source: CF 6.4.
    """
    session, config = job.session, job.config
    reader = job.store.reader(detections_product.PRODUCT)
    views = marker_views(session.rig)

    @lru_cache(maxsize=128)
    def observation_of(frame: int) -> MarkerObservation:
        return observe(views, detections_from_arrays(reader.read(frame), len(session.rig)))

    found = follow_markers(
        session.frames,
        observation_of,
        lambda height_m: make_marker_tools(config, session.fps, height_m),
        height_m=config.body.height_m
        or load_body_model(config.body_model("markers")).height_m
        or session.person_height_m,
        seed=job.seed,
        is_fitted=config.body.marker_offsets == "fit",
        progress=lambda done, total: job.progress("pose", done, total),
    )
    tracks = _track_of(found, session.fps)
    with job.writer(tracks_product.PRODUCT) as out:
        for frame in session.frames:
            out.append(frame, **track_row(tracks, frame))
    store_poses(job.store, job.key, config.body_model("markers"), [] if found is None else [found])


def marker_pose_report(job: Job) -> StageReport:
    """What the poses say of themselves, and advice where nobody was found."""
    report = poses_report(job)
    n = len(stored_tracks(job.store, job.session.fps).persons)
    return StageReport((*(() if n else (_NOBODY,)), *report.warnings), {"n_persons": n, **report.numbers})


def _track_of(poses: PersonPoses | None, fps: float) -> Tracks:
    """The person's path: centre of its flesh."""
    if poses is None:
        return Tracks(np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64), np.zeros(0), np.zeros((0, 3)))
    person = np.full(len(poses.frames), poses.person, dtype=np.int64)
    return Tracks(poses.frames, person, poses.frames / fps, flesh_centroids(poses.body, poses.states))


_NOBODY = (
    "no person was found in the detections. Remedy: look at the detections in the report; the cameras "
    "must agree on some markers, and the calibration must be that of the detections"
)
MARKER_POSE = Stage(
    name="pose",
    until="pose",
    products=(tracks_product.PRODUCT, poses_product.PRODUCT),
    work=ClipWork(marker_pose_stage),
    report=marker_pose_report,
    needs=("detect",),
    sections=("body", "pose", "method", "markers"),
    facts=("fps", "person_height_m"),
    is_random=lambda config: True,
)
