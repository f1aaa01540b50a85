"""Hulls on larger voxels: volume, colours, and where every fine voxel goes."""

import numpy as np
import pytest

from mocap.data import VoxelGrid
from mocap.volume import _coarsen_kernels, coarsen, connected_components

GRID = VoxelGrid(np.array([-0.4, 0.2, 0.0]), (31, 24, 45), 0.02)


def ball(centre, radius):
    every = np.arange(GRID.n_voxels, dtype=np.int32)
    return every[np.linalg.norm(GRID.centers(every) - centre, axis=1) <= radius]


@pytest.mark.parametrize("side", [0.02, 0.03, 0.04, 0.05])
def test_volume_and_centroid_stay_what_they_were(side):
    voxels = ball([-0.1, 0.45, 0.4], 0.19)
    coarse = coarsen(voxels, GRID, side)
    assert coarse.grid.voxel_size_m == side
    np.testing.assert_array_equal(coarse.grid.origin, GRID.origin)
    litres = len(voxels) * 0.02**3 * 1000
    # A shell of half a coarse voxel is uncertain either way; over the ball it averages out.
    assert len(coarse.voxels) * side**3 * 1000 == pytest.approx(litres, rel=0.1)
    np.testing.assert_allclose(
        coarse.grid.centers(coarse.voxels).mean(axis=0), GRID.centers(voxels).mean(axis=0), atol=0.25 * side
    )


def test_same_size_changes_nothing():
    rng = np.random.default_rng(0)
    voxels = np.flatnonzero(rng.random(GRID.n_voxels) < 0.1).astype(np.int32)
    rgb = rng.integers(0, 256, (len(voxels), 3), dtype=np.uint8)
    known = rng.random(len(voxels)) < 0.5
    same = coarsen(voxels, GRID, 0.02, rgb, known)
    np.testing.assert_array_equal(same.voxels, voxels)
    np.testing.assert_array_equal(same.row_of, np.arange(len(voxels)))
    np.testing.assert_array_equal(same.has_colour, known)
    np.testing.assert_array_equal(same.rgb[known], rgb[known])


def test_half_full_counts_and_less_does_not():
    """Blocks of 2 x 2 x 2 fine voxels: four of them make a coarse one, three do not."""
    grid = VoxelGrid(np.zeros(3), (4, 2, 6), 0.02)
    four = [(0, 0, 0), (0, 1, 0), (1, 0, 1), (1, 1, 1)]
    three = [(2, 0, 4), (2, 1, 4), (3, 1, 5)]
    voxels = np.sort(grid.linear(np.array(four + three)))
    coarse = coarsen(voxels, grid, 0.04)
    assert coarse.grid.subscripts(coarse.voxels).tolist() == [[0, 0, 0]]
    # The three have no occupied neighbour: their own block is two away along z.
    lonely = grid.subscripts(voxels)[:, 2] >= 4
    assert (coarse.row_of[lonely] == -1).all()
    assert (coarse.row_of[~lonely] == 0).all()


def test_fine_voxels_of_an_empty_block_go_to_the_nearest_occupied_one():
    grid = VoxelGrid(np.zeros(3), (6, 4, 4), 0.02)
    block = [(x, y, z) for x in (0, 1) for y in (0, 1) for z in (0, 1)]
    block += [(x, y, z) for x in (4, 5) for y in (0, 1) for z in (0, 1)]
    voxels = np.sort(grid.linear(np.array([*block, (2, 0, 0), (3, 1, 1)])))
    coarse = coarsen(voxels, grid, 0.04)
    where = grid.subscripts(voxels)
    left, right = coarse.row_of[where[:, 0] == 2], coarse.row_of[where[:, 0] == 3]
    assert coarse.grid.subscripts(coarse.voxels)[left, 0].tolist() == [0]
    assert coarse.grid.subscripts(coarse.voxels)[right, 0].tolist() == [2]


def test_colour_is_the_mean_of_the_known_ones():
    grid = VoxelGrid(np.zeros(3), (2, 2, 2), 0.02)
    voxels = np.arange(8, dtype=np.int32)
    rgb = np.zeros((8, 3), dtype=np.uint8)
    rgb[:3] = [[10, 0, 250], [20, 0, 250], [33, 0, 250]]
    rgb[3:] = 99
    coarse = coarsen(voxels, grid, 0.04, rgb, np.arange(8) < 3)
    assert coarse.rgb.tolist() == [[21, 0, 250]]
    assert coarse.has_colour.tolist() == [True]
    assert not coarsen(voxels, grid, 0.04, rgb, np.zeros(8, dtype=bool)).has_colour.any()


def test_bodies_stay_apart_and_nothing_is_nothing():
    two = np.union1d(ball([-0.25, 0.45, 0.4], 0.1), ball([0.1, 0.45, 0.4], 0.1)).astype(np.int32)
    coarse = coarsen(two, GRID, 0.05)
    assert connected_components(coarse.voxels, coarse.grid)[1] == 2
    empty = coarsen(np.zeros(0, dtype=np.int32), GRID, 0.05)
    assert (len(empty.voxels), empty.row_of.shape, empty.rgb.shape) == (0, (0,), (0, 3))


