"""Kernels of the consistency of masks against their definitions in numpy, and what is kept of a clip."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from mocap.data import VoxelGrid
from mocap.volume import _kernels
from mocap.volume.consistency import _Spread, _whole_in_room

C, H, W = 3, 24, 31
Cells = np.ndarray


def blobs(seed: int, share: float) -> Cells:
    """(C, H, W) uint8 of 0 and 1: spots, some of which touch at corners only."""
    noise = np.random.default_rng(seed).random((C, H, W)).astype(np.float32)
    smooth = np.stack([cv2.blur(plane, (3, 3)) for plane in noise])
    return (smooth > np.quantile(smooth, 1 - share)).astype(np.uint8)


def met_by_definition(mask: Cells, hull: Cells) -> Cells:
    """The regions of a mask, joined by corners, that hold a cell of the silhouette."""
    n, labels = cv2.connectedComponents(mask, connectivity=8)
    met = [k for k in range(1, n) if (hull[labels == k] > 0).any()]
    return np.isin(labels, met).astype(np.uint8)


def found(masks: Cells, hulls: Cells) -> tuple[Cells, Cells, Cells]:
    own = np.zeros_like(masks)
    rects, cells = np.empty((C, 4), dtype=np.int64), np.empty(C, dtype=np.int64)
    _kernels.regions_met(masks, hulls, own, rects, cells, np.empty(H * W, dtype=np.int32))
    return own, rects, cells


@pytest.mark.parametrize("seed", range(6))
def test_regions_that_meet_a_silhouette(seed: int) -> None:
    masks, hulls = blobs(seed, 0.35), blobs(seed + 50, 0.1) * np.uint8(3)
    own, rects, cells = found(masks, hulls)
    n_regions = 0
    for c in range(C):
        expected = met_by_definition(masks[c], hulls[c])
        np.testing.assert_array_equal(own[c], expected)
        assert cells[c] == expected.sum()
        v, u = np.nonzero(expected)
        assert rects[c].tolist() == [u.min(), u.max(), v.min(), v.max()]
        n_regions += cv2.connectedComponents(masks[c], connectivity=8)[0] - 1
        assert expected.sum() < masks[c].sum()  # some meet nothing
    assert n_regions > 2 * C


def test_a_mask_that_meets_nothing_is_empty() -> None:
    masks = blobs(0, 0.3)
    own, rects, cells = found(masks, np.zeros_like(masks))
    assert not own.any()
    assert not cells.any()
    assert (rects[:, 1] < rects[:, 0]).all()


@pytest.mark.parametrize("seed", range(4))
def test_uncovered_shares_are_those_of_sets(seed: int) -> None:
    masks = blobs(seed, 0.4)
    hulls = blobs(seed + 9, 0.5) | (blobs(seed + 20, 0.3) << 1)
    hulls[0] = 0  # nobody is expected there
    hulls[1] = 0
    hulls[1, :2, :20] = 3  # hardly met
    masks[1, :2] = 0
    masks[1, 5:9, 5:9] = 1
    own, rects, cells = found(masks, masks)
    uncovered, strict = np.full((C, 5), np.nan, np.float32), np.full((C, 5), np.nan, np.float32)
    sizes = np.count_nonzero(hulls, axis=(1, 2))
    _kernels.uncovered_shares(own, cells, rects, hulls, sizes, sizes, (12.0, 0.1), 3, uncovered, strict)
    assert np.isnan(np.delete(uncovered, 3, axis=1)).all()
    assert np.isnan(uncovered[0, 3])
    assert uncovered[1, 3] == strict[1, 3] == 1.0
    inside, inside_strict = (masks[2] & hulls[2] & 1).sum(), ((masks[2] == 1) & (hulls[2] >= 2)).sum()
    assert uncovered[2, 3] == np.float32(1 - inside / masks[2].sum())
    assert strict[2, 3] == np.float32(1 - inside_strict / masks[2].sum())
    assert 0 < uncovered[2, 3] != strict[2, 3]


def test_light_of_pictures() -> None:
    rng = np.random.default_rng(4)
    before, now = rng.integers(0, 256, (2, 5, 18), dtype=np.uint8)
    mean, std, change = _kernels.light_of(now, before)
    np.testing.assert_allclose([mean, std], [now.mean(), now.std()], rtol=1e-12)
    assert change == pytest.approx(np.abs(now.astype(int) - before).mean(), rel=1e-12)


@pytest.mark.parametrize("n", [1, 7, 8, 9, 15, 16, 40, 100])
def test_what_is_kept_of_a_clip_is_the_same_when_its_length_is_known(n: int) -> None:
    made: list[int] = []

    def make(i: int) -> int:
        made.append(i)
        return i

    plain, knowing = _Spread[int](8), _Spread[int](8, n)
    for i in range(n):
        plain.add(lambda i=i: i)
    for i in range(n):
        knowing.add(lambda i=i: make(i))
    assert knowing.items == plain.items == made
    assert 1 <= len(made) < 8


@pytest.mark.parametrize(("share", "stays"), [(0.15, False), (0.25, True)])
def test_of_a_volume_that_the_room_cuts_stays_what_may_be_a_person(share: float, stays: bool) -> None:
    """Two persons at the room's sides, and a child, or what hangs between their rays, in the middle."""
    grid = VoxelGrid.from_bounds(np.array([-2.0, -2.0, 0.0]), np.array([2.0, 2.0, 2.0]), 0.05)
    filled = np.zeros(grid.shape, dtype=np.bool_)
    filled[:8, 20:30, :35] = filled[-8:, 40:48, :35] = True
    middle = np.zeros_like(filled)
    middle[35:45, 35:42, : round(share * 8 * 10 * 35 / 70)] = True
    voxels = np.flatnonzero(filled | middle).astype(np.int32)
    whole = np.flatnonzero(middle) if stays else []
    np.testing.assert_array_equal(_whole_in_room(voxels, grid), whole)
    np.testing.assert_array_equal(
        _whole_in_room(voxels[np.isin(voxels, np.flatnonzero(middle))], grid), np.flatnonzero(middle)
    )
