"""The pose of one person over a clip of keypoints: start, fit of body and offsets, both directions, smoothing."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mocap.body import Body, landmarks_of
from mocap.body.initial import DEFAULT_HEIGHT_M, HeightEstimate
from mocap.body.keypoints import place_keypoints
from mocap.body.kinematics import point_jacobian
from mocap.body.markers import marker_positions
from mocap.data.keypoints import KEYPOINTS
from mocap.filters.smoother import smooth_states
from mocap.forks import shared_zeros
from mocap.likelihood.markers import BundleSettings, bundle
from mocap.pose.deviation import FrameSeries, within_limits
from mocap.pose.evidence import PersonClip, PersonTools
from mocap.pose.follow import FramePose, follow_both_ways, follow_pose, note, unbroken
from mocap.pose.keypoint import KeypointObservation, KeypointTools, ViewsOf, points_of
from mocap.pose.result import FollowedPerson, PersonPoses
from mocap.pose.start import FirstPose, PoseSearch, settle_first_poses, try_first_poses
from mocap.rng import rng_for

Array = NDArray[np.float64]

# Segments whose lengths tell a size: both ends are keypoints that lie on joints.
_SEGMENTS = [
    (KEYPOINTS.index(f"{side}_{a}"), KEYPOINTS.index(f"{side}_{b}"))
    for side in ("left", "right")
    for a, b in (("shoulder", "elbow"), ("shoulder", "hip"), ("hip", "knee"), ("knee", "ankle"))
]


@dataclass(frozen=True, eq=False)
class PersonKeypoints:
    """One person as cameras see it.  frames : (T,) ascending.  views_of : frame -> its keypoints, None = none."""

    person: int
    frames: NDArray[np.int64]
    views_of: ViewsOf

    def clip(self, tools: KeypointTools) -> PersonClip:
        """The person over its frames, judged by some tools."""
        return PersonClip(self.person, self.frames, None, KeypointObservation(tools, self.views_of))


def keypoint_tools(tools: PersonTools, offsets: Array | None = None) -> KeypointTools:
    """Tools for a body whose keypoints sit where the table of places says, or at offsets (K, 3) m from their joints."""
    markers = place_keypoints(tools.body)
    if offsets is not None:
        markers = replace(markers, offset=offsets)
    return KeypointTools(tools.body, tools.fps, tools.settings, tools.n_threads, markers)


def follow_keypoints(
    seen: PersonKeypoints,
    tools_of: Callable[[float], PersonTools],
    *,
    height_m: float | None,
    seed: int,
    progress: Callable[[int], None] | None = None,
) -> FollowedPerson | None:
    """One person over its frames; None when no frame shows enough points. `finish_keypoints` makes poses of it.

    tools_of : standing height, m -> body and settings.  height_m : None = from the keypoints.
    The first pose is looked for in a few frames; segment lengths and the tool's offsets are fitted to frames spread
    over the clip; then the poses are followed from the first one to the end and back to the beginning.
    """
    tools = keypoint_tools(tools_of(DEFAULT_HEIGHT_M))
    rows = _usable_rows(seen, tools)
    if not len(rows):
        return None
    rough = height_m or _rough_height(seen, tools, rows)
    tools = keypoint_tools(tools_of(rough))
    first = _first_pose(seen, tools, rows, seed=seed)
    tools, first = _fitted(seen, tools, first, is_size_known=height_m is not None, seed=seed)
    height = HeightEstimate(height_m if height_m is not None else tools.body.height_m, True)
    clip = seen.clip(tools)
    series, n = FrameSeries.of_length(len(clip), tools.body), tools.body.layout.n_columns
    information = shared_zeros((len(clip), n, n))

    def take(pose: FramePose) -> None:
        note(series, pose.row, pose, tools)
        information[pose.row] = pose.information

    follow_both_ways(clip, first, seed=seed, take=take, progress=progress)
    return FollowedPerson(
        person=seen.person,
        tools=tools,
        height=height,
        frames=seen.frames,
        series=series,
        is_facing_open=False,
        n_usable=int(np.isfinite(series.log_likelihood).sum()),
        start_frame=first.frame,
        first_pose=first.label,
        information=information,
    )


def _usable_rows(seen: PersonKeypoints, tools: KeypointTools) -> NDArray[np.int64]:
    observation = KeypointObservation(tools, seen.views_of)
    usable = [row for row, frame in enumerate(seen.frames) if observation.prepare(int(frame)) is not None]
    return np.array(usable, dtype=np.int64)


def _spread(rows: Sequence[int] | NDArray[np.int64], n: int) -> list[int]:
    """At most n of some rows, evenly spread."""
    return [int(rows[k]) for k in np.unique(np.linspace(0, len(rows) - 1, n).astype(int))]


def _rough_height(seen: PersonKeypoints, tools: KeypointTools, rows: NDArray[np.int64]) -> float:
    """Standing height of the body whose segments are as long as the person's, on the median of many frames, m."""
    lengths = []
    for row in _spread(rows, tools.numbers.fit_frames):
        views = seen.views_of(int(seen.frames[row]))
        assert views is not None
        points = points_of(views, tools.numbers)
        lengths.append([np.linalg.norm(points[a] - points[b]) for a, b in _SEGMENTS])
    own = marker_positions(tools.body, tools.markers, np.zeros((1, tools.body.layout.n_columns)))[0]
    usual = np.array([np.linalg.norm(own[a] - own[b]) for a, b in _SEGMENTS])
    found = np.array(lengths)
    known = np.isfinite(found).any(axis=0)
    if not known.any():
        return DEFAULT_HEIGHT_M
    factor = float(np.median(np.nanmedian(found[:, known], axis=0) / usual[known]))
    return float(np.clip(factor, 0.3, 1.4)) * tools.body.height_m


