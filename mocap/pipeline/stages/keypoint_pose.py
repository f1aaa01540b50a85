"""Pose from keypoints: from the figures of persons to their poses and tracks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mocap.body import load_body_model, scale_body
from mocap.body.keypoints import place_keypoints
from mocap.data import CameraRig, Tracks
from mocap.data.keypoints import N_KEYPOINTS
from mocap.io.session import Session
from mocap.io.store import StageStore
from mocap.likelihood.keypoints import KeypointViews
from mocap.likelihood.markers import MarkerViews, marker_views, undistort
from mocap.pipeline.config import Config
from mocap.pipeline.pose_settings import pose_settings
from mocap.pipeline.stage import ClipWork, Job, Stage, StageReport
from mocap.pipeline.stages.pose import poses_report
from mocap.pose.evidence import PersonTools
from mocap.pose.keypoint import ViewsOf
from mocap.pose.keypoint_person import PersonKeypoints, follow_keypoints
from mocap.pose.marker_person import flesh_centroids
from mocap.pose.result import PersonPoses
from mocap.products import keypoints as keypoints_product
from mocap.products import poses as poses_product
from mocap.products import tracks as tracks_product
from mocap.products.keypoints import persons_in
from mocap.products.poses import store_poses
from mocap.products.tracks import stored_tracks, track_row
from mocap.tracking.figures import FigureSettings, View2D, deviation_px


def keypoint_pose_stage(job: Job) -> None:
    """Poses and tracks of all persons whose keypoints two views or more agree on."""
    session, config = job.session, job.config
    frames = persons_in(job.store.reader(keypoints_product.PRODUCT))
    model = config.body_model("keypoints")
    n_total = sum(own[-1] - own[0] + 1 for own in frames.values())
    done = 0

    def tick(n: int) -> None:
        nonlocal done
        done += n
        job.progress("pose", done, n_total)

    results = []
    for person, own in frames.items():
        seen = PersonKeypoints(
            person, np.arange(own[0], own[-1] + 1), views_of_person(session, config, job.store, person)
        )
        found = follow_keypoints(
            seen,
            lambda height_m: person_tools(config, session.fps, height_m),
            height_m=config.body.height_m or load_body_model(model).height_m or session.person_height_m,
            seed=job.seed,
            progress=tick,
        )
        results += [] if found is None else [found]
    tracks = _tracks_of(results, session.fps)
    with job.writer(tracks_product.PRODUCT) as out:
        for frame in session.frames:
            out.append(frame, **track_row(tracks, frame))
    store_poses(job.store, job.key, model, results)


def person_tools(config: Config, fps: float, height_m: float) -> PersonTools:
    """Body and settings of one person of some height who is seen by keypoints."""
    body = scale_body(load_body_model(config.body_model("keypoints")), height_m)
    return PersonTools(body, fps, pose_settings(config.pose, config.method, body.layout), 1)


def views_of_person(session: Session, config: Config, store: StageStore, person: int) -> ViewsOf:
    """frame -> what the cameras say of a person, with the deviation of every keypoint at the person's distance."""
    reader = store.reader(keypoints_product.PRODUCT)
    views, slack_m = marker_views(session.rig), keypoint_slack_m(config)

    @lru_cache(maxsize=256)
    def views_of(frame: int) -> KeypointViews | None:
        arrays = reader.read(frame)
        at = np.flatnonzero(arrays["points_person"] == person)
        if not len(at):
            return None
        middle = np.nanmean(arrays["points"][at[0]], axis=0)
        own = [figure_at(arrays, int(i), session.rig) for i in np.flatnonzero(arrays["person"] == person)]
        return person_views(own, middle, views, slack_m)

    return views_of


def keypoint_slack_m(config: Config) -> NDArray[np.float64]:
    """How far every keypoint moves against its segment, (K,) m."""
    body = scale_body(load_body_model(config.body_model("keypoints")), 1.0)
    return place_keypoints(body).slack_m


def figure_at(arrays: Mapping[str, NDArray[Any]], i: int, rig: CameraRig) -> View2D:
    """A figure of a frame of the product, undistorted."""
    c = int(arrays["camera"][i])
    return View2D(c, undistort(rig[c], arrays["uv"][i]), arrays["confidence"][i])


def person_views(
    figures: Sequence[View2D], place: NDArray[np.float64], views: MarkerViews, slack_m: NDArray[np.float64]
) -> KeypointViews:
    """What the figures of a person at a place (3,) m say, with the deviation of every keypoint there."""
    uv, noise = np.full((views.n_views, N_KEYPOINTS, 2), np.nan), np.ones((views.n_views, N_KEYPOINTS))
    for f in figures:
        c = f.camera
        depth, focal = float(views.P[c, 2, :3] @ place + views.P[c, 2, 3]), float(views.focal[c])
        uv[c] = f.uv
        own = deviation_px(FigureSettings(), f.confidence, depth, focal)
        noise[c] = np.hypot(own, slack_m * focal / max(depth, 0.1))
    return KeypointViews(views.P, uv, noise)


def _tracks_of(results: list[PersonPoses], fps: float) -> Tracks:
    """The persons' paths: centres of their flesh."""
    frame = np.concatenate([np.zeros(0, dtype=np.int64), *(p.frames for p in results)])
    person: NDArray[np.int64] = np.concatenate(
        [np.zeros(0, dtype=np.int64), *(np.full(len(p.frames), p.person, dtype=np.int64) for p in results)]
    )
    xyz = np.concatenate([np.zeros((0, 3)), *(flesh_centroids(p.body, p.states) for p in results)])
    order = np.lexsort((person, frame))
    return Tracks(frame[order], person[order], frame[order] / fps, xyz[order])


def keypoint_pose_report(job: Job) -> StageReport:
    """What the poses say of themselves, and advice where nobody was found."""
    report = poses_report(job)
    n = len(stored_tracks(job.store, job.session.fps).persons)
    return StageReport((*(() if n else (_NOBODY,)), *report.warnings), {"n_persons": n, **report.numbers})


_NOBODY = (
    "nobody was found in the keypoints: no two views agree on a person. Remedy: check that keypoints and calibration "
    "are of the same cameras, frames and resolution"
)
KEYPOINT_POSE = Stage(
    name="pose",
    until="pose",
    products=(tracks_product.PRODUCT, poses_product.PRODUCT),
    work=ClipWork(keypoint_pose_stage),
    report=keypoint_pose_report,
    needs=("keypoints",),
    sections=("body", "pose", "method"),
    facts=("fps", "person_height_m"),
    is_random=lambda config: True,
)
