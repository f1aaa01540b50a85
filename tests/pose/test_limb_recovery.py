"""When limbs are searched for, and the cost of their jumps."""

from dataclasses import replace

import numpy as np
import pytest
from flesh_voxels import Flesh

from mocap.body import landmarks_of, neutral_state
from mocap.data import LANDMARKS
from mocap.data.problem import limbs_of
from mocap.pipeline.config import LikelihoodConfig, PoseConfig
from mocap.pipeline.pose_settings import make_tools
from mocap.pose.limb_search import LimbSchedule, first_parts, jump_nats
from mocap.pose.volume import PersonHull, VolumeTools
from mocap.volume import surface_voxels

FPS = 30.0
NATS = 3.0


@pytest.fixture(scope="module")
def tools(coarse_flesh: Flesh) -> VolumeTools:
    pose = PoseConfig(jump_nats=NATS)
    return make_tools(coarse_flesh.grid, FPS, 1.7, "anthropometric", pose, LikelihoodConfig(), 1)


def raised(tools: VolumeTools, rad: float) -> np.ndarray:
    """The neutral pose with the left arm swung about its shoulder."""
    state = neutral_state(tools.body)
    state[tools.body.layout.names.index("left_shoulder_x")] += rad
    return state


def test_what_people_can_do_in_a_frame_is_free(tools: VolumeTools) -> None:
    before, after = neutral_state(tools.body), raised(tools, 0.2)
    wrist = LANDMARKS.index("left_wrist")
    moved = landmarks_of(tools.body, np.stack([before, after]))[:, wrist]
    assert 0.08 < np.linalg.norm(moved[1] - moved[0]) < 4.0 / FPS
    assert jump_nats(tools, [before, after], before).tolist() == [0.0, 0.0]


def test_a_limb_thrown_across_the_body_costs_at_most_its_landmarks(tools: VolumeTools) -> None:
    before = neutral_state(tools.body)
    cost = jump_nats(tools, [raised(tools, 0.5), raised(tools, 2.5)], before)
    assert 0 < cost[0] < cost[1]
    assert cost[1] == pytest.approx(2 * NATS)  # elbow and wrist, whole


def test_a_person_carried_off_costs_all_landmarks(tools: VolumeTools) -> None:
    before = neutral_state(tools.body)
    away = before.copy()
    away[0] += 5.0
    assert jump_nats(tools, [away], before)[0] == pytest.approx(NATS * len(LANDMARKS))


def test_without_an_earlier_pose_or_with_no_cost_jumps_are_free(tools: VolumeTools) -> None:
    before, after = neutral_state(tools.body), raised(tools, 2.5)
    assert jump_nats(tools, [after], None)[0] == 0.0
    free = replace(tools, settings=replace(tools.settings, jump_nats=0.0))
    assert jump_nats(free, [after], before)[0] == 0.0


FITS = {1: 1.0, 2: 1.0, 4: 1.0}


def looks(values: list[float], misfit: dict[int, float] = FITS, gain: float = 0.0) -> list[tuple[int, ...]]:
    """What is looked at in frames of some evidence, when every search gains so much."""
    schedule, found = LimbSchedule(), []
    for value in values:
        due = schedule.due(value, misfit)
        schedule.note(gain if due else 0.0, due)
        found.append(due)
    return found


def test_limbs_that_fit_are_looked_at_in_turn() -> None:
    seen = [due for due in looks([100.0] * 24) if due]
    assert all(len(due) == 1 for due in seen)
    assert {due[0] for due in seen[:3]} == {1, 2, 4}
    assert len(seen) == 6


def test_a_limb_that_fits_badly_is_looked_at_more_often() -> None:
    seen = [due[0] for due in looks([100.0] * 80, {1: 1.0, 2: 6.0, 4: 1.0}) if due]
    assert seen.count(2) > seen.count(1) + seen.count(4)
    assert seen.count(1) > 0


def test_all_limbs_are_looked_at_when_the_evidence_falls() -> None:
    seen = looks([100.0, 100.0, 100.0, 90.0])
    assert seen[3] == (1, 2, 4)
    assert all(len(due) < 2 for due in seen[:3])


def test_searches_for_all_that_find_nothing_grow_rare() -> None:
    falling = [100.0 - 40.0 * k for k in range(40)]
    full = [k for k, due in enumerate(looks(falling)) if len(due) > 1]
    gaps = np.diff(full)
    assert gaps[0] < gaps[-1] == 8
    assert np.all(np.diff(gaps) >= 0)
    assert sum(len(due) > 1 for due in looks(falling, gain=5.0)) > 2 * len(full)


def test_what_was_found_is_looked_at_again_at_once() -> None:
    seen = looks([100.0] * 6, gain=5.0)
    assert all(len(due) == 1 for due in seen)


def test_a_limb_fits_as_badly_as_its_worst_part(tools: VolumeTools, coarse_flesh: Flesh) -> None:
    layout = tools.body.layout
    evidence = tools.frame(coarse_flesh.hull(neutral_state(tools.body), margin_m=0.02))
    state = raised(tools, 1.0)
    per_part = evidence.voxels.log_likelihood(state[None])[0]
    misfits = evidence.limb_misfits(state)
    assert tuple(misfits) == first_parts(layout)
    for limb in limbs_of(layout):
        assert misfits[limb[0]] == pytest.approx(max(-per_part[limb].min(), 0.0))
    assert max(misfits, key=lambda part: misfits[part]) == layout.parts.index("left_upper_arm")


def test_a_global_likelihood_has_no_limbs_to_look_at(tools: VolumeTools, coarse_flesh: Flesh) -> None:
    whole = replace(tools, likelihood=replace(tools.likelihood, factorised=False))
    evidence = whole.frame(coarse_flesh.hull(neutral_state(tools.body), margin_m=0.02))
    assert evidence.limb_misfits(neutral_state(tools.body)) == {}
    assert looks([100.0, 50.0], {}) == [(), ()]


def test_an_arm_is_looked_for_where_it_sticks_out_of_clothes_that_are_wide_all_over(
    tools: VolumeTools, coarse_flesh: Flesh
) -> None:
    body, layout = tools.body, tools.body.layout
    arm = next(limb for limb in limbs_of(layout) if limb[0] == layout.parts.index("left_upper_arm"))
    down, held_out = neutral_state(body), raised(tools, 1.5)
    clothes = coarse_flesh.hull(down, without=tuple(arm), margin_m=0.12).voxels
    voxels = np.union1d(clothes, coarse_flesh.hull(held_out).voxels).astype(np.int32)
    evidence = tools.frame(PersonHull(voxels, surface_voxels(voxels, coarse_flesh.grid)))
    assert evidence.unexplained_share(down) > 0.3

    columns, rng = layout.columns_of(arm), np.random.default_rng(0)
    low, high = layout.lower[columns], layout.upper[columns]
    drawn = np.tile(down, (2000, 1))
    drawn[:, columns] = low + rng.random((2000, len(columns))) * (high - low)
    nats = evidence.limb_terms(down)[0](drawn, arm)
    likeliest = drawn[np.argsort(-nats, kind="stable")[:20]]
    wrist = LANDMARKS.index("left_wrist")
    off = landmarks_of(body, likeliest)[:, wrist] - landmarks_of(body, held_out[None])[0, wrist]
    assert np.median(np.linalg.norm(off, axis=1)) < 0.2
