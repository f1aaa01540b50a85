"""What other cameras let one see: shadows on the floor, a cut that is far too large, one that is too small."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from test_occluders import on_floor, ring_rig, standing_silhouettes

from mocap.data import VoxelGrid
from mocap.volume import Witness

AT = np.array([0.1, -0.2])
ROOM = VoxelGrid.from_bounds(np.array([-1.5, -1.5, 0.0]), np.array([1.5, 1.5, 2.0]), 0.04)
BESIDE_PX = 8  # a foot's reach of 0.14 m at 3 m and 150 px focal length, and a voxel


@pytest.fixture(scope="module")
def witness() -> Witness:
    return Witness(ring_rig(), ROOM)


@pytest.fixture(scope="module")
def silhouettes() -> list[np.ndarray]:
    return standing_silhouettes(AT)


def grown(mask: np.ndarray, px: int) -> np.ndarray:
    return cv2.dilate(mask.astype(np.uint8), np.ones((2 * px + 1,) * 2, np.uint8)) > 0


def test_regions_hold_the_person_and_not_his_shadow(witness: Witness, silhouettes: list[np.ndarray]) -> None:
    shadow = [on_floor(i, AT + np.array([0.9, 0.6]), 0.3) for i in range(len(silhouettes))]
    regions = witness.regions([s | d for s, d in zip(silhouettes, shadow, strict=True)])
    for region, person, dark in zip(regions, silhouettes, shadow, strict=True):
        assert region[person].all()
        assert not region[dark & ~grown(person, 2 * BESIDE_PX)].any()


def test_feet_that_never_move_are_in_the_region(witness: Witness, silhouettes: list[np.ndarray]) -> None:
    """Nothing moves below a quarter of the person's height."""
    active = []
    for person in silhouettes:
        rows = np.flatnonzero(person.any(axis=1))
        upper = person.copy()
        upper[rows[0] + round(0.8 * len(rows)) :] = False
        active.append(upper)
    for region, person in zip(witness.regions(active), silhouettes, strict=True):
        assert region[person].mean() > 0.99


def test_a_cut_that_is_off_is_put_right(witness: Witness, silhouettes: list[np.ndarray]) -> None:
    cuts = [s.copy() for s in silhouettes]
    cuts[0][:, 20:] = True
    rows = np.flatnonzero(cuts[1].any(axis=1))
    cuts[1][rows[0] + len(rows) // 2 :] = False
    corrected = witness.corrected(cuts)
    for (allowed, likely), person in zip(corrected, silhouettes, strict=True):
        assert allowed[person].mean() > 0.98
        assert np.count_nonzero(allowed) < 3 * np.count_nonzero(person)
        assert not np.any(likely & ~allowed)
    lower = silhouettes[1] & ~cuts[1]
    assert corrected[1][1][lower].mean() > 0.2  # 24 pixels wide, without a rim of 7 on both sides


def test_lower_legs_and_heads_that_all_cuts_lack_are_allowed(
    witness: Witness, silhouettes: list[np.ndarray]
) -> None:
    cuts = []
    for person in silhouettes:
        rows, cut = np.flatnonzero(person.any(axis=1)), person.copy()
        cut[: rows[0] + round(0.12 * len(rows))] = False
        cut[rows[0] + round(0.72 * len(rows)) :] = False
        cuts.append(cut)
    for (allowed, likely), person, cut in zip(witness.corrected(cuts), silhouettes, cuts, strict=True):
        assert allowed[person].mean() > 0.97
        assert np.count_nonzero(allowed) < 3 * np.count_nonzero(person)
        # Only the picture can say that they are his.
        assert not likely[person & ~grown(cut, 2)].any()


def test_nobody_gives_nothing(witness: Witness, silhouettes: list[np.ndarray]) -> None:
    empty = [np.zeros_like(s) for s in silhouettes]
    assert not any(region.any() for region in witness.regions(empty))
    assert not any(allowed.any() or likely.any() for allowed, likely in witness.corrected(empty))
