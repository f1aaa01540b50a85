"""What is below a part of somebody that hangs in the air may be his legs; below anybody else nothing is."""

from __future__ import annotations

import numpy as np
import pytest
from flesh_voxels import make_flesh

from mocap.body import landmarks_of, neutral_state
from mocap.data import LANDMARKS
from mocap.volume.lost_legs import lost_legs

FLESH = make_flesh("anthropometric", 1.74, 0.04)
GRID = FLESH.grid
BODY = FLESH.hull(neutral_state(FLESH.body)).voxels


def above(height_m: float) -> np.ndarray:
    return BODY[GRID.centers(BODY)[:, 2] > height_m]


@pytest.mark.parametrize("lost_m", [0.5, 0.8, 0.95])
def test_legs_are_straight_below(lost_m: float) -> None:
    seen = above(lost_m)
    found = lost_legs(seen, GRID)
    assert found.dtype == np.int32
    assert np.all(np.diff(found) > 0)
    assert not np.intersect1d(found, seen).size
    assert np.isin(np.setdiff1d(BODY, above(lost_m - 0.02)), found).mean() > 0.97
    centers = GRID.centers(found)
    assert centers[:, 2].max() < lost_m + 0.02
    hips = landmarks_of(FLESH.body, neutral_state(FLESH.body)[None])[0][LANDMARKS.index("pelvis"), :2]
    assert np.linalg.norm(centers[:, :2] - hips, axis=1).max() < 0.7


def test_a_stray_voxel_is_no_leg() -> None:
    seen = above(0.8)
    stray = np.union1d(seen, np.setdiff1d(BODY, above(0.1))[:1]).astype(np.int32)
    assert lost_legs(seen, GRID).size
    assert np.isin(lost_legs(seen, GRID), np.union1d(lost_legs(stray, GRID), stray)).all()


def test_who_stands_has_his_legs() -> None:
    assert not lost_legs(BODY, GRID).size


@pytest.mark.parametrize(("lowest_m", "is_lost"), [(0.34, False), (0.46, True)])
def test_who_jumps_with_his_knees_bent_has_his_legs(lowest_m: float, is_lost: bool) -> None:
    crouched = np.setdiff1d(above(lowest_m), above(lowest_m + 1.2))
    assert bool(lost_legs(crouched, GRID).size) == is_lost


def test_who_is_whole_may_hang_in_the_air() -> None:
    state = neutral_state(FLESH.body)
    state[2] += 0.46  # the feet at 0.46 m, the crown at the top of the room
    hanging = FLESH.hull(state).voxels
    assert GRID.centers(hanging)[:, 2].min() > 0.4
    assert not lost_legs(hanging, GRID).size


def test_nobody_has_no_legs() -> None:
    assert not lost_legs(np.zeros(0, dtype=np.int32), GRID).size