def _first_pose(
    seen: PersonKeypoints, tools: KeypointTools, rows: NDArray[np.int64], *, seed: int
) -> FirstPose:
    """The pose that explains the keypoints of its own frame best, per view of a keypoint, of a few frames."""
    observation = KeypointObservation(tools, seen.views_of)
    most = sorted(rows.tolist(), key=lambda row: -_n_points(seen, int(seen.frames[row]), tools))
    chosen = _spread(sorted(most[: max(1, len(most) // 2)]), tools.settings.n_start_frames)
    found: list[tuple[float, FirstPose]] = []
    for row in chosen:
        frame = int(seen.frames[row])
        views = observation.prepare(frame)
        assert views is not None
        search = PoseSearch(observation.evidence(views), frame, None)
        rng = rng_for(seed, "keypoint-start", seen.person, frame)
        settled = settle_first_poses(search, try_first_poses(search, rng=rng), rng=rng)[0]
        found.append((settled.log_likelihood / max(int(views.has_say.sum()), 1), settled))
    return max(found, key=lambda entry: entry[0])[1]


def _n_points(seen: PersonKeypoints, frame: int, tools: KeypointTools) -> int:
    views = seen.views_of(frame)
    return 0 if views is None else int((views.n_views >= 2).sum())


def _fitted(
    seen: PersonKeypoints, tools: KeypointTools, first: FirstPose, *, is_size_known: bool, seed: int
) -> tuple[KeypointTools, FirstPose]:
    """Body and offsets fitted to frames spread over the clip, and the first pose with them."""
    numbers, trial = tools.numbers, tools.settings.method.start
    stride = trial.trial_stride_frames
    start = int(np.searchsorted(seen.frames, first.frame))
    clip = seen.clip(_brisk(tools, stride))
    rows = [*range(start, len(clip), stride)], [*range(start, -1, -stride)]
    poses = [
        pose
        for order in rows
        for pose in follow_pose(clip, order, first.state, seed=seed, stage="keypoint-fit", forgets=True)
        if np.isfinite(pose.evidence)
    ]
    poses.sort(key=lambda pose: pose.row)
    worst = np.quantile(
        [pose.evidence for pose in poses], 0.2
    )  # the fifth that fits worst may be wrong in a limb
    good = [pose for pose in poses if pose.evidence >= worst]
    chosen = [good[k] for k in _spread(range(len(good)), numbers.fit_frames)]
    problems = []
    for pose in chosen:
        views = seen.views_of(int(seen.frames[pose.row]))
        assert views is not None
        problems.append(tools.problem(views))
    fit = bundle(
        problems,
        np.array([pose.state for pose in chosen]),
        BundleSettings(
            size_std=0.01 if is_size_known else numbers.size_std,
            stretch_std=numbers.stretch_std,
            offset_std_m=numbers.offset_std_m,
        ),
    )
    fitted = replace(tools, body=fit.body, markers=fit.markers)
    observation = KeypointObservation(fitted, seen.views_of)
    views = observation.prepare(first.frame)
    assert views is not None
    return fitted, replace(first, state=observation.evidence(views).all_refined([first.state])[0])


def _brisk(tools: KeypointTools, stride: int) -> KeypointTools:
    trial = tools.settings.method.start
    return tools.brisk(trial.trial_layers, trial.trial_particles // 2, stride)


def finish_keypoints(followed: FollowedPerson) -> PersonPoses:
    """Smoothed poses of a person who was followed, with their uncertainty."""
    tools, series, information = followed.tools, followed.series, followed.information
    assert information is not None
    pieces = unbroken(followed.frames)
    smoothed = [_smoothed(tools, series.states[piece], information[piece]) for piece in pieces]
    states = np.concatenate([own for own, _ in smoothed])
    n_blind = len(followed.frames) - followed.n_usable
    warnings = (
        f"person {followed.person}: two views saw too few keypoints in {n_blind} of {len(followed.frames)} frames; the "
        "pose was carried on there and its landmarks are marked as not observed",
    )
    return PersonPoses(
        person=followed.person,
        body=tools.body,
        height=followed.height,
        frames=followed.frames,
        states=states,
        landmarks=landmarks_of(tools.body, states),
        landmark_covariance=np.concatenate([covariance for _, covariance in smoothed]),
        observed=series.observed,
        log_likelihood=series.log_likelihood,
        ess_share=series.ess_share,
        start_frame=followed.start_frame,
        first_pose=followed.first_pose,
        warnings=warnings if n_blind else (),
    )


def _smoothed(tools: PersonTools, states: Array, information: Array) -> tuple[Array, Array]:
    """States (T, D) smoothed over time, and the covariance of their landmarks (T, M, 3, 3) m^2."""
    body, numbers = tools.body, tools.settings.method.keypoints
    per_s2 = np.where(body.is_position, numbers.acceleration_m_s2, numbers.acceleration_rad_s2)
    smoothed, covariance = smooth_states(states, information, per_s2 / tools.fps**2, body.layout.is_circular)
    states = np.clip(smoothed, body.layout.lower, body.layout.upper)
    covariance = within_limits(body.layout, covariance)
    spread = np.array([_of_landmarks(body, s, c) for s, c in zip(states, covariance, strict=True)])
    return states, spread + numbers.model_std_m**2 * np.eye(3)


def _of_landmarks(body: Body, state: Array, covariance: Array) -> Array:
    """Covariance of the landmarks (M, 3, 3) m^2 from that of a state (D, D)."""
    _, J, _ = point_jacobian(body, state, body.landmark_joint, body.landmark_offset)
    return np.asarray(np.einsum("lri,ij,lcj->lrc", J, covariance, J))
