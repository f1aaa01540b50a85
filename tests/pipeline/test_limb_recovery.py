"""The cost of jumps in the search for lost limbs."""

from dataclasses import replace

import numpy as np
import pytest
from flesh_voxels import Flesh

from mocap.body import landmarks_of, neutral_state
from mocap.data import LANDMARKS
from mocap.pipeline.config import LikelihoodConfig, PoseConfig
from mocap.pipeline.limbs import jump_nats
from mocap.pipeline.pose_problem import PoseTools, make_tools

FPS = 30.0
NATS = 3.0


@pytest.fixture(scope="module")
def tools(coarse_flesh: Flesh) -> PoseTools:
    pose = PoseConfig(jump_nats=NATS)
    return make_tools(coarse_flesh.grid, FPS, 1.7, "anthropometric", pose, LikelihoodConfig(), 1)


def raised(tools: PoseTools, rad: float) -> np.ndarray:
    """The neutral pose with the left arm swung about its shoulder."""
    state = neutral_state(tools.body)
    state[tools.body.layout.names.index("left_shoulder_x")] += rad
    return state


def test_what_people_can_do_in_a_frame_is_free(tools: PoseTools) -> None:
    before, after = neutral_state(tools.body), raised(tools, 0.2)
    wrist = LANDMARKS.index("left_wrist")
    moved = landmarks_of(tools.body, np.stack([before, after]))[:, wrist]
    assert 0.08 < np.linalg.norm(moved[1] - moved[0]) < 4.0 / FPS
    assert jump_nats(tools, [before, after], before).tolist() == [0.0, 0.0]


def test_a_limb_thrown_across_the_body_costs_at_most_its_landmarks(tools: PoseTools) -> None:
    before = neutral_state(tools.body)
    cost = jump_nats(tools, [raised(tools, 0.5), raised(tools, 2.5)], before)
    assert 0 < cost[0] < cost[1]
    assert cost[1] == pytest.approx(2 * NATS)  # elbow and wrist, whole


def test_a_person_carried_off_costs_all_landmarks(tools: PoseTools) -> None:
    before = neutral_state(tools.body)
    away = before.copy()
    away[0] += 5.0
    assert jump_nats(tools, [away], before)[0] == pytest.approx(NATS * len(LANDMARKS))


def test_without_an_earlier_pose_or_with_no_cost_jumps_are_free(tools: PoseTools) -> None:
    before, after = neutral_state(tools.body), raised(tools, 2.5)
    assert jump_nats(tools, [after], None)[0] == 0.0
    free = replace(tools, pose=tools.pose.model_copy(update={"jump_nats": 0.0}))
    assert jump_nats(free, [after], before)[0] == 0.0
