"""Pose from keypoints: from the figures of persons to their poses and tracks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mocap.body import Body, load_body_model, scale_body
from mocap.body.keypoints import place_keypoints
from mocap.data import CameraRig, Tracks
from mocap.data.keypoints import KEYPOINTS, N_KEYPOINTS
from mocap.io.session import Session
from mocap.io.store import StageStore
from mocap.likelihood.keypoints import KeypointViews
from mocap.likelihood.markers import MarkerViews, marker_views, undistort
from mocap.pipeline.config import Config
from mocap.pipeline.edits.followed import solve_persons
from mocap.pipeline.pose_settings import pose_settings, stated_height_m
from mocap.pipeline.stage import ClipWork, Job, Stage, StageReport
from mocap.pipeline.stages.pose import poses_report, tracks_of_flesh
from mocap.pose.edits import EvidenceOf
from mocap.pose.evidence import PersonTools
from mocap.pose.keypoint import KeypointEvidence, KeypointObservation, KeypointTools, ViewsOf
from mocap.pose.keypoint_person import PersonKeypoints, finish_keypoints, follow_keypoints, keypoint_tools
from mocap.pose.result import FollowedPerson, PersonPoses
from mocap.products import followed as followed_product
from mocap.products import keypoints as keypoints_product
from mocap.products import poses as poses_product
from mocap.products import tracks as tracks_product
from mocap.products.keypoints import stored_figure_tracks
from mocap.products.tracks import stored_tracks, track_row
from mocap.tracking.figures import FigureSettings, View2D, deviation_px
from mocap.tracking.renaming import Renaming, renamed

Array = NDArray[np.float64]

# A view from the side: from far away, so that all of a person is equally large.
_ASIDE_M, _ASIDE_PX = 100.0, 1e5
# Keypoints near the body's axis, which do not reach out towards a camera as arms and legs do.
_UPRIGHT = np.array(
    [name.rpartition("_")[2] in ("shoulder", "hip", "nose", "eye", "ear") for name in KEYPOINTS]
)


def keypoint_pose_stage(job: Job) -> None:
    """Poses and tracks of all persons whose keypoints two views or more agree on."""
    session = job.session
    found = stored_figure_tracks(job.store, session.fps)
    results = solve_persons(job, found, "keypoints", partial(KeypointWork, job))
    tracks = tracks_of_flesh(results, session.fps)
    with job.writer(tracks_product.PRODUCT) as out:
        for frame in session.frames:
            out.append(frame, **track_row(tracks, frame))


@dataclass(frozen=True, eq=False)
class KeypointWork:
    """What persons are followed in: the figures in the store, called as the edits say. Implements `PersonsWork`."""

    job: Job
    renamings: Sequence[Renaming] = ()

    def tools_of(self, body: Body, marker_offsets: Array | None) -> KeypointTools:
        """What a person is followed with whose body and offsets are known already."""
        config = self.job.config
        settings = pose_settings(config.pose, config.method, body.layout)
        return keypoint_tools(PersonTools(body, self.job.session.fps, settings, 1), marker_offsets)

    def views_of(self, person: int) -> ViewsOf:
        """frame -> what the cameras say of a person."""
        job = self.job
        return views_of_person(job.session, job.config, job.store, person, self.renamings)

    def evidence_of(self, one: FollowedPerson) -> EvidenceOf:
        """Row of a person -> its keypoints, with the body of that person."""
        assert isinstance(one.tools, KeypointTools)
        observation = KeypointObservation(one.tools, self.views_of(one.person))

        def evidence_of(row: int) -> KeypointEvidence | None:
            views = observation.prepare(int(one.frames[row]))
            return None if views is None else observation.evidence(views)

        return evidence_of

    def follow(self, tracks: Tracks) -> list[FollowedPerson]:
        """Every person who can be followed, one after the other."""
        session, config = self.job.session, self.job.config
        given = stated_height_m(config, load_body_model(config.body_model("keypoints")), session)
        done = 0

        def tick(n: int) -> None:
            nonlocal done
            done += n
            self.job.progress("pose", done, len(tracks))

        results = [
            follow_keypoints(
                PersonKeypoints(person, tracks.of(person).frame, self.views_of(person)),
                lambda height_m: person_tools(config, session.fps, height_m),
                height_m=given,
                seed=self.job.seed,
                progress=tick,
            )
            for person in tracks.persons
        ]
        return [one for one in results if one is not None]

    def finished(self, one: FollowedPerson) -> PersonPoses:
        """The smoothed poses of a followed person; the distance of one whom one camera alone shows is unsure."""
        poses, views_of = finish_keypoints(one), self.views_of(one.person)
        covariance = poses.landmark_covariance.copy()
        for row, frame in enumerate(poses.frames):
            views = views_of(int(frame))
            if views is not None and len(views.P) > len(self.job.session.rig):
                # Where feet stand errs alike in many frames: smoothing does not make it better.
                along = views.P[-1, 0, :3] / np.linalg.norm(views.P[-1, 0, :3])
                covariance[row] += self.job.config.method.keypoints.lone_std_m**2 * np.outer(along, along)
        return replace(poses, landmark_covariance=covariance)


def person_tools(config: Config, fps: float, height_m: float) -> PersonTools:
    """Body and settings of one person of some height who is seen by keypoints."""
    body = scale_body(load_body_model(config.body_model("keypoints")), height_m)
    return PersonTools(body, fps, pose_settings(config.pose, config.method, body.layout), 1)


def views_of_person(
    session: Session, config: Config, store: StageStore, person: int, renamings: Sequence[Renaming] = ()
) -> ViewsOf:
    """frame -> what the cameras say of a person, with the deviation of every keypoint at the person's distance.

    renamings : what persons are called.
    """
    reader = store.reader(keypoints_product.PRODUCT)
    views, slack_m = marker_views(session.rig), keypoint_slack_m(config)

    @lru_cache(maxsize=256)
    def views_of(frame: int) -> KeypointViews | None:
        arrays = reader.read(frame)
        at = np.flatnonzero(renamed(arrays["points_person"], frame, renamings) == person)
        if not len(at):
            return None
        points = arrays["points"][at[0]]
        middle = np.nanmean(points, axis=0)
        is_own = renamed(arrays["person"], frame, renamings) == person
        own = [figure_at(arrays, int(i), session.rig) for i in np.flatnonzero(is_own)]
        seen = person_views(own, middle, views, slack_m)
        if len(own) > 1:
            return seen
        return with_view_aside(seen, views.P[own[0].camera], points, config.method.keypoints.lone_std_m)

    return views_of


def keypoint_slack_m(config: Config) -> Array:
    """How far every keypoint moves against its segment, (K,) m."""
    body = scale_body(load_body_model(config.body_model("keypoints")), 1.0)
    return place_keypoints(body).slack_m


def figure_at(arrays: Mapping[str, NDArray[Any]], i: int, rig: CameraRig) -> View2D:
    """A figure of a frame of the product, undistorted."""
    c = int(arrays["camera"][i])
    return View2D(c, undistort(rig[c], arrays["uv"][i]), arrays["confidence"][i])


def person_views(
    figures: Sequence[View2D], place: Array, views: MarkerViews, slack_m: Array
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


def with_view_aside(seen: KeypointViews, P: Array, points: Array, std_m: float) -> KeypointViews:
    """What one camera alone says of a person, and a view from the side that says how far away trunk and head are.

    P : (3, 4) of the camera.  points : (K, 3) m, the person flat where its feet stand.  std_m : of this distance.
    """
    middle = np.nanmean(points, axis=0)
    away = middle + np.linalg.solve(P[:, :3], P[:, 3])
    along = np.array([away[0], away[1], 0.0]) / np.hypot(away[0], away[1])
    down = np.array([0.0, 0.0, -1.0])
    R = np.array([along, down, np.cross(along, down)])
    aside = np.diag([_ASIDE_PX, _ASIDE_PX, 1.0]) @ np.column_stack([R, -R @ middle + [0.0, 0.0, _ASIDE_M]])
    uvw = np.column_stack([points, np.ones(len(points))]) @ aside.T
    uv = np.where(_UPRIGHT[:, None], uvw[:, :2] / uvw[:, 2:], np.nan)
    # All of them err alike: together they know the distance as well as one of them.
    n_seen = np.isfinite(uv).all(axis=1).sum()
    noise = np.full(len(uv), np.sqrt(max(n_seen, 1)) * std_m * _ASIDE_PX / _ASIDE_M)
    return KeypointViews(
        np.concatenate([seen.P, aside[None]]),
        np.concatenate([seen.uv, uv[None]]),
        np.concatenate([seen.noise_px, noise[None]]),
    )


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
    products=(tracks_product.PRODUCT, followed_product.PRODUCT, poses_product.PRODUCT),
    work=ClipWork(keypoint_pose_stage),
    report=keypoint_pose_report,
    needs=("keypoints",),
    sections=("body", "pose", "method", "edits"),
    facts=("fps", "person_height_m"),
    is_random=lambda config: True,
)
