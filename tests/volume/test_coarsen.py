"""Hulls on larger voxels: volume, colours, and where every fine voxel goes."""

import numpy as np
import pytest

from mocap.data import VoxelGrid
from mocap.volume import coarsen, connected_components

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
