"""Where the pose before says little of this one, or few cameras see the person, a pose is looked for in every frame."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from flesh_voxels import Flesh

from mocap.body import neutral_state
from mocap.pipeline.config import LikelihoodConfig, PoseConfig, load_config
from mocap.pipeline.pose_settings import make_tools
from mocap.pose.follow import Candidate, OnePose
from mocap.pose.person import VolumeClip
from mocap.pose.volume import VolumeObservation


def policy_of(flesh: Flesh, state: np.ndarray, fps: float, **settings: Any) -> OnePose:
    tools = make_tools(flesh.grid, fps, 1.74, "anthropometric", PoseConfig(**settings), LikelihoodConfig(), 1)
    observation = VolumeObservation(tools, lambda frame: None)
    return OnePose(VolumeClip(1, np.arange(4), np.zeros((4, 3)), observation), 0, state)


@pytest.mark.parametrize(
    ("fps", "n_cameras", "settings", "is_looked_for"),
    [
        (30.0, 7, {}, False),
        (30.0, 3, {}, False),
        (30.0, 2, {}, True),
        (13.0, 7, {}, False),
        (12.5, 7, {}, True),
        (5.0, 7, {}, True),
        (5.0, 2, {"look_again": False}, False),
    ],
)
def test_when_a_pose_is_looked_for_in_every_frame(
    coarse_flesh: Flesh,
    monkeypatch: pytest.MonkeyPatch,
    fps: float,
    n_cameras: int,
    settings: dict[str, Any],
    is_looked_for: bool,
) -> None:
    state = neutral_state(coarse_flesh.body)
    policy = policy_of(coarse_flesh, state, fps, **settings)
    found = Candidate(state.copy(), value=1.0)
    monkeypatch.setattr(policy, "_restarted", lambda now, rng: found)
    taken = []
    for row in range(3):
        policy.carry(row, SimpleNamespace(n_cameras=n_cameras))  # type: ignore[arg-type]
        (now,) = policy.restart([Candidate(state, value=1.0)], np.random.default_rng(0))
        taken.append(now is found)
    # The first pose was looked for already.
    assert taken == [False, is_looked_for, is_looked_for]


def test_somebody_unseen_for_a_frame_is_followed_as_before(coarse_flesh: Flesh) -> None:
    state = neutral_state(coarse_flesh.body)
    policy = policy_of(coarse_flesh, state, 5.0)
    policy.carry(0, SimpleNamespace(n_cameras=7))  # type: ignore[arg-type]
    policy.lose_sight(1)
    policy.carry(2, SimpleNamespace(n_cameras=7))  # type: ignore[arg-type]
    assert not policy._is_hard_to_follow


@pytest.mark.parametrize(
    ("fps", "preset", "is_gone"), [(2.6, "default", False), (2.5, "default", True), (1.0, "live", False)]
)
def test_between_pictures_a_while_apart_everybody_may_have_turned(
    coarse_flesh: Flesh, fps: float, preset: str, is_gone: bool
) -> None:
    """Then a pose is looked for as if he had been away; not in the first frame, where it has been."""
    state = neutral_state(coarse_flesh.body)
    policy = policy_of(coarse_flesh, state, fps)
    policy.settings = replace(policy.settings, method=load_config(preset).method)
    policy.tools = replace(policy.tools, settings=policy.settings)
    gone = []
    for row in range(3):
        policy.carry(row, SimpleNamespace(n_cameras=7))  # type: ignore[arg-type]
        gone.append(policy._has_returned)
    assert gone == [False, is_gone, is_gone]


def test_live_cameras_are_not_kept_waiting() -> None:
    follow, usual = load_config("live").method.follow, load_config().method.follow
    assert (follow.apart_s, follow.few_cameras) == (1e9, 0)
    assert (usual.apart_s, usual.few_cameras) == (0.08, 2)
