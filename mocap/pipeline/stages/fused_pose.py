"""Pose from volumes and keypoints together: from hulls, tracks and figures to poses in the store."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from functools import lru_cache
from threading import Lock

from mocap.data import Tracks
from mocap.io.session import Session
from mocap.io.store import StageStore
from mocap.likelihood.keypoints import KeypointViews
from mocap.likelihood.markers import marker_views
from mocap.pipeline.config import Config
from mocap.pipeline.edits.meaning import edited_tracks
from mocap.pipeline.stage import ClipWork, Job, Stage
from mocap.pipeline.stages.keypoint_pose import figure_at, keypoint_slack_m, person_views
from mocap.pipeline.stages.keypoints import figure_views
from mocap.pipeline.stages.known import known_in_pictures
from mocap.pipeline.stages.pose import poses_report, solve_poses
from mocap.pose.fused import FusedObservation, ViewsOf
from mocap.pose.volume import HullOf, VolumeObservation, VolumeTools
from mocap.products import followed as followed_product
from mocap.products import keypoints as keypoints_product
from mocap.products import poses as poses_product
from mocap.tracking.figures import FigureSettings, figures_of_places


def fused_pose_stage(job: Job) -> None:
    """Poses of every tracked person from its hulls and its keypoints into the store."""
    tracks = edited_tracks(job.store, job.session, job.config.edits)
    known, fault = known_in_pictures(job)
    # Keypoints of another clip or time have no say in the poses either.
    views_of = views_of_tracks(job.session, job.config, job.store, tracks) if fault is None else _nothing

    def both(tools: VolumeTools, hull_of: HullOf, person: int) -> VolumeObservation:
        return FusedObservation(tools, hull_of, views_of=views_of(person))

    # Figures are shared out among all who are there.
    everybody = hashlib.sha256(tracks.frame.tobytes() + tracks.person.tobytes()).hexdigest()
    solve_poses(job, both, everybody, known)


def _nothing(_person: int) -> ViewsOf:
    return lambda frame: None


def views_of_tracks(
    session: Session, config: Config, store: StageStore, tracks: Tracks
) -> Callable[[int], ViewsOf]:
    """person -> frame -> what the cameras' keypoints say of it: figures go to the track that they surround."""
    reader, views = store.reader(keypoints_product.PRODUCT), marker_views(session.rig)
    slack_m, reading = keypoint_slack_m(config), Lock()  # persons are followed on threads of their own

    @lru_cache(maxsize=64)
    def of_frame(frame: int) -> dict[int, KeypointViews]:
        with reading:
            arrays = reader.read(frame)
        figures = [figure_at(arrays, i, session.rig) for i in range(len(arrays["camera"]))]
        here = tracks.frame == frame
        persons, places = tracks.person[here].tolist(), tracks.xyz[here]
        given = figures_of_places(figures, places, figure_views(views), FigureSettings())
        return {
            person: person_views([figures[i] for i in own], place, views, slack_m)
            for person, place, own in zip(persons, places, given, strict=True)
            if own
        }

    return lambda person: lambda frame: of_frame(frame).get(person)


FUSED_POSE = Stage(
    name="pose",
    until="pose",
    products=(followed_product.PRODUCT, poses_product.PRODUCT),
    work=ClipWork(fused_pose_stage),
    report=poses_report,
    needs=("track", "keypoints"),
    sections=("body", "likelihood", "pose", "method", "edits"),
    facts=("fps", "person_height_m"),
    is_random=lambda config: True,
)