def test_finer_voxels_are_refused():
    with pytest.raises(ValueError, match=r"voxel_size_m is 0\.01"):
        coarsen(np.zeros(0, dtype=np.int32), GRID, 0.01)


def by_sorting(voxels, grid, side, rgb, known):
    """The same with numpy: sort the coarse cells, then look for every loose voxel's 26 neighbours one by one."""
    upper = grid.origin + np.array(grid.shape) * grid.voxel_size_m
    coarse = VoxelGrid.from_bounds(grid.origin, upper, side)
    ratio = grid.voxel_size_m / side
    axes = [
        np.minimum(np.floor((np.arange(n) + 0.5) * ratio + 1e-9).astype(int), m - 1)
        for n, m in zip(grid.shape, coarse.shape, strict=True)
    ]
    subs = grid.subscripts(voxels)
    cell = np.column_stack([axis[subs[:, i]] for i, axis in enumerate(axes)])
    rooms = [np.bincount(axis, minlength=m) for axis, m in zip(axes, coarse.shape, strict=True)]
    found, count = np.unique(cell, axis=0, return_counts=True)
    room = np.prod([r[found[:, i]] for i, r in enumerate(rooms)], axis=0)
    occupied = found[2 * count >= room]
    row_of = np.array([next((k for k, o in enumerate(occupied) if (o == c).all()), -1) for c in cell])
    own = row_of.copy()
    for i in np.flatnonzero(row_of < 0):
        beside = np.flatnonzero(np.abs(occupied - cell[i]).max(axis=1) <= 1)
        if len(beside):
            gap = np.linalg.norm(occupied[beside] + 0.5 - (subs[i] + 0.5) * ratio, axis=1)
            row_of[i] = beside[np.argmin(gap)]
    colours = np.zeros((len(occupied), 3), dtype=np.uint8)
    has = np.zeros(len(occupied), dtype=bool)
    for k in range(len(occupied)):
        mine = (own == k) & known
        if mine.any():
            has[k] = True
            colours[k] = np.floor(rgb[mine].mean(axis=0) + 0.5)
    return coarse.linear(occupied), colours, has, row_of


@pytest.mark.parametrize("side", [0.02, 0.03, 0.05, 0.07])
def test_blocks_and_sorting_agree(side):
    """Noise of which a part of the cells is half full, in a grid that is no multiple of them as well."""
    grid = VoxelGrid(np.array([0.3, -0.2, 0.0]), (11, 8, 13), 0.02)
    rng = np.random.default_rng(int(side * 100))
    voxels = np.flatnonzero(rng.random(grid.n_voxels) < 0.45).astype(np.int32)
    rgb = rng.integers(0, 256, (len(voxels), 3), dtype=np.uint8)
    known = rng.random(len(voxels)) < 0.2
    coarse = coarsen(voxels, grid, side, rgb, known)
    expected = by_sorting(voxels, grid, side, rgb, known)
    for ours, theirs in zip(
        (coarse.voxels, coarse.rgb, coarse.has_colour, coarse.row_of), expected, strict=True
    ):
        np.testing.assert_array_equal(ours, theirs)
    assert len(coarse.voxels) > 0


def test_kernels_equal_their_python():
    grid = VoxelGrid(np.zeros(3), (7, 6, 9), 0.02)
    rng = np.random.default_rng(5)
    subs = np.argwhere(rng.random(grid.shape) < 0.4).astype(np.int32)
    cells = [np.arange(n) * 2 // 5 for n in grid.shape]
    rooms = [np.bincount(c) for c in cells]
    lower, shape = np.zeros(3, dtype=np.int64), tuple(int(c[-1]) + 1 for c in cells)
    rgb = rng.integers(0, 256, (len(subs), 3), dtype=np.uint8)
    results = []
    for kind in ("fast", "slow"):
        f = {
            name: getattr(_coarsen_kernels, name)
            if kind == "fast"
            else getattr(_coarsen_kernels, name).py_func
            for name in ("count_cells", "number_full_cells", "rows_of_fine", "mean_colours")
        }
        count, row = np.zeros(shape, dtype=np.int32), np.empty(shape, dtype=np.int32)
        voxels, row_of = np.zeros(count.size, dtype=np.int32), np.empty(len(subs), dtype=np.int64)
        place = f["count_cells"](subs, *cells, lower, count)
        n = f["number_full_cells"](count, *rooms, lower, *shape[1:], row, voxels)
        f["rows_of_fine"](subs, place, lower, 0.4, row, row_of)
        total, coloured = np.zeros((n, 3), dtype=np.int64), np.zeros(n, dtype=np.int64)
        f["mean_colours"](place, row, rgb, np.arange(len(subs)) % 3 > 0, total, coloured)
        results.append((place, count, row, voxels, row_of, total, coloured))
    for fast, slow in zip(*results, strict=True):
        np.testing.assert_array_equal(fast, slow)
        assert np.any(fast)
