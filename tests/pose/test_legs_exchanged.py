"""Legs that have taken each other's place: brought back where the evidence says so, in doubt where it does not."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from flesh_voxels import Flesh

from mocap.arrays import frames_in_words
from mocap.body import landmarks_of, load_body_model, neutral_state, scale_body
from mocap.data import LANDMARKS
from mocap.pipeline.config import LikelihoodConfig, PoseConfig
from mocap.pipeline.pose_settings import make_tools
from mocap.pose.evidence import PersonClip
from mocap.pose.follow import FramePose, follow_pose
from mocap.pose.limbs import in_doubt, legs_exchanged, legs_of
from mocap.pose.method import LegsSettings, RepairSettings
from mocap.pose.repair import repair_limbs
from mocap.pose.volume import PersonHull, VolumeEvidence, VolumeObservation, VolumeTools

FPS = 30.0
LEGS = [LANDMARKS.index(f"{side}_{name}") for side in ("left", "right") for name in ("knee", "ankle")]
MIRRORED = [LANDMARKS.index(f"{side}_{name}") for side in ("right", "left") for name in ("knee", "ankle")]
CLOSE_M = 0.06  # a voxel and a half
SETTINGS = LegsSettings()


@pytest.fixture(scope="module")
def tools(coarse_flesh: Flesh) -> VolumeTools:
    pose = PoseConfig(refine=True, look_again=True)
    return make_tools(coarse_flesh.grid, FPS, 1.7, "anthropometric", pose, LikelihoodConfig(), 1)


@pytest.fixture(scope="module")
def truth(tools: VolumeTools) -> np.ndarray:
    """A stride: the left leg swings forward past the right one."""
    states = np.tile(neutral_state(tools.body), (9, 1))
    states[:, 2] = 1.0
    names = tools.body.layout.names
    for k, swing in enumerate(np.linspace(-0.45, 0.45, len(states))):
        states[k, names.index("left_hip_y")] -= swing
        states[k, names.index("right_hip_y")] += swing
    return states


@pytest.fixture(scope="module")
def hull_of(coarse_flesh: Flesh, truth: np.ndarray):  # type: ignore[no-untyped-def]
    @cache
    def one(row: int) -> PersonHull:
        return coarse_flesh.hull(truth[row], margin_m=0.02)

    return one


def swapped(tools: VolumeTools, hull: PersonHull, state: np.ndarray) -> np.ndarray:
    found = legs_exchanged(tools.frame(hull), state)
    assert found is not None
    return found


def errors_m(tools: VolumeTools, state: np.ndarray, truth: np.ndarray) -> np.ndarray:
    found, true = landmarks_of(tools.body, np.stack([state, truth]))
    return np.asarray(np.linalg.norm(found - true, axis=1)[LEGS])


def test_each_leg_goes_where_the_other_is(tools: VolumeTools, truth: np.ndarray, hull_of) -> None:  # type: ignore[no-untyped-def]
    found, true = landmarks_of(tools.body, np.stack([swapped(tools, hull_of(0), truth[0]), truth[0]]))
    assert np.linalg.norm(true[LEGS] - true[MIRRORED], axis=1).max() > 0.5
    gap = np.linalg.norm(found[LEGS] - true[MIRRORED], axis=1)
    assert gap.max() < 0.12  # a leg that hangs on the other hip cannot end at quite the same place


def test_the_evidence_tells_exchanged_legs(tools: VolumeTools, truth: np.ndarray, hull_of) -> None:  # type: ignore[no-untyped-def]
    evidence = tools.frame(hull_of(0))
    right, wrong = evidence.evidence([truth[0], swapped(tools, hull_of(0), truth[0])])
    assert wrong < right - SETTINGS.clear_nats


def test_a_body_without_two_legs_has_none_to_exchange() -> None:
    assert legs_of(scale_body(load_body_model("anthropometric"), 1.7)) is not None
    body = scale_body(load_body_model("anthropometric"), 1.7)
    one = replace(
        body,
        landmark_joint=np.where(
            np.isin(np.arange(15), LEGS[2:]), body.landmark_joint[LEGS[0]], body.landmark_joint
        ),
    )
    assert legs_of(one) is None


def test_exchanged_legs_are_carried_back_together(tools: VolumeTools, truth: np.ndarray, hull_of) -> None:  # type: ignore[no-untyped-def]
    states = truth.copy()
    for row in (0, 1, 2):
        states[row] = swapped(tools, hull_of(row), truth[row])

    @cache
    def evidence_of(row: int) -> VolumeEvidence:
        return tools.frame(hull_of(row))

    found = repair_limbs(tools.body, states, FPS, evidence_of, RepairSettings())
    for row in (0, 1, 2):
        assert errors_m(tools, states[row], truth[row]).max() > 0.2
        assert errors_m(tools, found[row], truth[row]).max() < CLOSE_M


def followed(tools: VolumeTools, hull_of, first: np.ndarray, n: int) -> list[FramePose]:  # type: ignore[no-untyped-def]
    """A person who holds still, followed from a pose."""
    clip = PersonClip(1, np.arange(n), None, VolumeObservation(tools, lambda frame: hull_of(0)))
    return list(follow_pose(clip, range(n), first, seed=0, stage="test"))


def test_a_follower_that_begins_with_exchanged_legs_finds_out(  # type: ignore[no-untyped-def]
    tools: VolumeTools, truth: np.ndarray, hull_of
) -> None:
    poses = followed(tools, hull_of, swapped(tools, hull_of(0), truth[0]), 2)
    assert errors_m(tools, poses[-1].state, truth[0]).max() < CLOSE_M
    assert not poses[-1].doubtful.any()
    assert poses[-1].observed[LEGS].all()


def test_legs_that_nothing_shows_are_in_doubt(tools: VolumeTools, truth: np.ndarray, hull_of) -> None:  # type: ignore[no-untyped-def]
    grid, hip_m = tools.grid, landmarks_of(tools.body, truth[:1])[0, LANDMARKS.index("pelvis"), 2]
    whole, room = hull_of(0), np.arange(tools.grid.n_voxels, dtype=np.int32)
    is_low, low = grid.centers(whole.voxels)[:, 2] < hip_m, room[grid.centers(room)[:, 2] < hip_m]
    behind = PersonHull(whole.voxels[~is_low], whole.is_surface[~is_low], unknown=low)
    pose = followed(tools, lambda row: behind, truth[0], 1)[0]
    assert not pose.observed[LEGS].any()
    assert pose.observed[LANDMARKS.index("head")]
    # Legs hang straight, and what they may be off holds both strides: 2.5 deviations are the 90 % region.
    places = landmarks_of(tools.body, np.stack([pose.state, truth[0]]))
    for own in (LEGS, MIRRORED):
        off = np.linalg.norm(places[0][LEGS] - places[1][own], axis=1)
        assert np.all(2.5 * pose.hidden_std[LEGS] > off)
    assert np.all(pose.hidden_std[LANDMARKS.index("head")] == 0.0)


def test_legs_before_an_unknown_side_are_in_doubt(tools: VolumeTools, truth: np.ndarray, hull_of) -> None:  # type: ignore[no-untyped-def]
    """Feet are seen, without telling whose they are."""
    grid, whole = tools.grid, hull_of(0)
    room, foot_m = np.arange(grid.n_voxels, dtype=np.int32), 0.3
    hip_m = landmarks_of(tools.body, truth[:1])[0, LANDMARKS.index("pelvis"), 2]
    height, all_heights = grid.centers(whole.voxels)[:, 2], grid.centers(room)[:, 2]
    is_hidden = (height < hip_m) & (height > foot_m)
    unknown = room[(all_heights < hip_m) & (all_heights > foot_m)]
    behind = PersonHull(whole.voxels[~is_hidden], whole.is_surface[~is_hidden], unknown=unknown)
    pose = followed(tools, lambda row: behind, truth[0], 1)[0]
    assert pose.doubtful[LEGS].all()
    assert not pose.observed[LEGS].any()
    assert not pose.doubtful[LANDMARKS.index("head")]
    # Both places lie in the 90 % region, 2.5 deviations wide.
    found = landmarks_of(tools.body, pose.state[None])[0]
    apart = np.linalg.norm(found[LEGS] - found[MIRRORED], axis=1)
    assert np.all(2.5 * pose.hidden_std[LEGS] > 0.7 * apart)


def test_what_is_near_is_not_in_doubt(tools: VolumeTools, truth: np.ndarray) -> None:
    moved = truth[0].copy()
    moved[0] += 0.5 * SETTINGS.apart_m
    for rival in (None, moved):
        doubtful, std = in_doubt(tools.body, truth[0], rival, SETTINGS)
        assert not doubtful.any()
        assert not std.any()
    moved[0] += SETTINGS.apart_m
    doubtful, std = in_doubt(tools.body, truth[0], moved, SETTINGS)
    assert doubtful.all()
    np.testing.assert_allclose(std, SETTINGS.std_per_apart * 1.5 * SETTINGS.apart_m)


def test_frames_are_told_in_words() -> None:
    assert frames_in_words(np.array([4, 5, 6, 9, 31, 32])) == "4-6, 9, 31-32"
    assert frames_in_words(np.arange(0, 40, 2)) == "0, 2, 4, 6, 8, 10 and others"
