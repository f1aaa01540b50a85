"""Limbs carried over a jump between frames."""

from functools import cache

import numpy as np
import pytest
from flesh_voxels import Flesh

from mocap.body import landmarks_of, load_body_model, neutral_state, scale_body
from mocap.pipeline.config import LikelihoodConfig, PoseConfig
from mocap.pipeline.pose_settings import make_tools
from mocap.pose.method import RepairSettings
from mocap.pose.repair import repair_limbs
from mocap.pose.volume import VolumeEvidence, VolumeTools

FPS = 25.0
N_FRAMES = 9
CLOSE_M = 0.04  # a voxel of 4 cm
FAST_M = RepairSettings().fast_m_s / FPS


@pytest.fixture(scope="module")
def tools(coarse_flesh: Flesh) -> VolumeTools:
    return make_tools(coarse_flesh.grid, FPS, 1.7, "anthropometric", PoseConfig(), LikelihoodConfig(), 1)


@pytest.fixture(scope="module")
def truth(tools: VolumeTools) -> np.ndarray:
    """An arm that rises from the side, slowly."""
    states = np.tile(neutral_state(tools.body), (N_FRAMES, 1))
    states[:, 2] = 1.0
    states[:, tools.body.layout.names.index("left_shoulder_x")] += np.linspace(0.2, 0.7, N_FRAMES)
    return states


@pytest.fixture(scope="module")
def frame_of(coarse_flesh: Flesh, tools: VolumeTools, truth: np.ndarray):  # type: ignore[no-untyped-def]
    @cache
    def one(row: int) -> VolumeEvidence:
        return tools.frame(coarse_flesh.hull(truth[row], margin_m=0.02))

    return one


def lost(tools: VolumeTools, truth: np.ndarray, first: int, stop: int) -> np.ndarray:
    """The same with the arm folded up behind the head in some frames."""
    states = truth.copy()
    names = tools.body.layout.names
    states[first:stop, names.index("left_shoulder_x")] += 1.9
    states[first:stop, names.index("left_elbow_z")] -= 2.0
    return states


def worst_m(tools: VolumeTools, states: np.ndarray, truth: np.ndarray) -> float:
    gap = landmarks_of(tools.body, states) - landmarks_of(tools.body, truth)
    return float(np.linalg.norm(gap, axis=2).max())


@pytest.mark.parametrize(("first", "stop"), [(3, 6), (0, 4), (6, N_FRAMES)])
def test_a_lost_arm_is_carried_over_from_the_frames_beside(  # type: ignore[no-untyped-def]
    tools: VolumeTools, truth: np.ndarray, frame_of, first: int, stop: int
) -> None:
    states = lost(tools, truth, first, stop)
    found = repair_limbs(tools.body, states, FPS, frame_of, RepairSettings())
    assert set(range(first, stop)) <= set(found)
    for row, state in found.items():
        states[row] = state
    assert worst_m(tools, states, truth) < CLOSE_M


def moved(tools: VolumeTools, truth: np.ndarray, column: str, angles_rad: np.ndarray) -> np.ndarray:
    """The same with one joint turned by an angle in every frame."""
    states = truth.copy()
    states[:, tools.body.layout.names.index(column)] += angles_rad
    return states


def largest_move_m(tools: VolumeTools, states: np.ndarray, landmark: str) -> float:
    places = landmarks_of(tools.body, states)[:, tools.body.landmarks.index(landmark)]
    return float(np.linalg.norm(np.diff(places, axis=0), axis=1).max())


def test_an_arm_that_slips_a_little_is_carried_over_too(  # type: ignore[no-untyped-def]
    tools: VolumeTools, truth: np.ndarray, frame_of
) -> None:
    slipped = moved(tools, truth, "left_shoulder_x", 0.4 * (np.abs(np.arange(N_FRAMES) - 4) < 2))
    jump_m = largest_move_m(tools, slipped, "left_wrist")
    assert FAST_M < jump_m < FAST_M + RepairSettings().jump_m
    found = repair_limbs(tools.body, slipped, FPS, frame_of, RepairSettings())
    assert {3, 4, 5} <= set(found)
    for row, state in found.items():
        slipped[row] = state
    assert worst_m(tools, slipped, truth) < CLOSE_M


def never(row: int) -> VolumeEvidence:
    raise AssertionError("no frame need be looked at")


def test_a_foot_may_swing_as_far(tools: VolumeTools, truth: np.ndarray) -> None:
    kick = moved(tools, truth, "left_hip_y", -0.25 * np.arange(N_FRAMES))
    assert FAST_M < largest_move_m(tools, kick, "left_ankle") < FAST_M + RepairSettings().jump_m
    assert repair_limbs(tools.body, kick, FPS, never, RepairSettings()) == {}


def test_a_hand_may_flap_about_its_wrist() -> None:
    body = scale_body(load_body_model("whole"), 1.7)
    states = np.tile(neutral_state(body), (N_FRAMES, 1))
    states[:, body.layout.names.index("left_wrist_z")] = np.where(np.arange(N_FRAMES) % 2, 0.5, -0.5)
    tip = landmarks_of(body, states)[:, body.landmarks.index("left_hand_tip")]
    assert np.linalg.norm(np.diff(tip, axis=0), axis=1).min() > FAST_M
    assert repair_limbs(body, states, FPS, never, RepairSettings()) == {}


def test_a_smooth_motion_is_left_alone(tools: VolumeTools, truth: np.ndarray) -> None:
    assert repair_limbs(tools.body, truth, FPS, never, RepairSettings()) == {}


def test_frames_without_a_hull_end_the_repair(  # type: ignore[no-untyped-def]
    tools: VolumeTools, truth: np.ndarray, frame_of
) -> None:
    states = lost(tools, truth, 3, 6)
    found = repair_limbs(
        tools.body, states, FPS, lambda row: None if row in (3, 5) else frame_of(row), RepairSettings()
    )
    assert 3 not in found
    assert 5 not in found


def test_the_states_given_are_not_changed(  # type: ignore[no-untyped-def]
    tools: VolumeTools, truth: np.ndarray, frame_of
) -> None:
    states = lost(tools, truth, 3, 6)
    before = states.copy()
    repair_limbs(tools.body, states, FPS, frame_of, RepairSettings())
    np.testing.assert_array_equal(states, before)
