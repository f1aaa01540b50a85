"""Limbs carried over a jump between frames."""

from functools import cache

import numpy as np
import pytest
from flesh_voxels import Flesh

from mocap.body import landmarks_of, neutral_state
from mocap.pipeline.config import LikelihoodConfig, PoseConfig
from mocap.pipeline.pose_settings import make_tools
from mocap.pose.method import RepairSettings
from mocap.pose.repair import repair_limbs
from mocap.pose.volume import VolumeEvidence, VolumeTools

FPS = 25.0
N_FRAMES = 9
CLOSE_M = 0.04  # a voxel of 4 cm


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


def test_a_smooth_motion_is_left_alone(tools: VolumeTools, truth: np.ndarray) -> None:
    def never(row: int) -> VolumeEvidence:
        raise AssertionError("no frame need be looked at")

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
