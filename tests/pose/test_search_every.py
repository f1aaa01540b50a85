"""A search in some frames only: what those between are given, and when they are searched all the same."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from flesh_voxels import Flesh
from outline_world import N_POINTS, bent, landmark_cloud, make_rig, outlines_of, silhouette

from mocap.body import landmarks_of, neutral_state
from mocap.filters import ParticleState
from mocap.likelihood.keypoints import KeypointViews
from mocap.likelihood.markers import MarkerObservation, marker_views
from mocap.likelihood.residuals import person_outlines, pinhole_view
from mocap.pipeline.config import LikelihoodConfig, PoseConfig
from mocap.pipeline.pose_settings import make_tools
from mocap.pose import follow
from mocap.pose.follow import Candidate, OnePose, follow_frame
from mocap.pose.keypoint import KeypointEvidence
from mocap.pose.marker import MarkerEvidence
from mocap.pose.person import VolumeClip
from mocap.pose.volume import PersonHull, VolumeEvidence, VolumeObservation

FPS = 25.0
TURN = 0.04  # rad per frame, of an arm that swings as in a walk
N_FRAMES = 9
RNG = np.random.default_rng(0)


@pytest.fixture(scope="module")
def swinging(coarse_flesh: Flesh) -> np.ndarray:
    """States of somebody who lifts his left arm."""
    arm = coarse_flesh.body.layout.names.index("left_shoulder_y")
    states = np.tile(neutral_state(coarse_flesh.body), (N_FRAMES, 1))
    states[:, arm] += TURN * np.arange(N_FRAMES)
    return states


def policy_of(
    flesh: Flesh, states: np.ndarray, hidden: tuple[int, ...] = (), **settings: Any
) -> tuple[OnePose, VolumeObservation]:
    pose = PoseConfig(n_layers=2, n_particles=40, **settings)
    tools = make_tools(flesh.grid, FPS, 1.74, "anthropometric", pose, LikelihoodConfig(), 1)
    hulls: list[PersonHull | None] = [None if i in hidden else flesh.hull(s) for i, s in enumerate(states)]
    observation = VolumeObservation(tools, lambda frame: hulls[frame])
    rows = np.arange(len(states))
    return OnePose(VolumeClip(1, rows, np.zeros((len(rows), 3)), observation), 0, states[0]), observation


def followed(policy: OnePose, observation: VolumeObservation) -> tuple[list[int], list[np.ndarray]]:
    """The rows in which the filter proposed, and the landmarks of every pose."""
    searched, found = [], []
    step = policy._step

    def watched(*args: Any, **more: Any) -> Any:
        searched.append(policy._row)
        return step(*args, **more)

    policy._step = watched
    for row in policy.clip.frames.tolist():
        prepared = observation.prepare(row)
        evidence = None if prepared is None else observation.evidence(prepared)
        found.append(follow_frame(policy, row, evidence, np.random.default_rng(row)).landmarks)
    return searched, found


def test_between_two_searches_the_pose_is_followed_all_the_same(
    coarse_flesh: Flesh, swinging: np.ndarray
) -> None:
    errors = []
    for every, rows in (1, list(range(N_FRAMES))), (3, [0, 3, 6]):
        searched, found = followed(*policy_of(coarse_flesh, swinging, search_every_frames=every))
        assert searched == rows
        off = np.linalg.norm(np.stack(found) - landmarks_of(coarse_flesh.body, swinging), axis=2)
        errors.append(float(off.mean()))
    assert errors[1] < 1.2 * errors[0] < 0.03


@pytest.mark.parametrize("settings", [{}, {"search_every_frames": 4, "refine": False}])
def test_every_frame_is_searched_by_default_and_where_nothing_is_refined(
    coarse_flesh: Flesh, swinging: np.ndarray, settings: dict[str, Any]
) -> None:
    searched, _ = followed(*policy_of(coarse_flesh, swinging[:5], **settings))
    assert searched == [0, 1, 2, 3, 4]


@pytest.mark.parametrize(("n_cameras", "rows"), [(4, [0, 1, 2, 3, 4]), (5, [0, 2, 4])])
def test_with_auto_many_cameras_are_searched_less_often(
    coarse_flesh: Flesh,
    swinging: np.ndarray,
    n_cameras: int,
    rows: list[int],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(VolumeEvidence, "n_cameras", n_cameras)
    searched, _ = followed(*policy_of(coarse_flesh, swinging[:5], search_every_frames="auto"))
    assert searched == rows


def test_a_camera_counts_where_it_has_a_silhouette_of_the_person(coarse_flesh: Flesh) -> None:
    rig, state = make_rig(), bent(coarse_flesh)
    seen = outlines_of(coarse_flesh, state, rig)
    views, masks = [pinhole_view(c) for c in rig], [silhouette(coarse_flesh, state, c) for c in rig]
    masks[2] = np.zeros_like(masks[2])
    fewer = person_outlines(views, rig, masks, landmark_cloud(coarse_flesh, state), n_points=N_POINTS)
    policy, observation = policy_of(coarse_flesh, state[None])
    hull = coarse_flesh.hull(state)
    for outlines, n in (seen, len(rig)), (fewer, len(rig) - 1), (None, 0):
        own = replace(hull, outlines=None if outlines is None else lambda found=outlines: found)
        evidence = observation.evidence(policy.tools.prepared(own))
        assert evidence.n_cameras == n


def test_detections_count_cameras_that_have_any(coarse_flesh: Flesh) -> None:
    policy, _ = policy_of(coarse_flesh, neutral_state(coarse_flesh.body)[None])
    uv = np.zeros((4, 17, 2))
    uv[2] = np.nan
    keypoints = KeypointViews(np.zeros((4, 3, 4)), uv, np.ones((4, 17)))
    assert KeypointEvidence(policy.tools, keypoints).n_cameras == 3  # type: ignore[arg-type]
    detections = MarkerObservation(marker_views(make_rig()), np.zeros((5, 2)), np.array([0, 2, 2, 5]))
    assert MarkerEvidence(policy.tools, detections).n_cameras == 2  # type: ignore[arg-type]


def test_who_was_out_of_sight_is_searched_for_at_once(coarse_flesh: Flesh, swinging: np.ndarray) -> None:
    searched, _ = followed(*policy_of(coarse_flesh, swinging, hidden=(4,), search_every_frames=3))
    assert searched == [0, 3, 5, 8]


@pytest.mark.parametrize(
    ("turned", "goes_on"),
    [
        (TURN, TURN),
        (-TURN, -TURN),
        (2.0, 0.0),  # no arm turns so far in a frame: it was somewhere else, and has been found
    ],
)
def test_joints_turn_on_and_a_limb_that_was_found_stays(
    coarse_flesh: Flesh, turned: float, goes_on: float
) -> None:
    states = np.tile(neutral_state(coarse_flesh.body), (3, 1))
    arm = coarse_flesh.body.layout.names.index("left_shoulder_x")
    states[1:, arm] += turned
    states[1:, 0] += 0.01
    policy, _ = policy_of(coarse_flesh, states, search_every_frames=2)
    policy.clip.xyz[2] = policy.clip.xyz[1] + [0.0, 0.02, 0.0]
    for row in (0, 1):
        policy.carry(row, SimpleNamespace())  # type: ignore[arg-type]
        policy._before, policy._estimate = policy._came_from, states[row]
        assert (policy._before is None) == (row == 0)  # the first pose came from no other frame
    policy._particles = ParticleState(states[:2].copy(), np.full(2, 0.5))
    carried = policy.carry(2, SimpleNamespace(search=None))  # type: ignore[arg-type]
    (now,) = policy.propose(carried, RNG)
    moved = now.state - states[1]
    assert moved[arm] == pytest.approx(goes_on)
    moved[arm] = 0.0
    np.testing.assert_allclose(moved, 0.02 * (np.arange(len(moved)) == 1), atol=1e-12)  # as the track
    np.testing.assert_allclose(policy._particles.particles[:, 1], states[:2, 1] + 0.02)


def test_an_angle_that_goes_round_turns_on_the_short_way(coarse_flesh: Flesh) -> None:
    body = coarse_flesh.body
    assert body.yaw_column is not None
    states = np.tile(neutral_state(body), (2, 1))
    states[:, body.yaw_column] = np.pi - 0.01, -np.pi + 0.01
    policy, _ = policy_of(coarse_flesh, states)
    policy._before, policy._estimate = states
    (now,) = policy._gone_on([Candidate(states[1])])
    assert now.state[body.yaw_column] == pytest.approx(-np.pi + 0.03)


def test_a_limit_is_not_passed(coarse_flesh: Flesh) -> None:
    layout = coarse_flesh.body.layout
    knee = layout.names.index("left_knee_y")
    states = np.tile(neutral_state(coarse_flesh.body), (2, 1))
    states[:, knee] = layout.lower[knee] + 0.05, layout.lower[knee] + 0.01
    policy, _ = policy_of(coarse_flesh, states)
    policy._before, policy._estimate = states
    (now,) = policy._gone_on([Candidate(states[1])])
    assert now.state[knee] == layout.lower[knee]


@pytest.mark.parametrize(
    ("n_since_search", "value", "is_searched"), [(0, 100.0, True), (1, 100.0, False), (1, 90.0, True)]
)
def test_between_two_searches_limbs_are_looked_for_where_the_evidence_has_fallen(
    coarse_flesh: Flesh,
    monkeypatch: pytest.MonkeyPatch,
    n_since_search: int,
    value: float,
    is_searched: bool,
) -> None:
    policy, _ = policy_of(coarse_flesh, np.tile(neutral_state(coarse_flesh.body), (2, 1)))
    for _ in range(20):
        policy._limbs.due(100.0, {1: 0.0})  # what is usual
    policy._n_since_search = n_since_search
    policy._evidence = SimpleNamespace(limb_misfits=lambda state: {1: 0.0})  # type: ignore[assignment]
    policy._previous = None
    monkeypatch.setattr(policy, "_with_legs_judged", lambda now: now)
    searched = []
    monkeypatch.setattr(
        follow, "search_limbs", lambda evidence, state, previous, **more: searched.append(True) or state
    )
    now = Candidate(neutral_state(coarse_flesh.body), value=value)
    assert policy.search_limbs([now], RNG)[0].state is now.state
    assert searched == [True] * is_searched


def test_brief_looks_search_every_frame(coarse_flesh: Flesh) -> None:
    policy, _ = policy_of(coarse_flesh, np.tile(neutral_state(coarse_flesh.body), (2, 1)))
    tools = replace(policy.tools, settings=replace(policy.tools.settings, search_every_frames=5))
    assert tools.brisk(2, 20).settings.search_every_frames == 1
