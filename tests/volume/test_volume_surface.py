"""Surface, smoothed map, visibility, colour, components and residuals against scipy, numpy and closed forms."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage

from mocap.data import Camera, CameraRig, Hull, VoxelGrid
from mocap.volume import (
    colour_hull,
    connected_components,
    silhouette_residuals,
    surface_map,
    surface_voxels,
    visible_views,
)
from mocap.volume.surface import bounds_within, gaussian_weights, mark_unknown, subscripts_and_bounds

GRID = VoxelGrid(np.array([-0.5, -0.3, 0.0]), (11, 13, 17), 0.1)
# One level of 127: a value on a rounding boundary may fall either way in float32.
ONE_LEVEL = 1


def random_voxels(seed: int, share: float, grid: VoxelGrid = GRID) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return np.flatnonzero(rng.random(grid.n_voxels) < share).astype(np.int32)


@given(seed=st.integers(0, 10_000), share=st.sampled_from([0.0, 0.01, 0.3, 0.9, 1.0]))
@settings(max_examples=25, deadline=None)
def test_surface_is_what_erosion_removes(seed, share):
    voxels = random_voxels(seed, share)
    dense = GRID.dense(voxels)
    inner = ndimage.binary_erosion(dense)  # border value 0: outside the grid is empty
    np.testing.assert_array_equal(surface_voxels(voxels, GRID), ~inner.ravel()[voxels])


@given(seed=st.integers(0, 10_000))
@settings(max_examples=25, deadline=None)
def test_surface_beside_unknown_voxels_is_that_of_both(seed):
    voxels = random_voxels(seed, 0.4)
    unknown = np.setdiff1d(random_voxels(seed + 1, 0.3), voxels).astype(np.int32)
    both = np.union1d(voxels, unknown).astype(np.int32)
    expected = surface_voxels(both, GRID)[np.searchsorted(both, voxels)]
    np.testing.assert_array_equal(surface_voxels(voxels, GRID, unknown), expected)


@given(seed=st.integers(0, 10_000))
@settings(max_examples=25, deadline=None)
def test_bounds_and_marks_of_unknown_voxels_equal_numpy(seed):
    unknown = random_voxels(seed, 0.02)
    subs, lower, upper = subscripts_and_bounds(unknown, GRID)
    np.testing.assert_array_equal(subs, GRID.subscripts(unknown))
    np.testing.assert_array_equal(lower, subs.min(axis=0))
    np.testing.assert_array_equal(upper, subs.max(axis=0) + 1)
    low, high = np.array([2, 3, 5]), np.array([7, 9, 12])
    near = subs[np.all((subs >= low) & (subs <= high), axis=1)]
    bounds = bounds_within(subs, low, high)
    if len(near):
        np.testing.assert_array_equal(bounds, [near.min(axis=0), near.max(axis=0) + 1])
    else:
        assert bounds is None
    packed, corner = np.full((6, 7, 8), 1, dtype=np.uint8), np.array([1, 2, 4])
    expected = packed.copy()
    at = subs - corner
    at = at[np.all((at > 0) & (at < np.array(packed.shape) - 1), axis=1)]
    expected[tuple(at.T)] |= 192
    mark_unknown(packed, corner, subs, 192)
    np.testing.assert_array_equal(packed, expected)


def test_no_voxels_have_no_bounds():
    assert bounds_within(np.zeros((0, 3), dtype=np.int32), np.zeros(3, int), np.full(3, 9)) is None


@given(
    seed=st.integers(0, 10_000), share=st.sampled_from([0.0, 0.02, 0.2, 0.3]), n=st.sampled_from([6, 18, 26])
)
@settings(max_examples=40, deadline=None)
def test_components_equal_scipy(seed, share, n):
    voxels = random_voxels(seed, share)
    labels, count = connected_components(voxels, GRID, connectivity=n)
    structure = ndimage.generate_binary_structure(3, {6: 1, 18: 2, 26: 3}[n])
    theirs, their_count = ndimage.label(GRID.dense(voxels), structure)
    theirs = theirs.ravel()[voxels]
    assert count == their_count
    pairs = set(zip(labels.tolist(), theirs.tolist(), strict=True))
    assert len(pairs) == count
    sizes = np.bincount(labels, minlength=count)
    assert np.all(np.diff(sizes) <= 0)
    assert labels.dtype == np.int32


def test_components_do_not_wrap_round_the_grid():
    subs = np.array([[2, 3, 16], [2, 4, 0], [2, 12, 5], [3, 0, 5]])
    voxels = np.sort(GRID.linear(subs))
    assert connected_components(voxels, GRID)[1] == 4
    with pytest.raises(ValueError, match="connectivity"):
        connected_components(voxels, GRID, connectivity=8)
    with pytest.raises(ValueError, match="ascending"):
        connected_components(voxels[::-1], GRID)


@given(seed=st.integers(0, 10_000), sigma=st.sampled_from([0.0, 0.7, 1.0, 1.6]))
@settings(max_examples=20, deadline=None)
def test_surface_map_equals_separable_convolution(seed, sigma):
    voxels = random_voxels(seed, 0.15)
    is_surface = surface_voxels(voxels, GRID)
    lower, upper = np.array([-2, 4, 3]), np.array([9, 15, 14])
    packed = surface_map(voxels, is_surface, GRID, lower, upper, sigma)
    assert packed.shape == (11, 11, 11)
    pad = 10
    surface = np.pad(GRID.dense(voxels[is_surface]).astype(np.float64), pad)
    occupied = np.pad(GRID.dense(voxels), pad)
    weights = gaussian_weights(sigma).astype(np.float64)
    for axis in range(3):
        surface = ndimage.convolve1d(surface, weights, axis=axis, mode="constant")
    window = tuple(slice(lo + pad, hi + pad) for lo, hi in zip(lower, upper, strict=True))
    level = np.minimum(surface[window] / weights.max() * 127, 127)
    border = np.ones(packed.shape, dtype=bool)
    border[1:-1, 1:-1, 1:-1] = False
    assert np.all(packed[border] == 0)
    np.testing.assert_array_equal((packed >= 128)[~border], occupied[window][~border])
    assert np.abs((packed & 127).astype(int) - level)[~border].max() <= ONE_LEVEL


@pytest.mark.parametrize("sigma", [0.5, 1.0, 1.6])
def test_weights_of_the_surface_map_reach_two_sigma(sigma):
    weights = gaussian_weights(sigma)
    r = len(weights) // 2
    assert r == np.ceil(2 * sigma)
    expected = np.exp(-0.5 * (np.arange(-r, r + 1) / sigma) ** 2)
    np.testing.assert_allclose(weights, expected / expected.sum(), rtol=1e-6)


def test_surface_map_of_a_flat_sheet_is_one_on_it():
    dense = np.zeros(GRID.shape, dtype=bool)
    dense[:, :, 8] = True
    voxels = np.flatnonzero(dense).astype(np.int32)
    packed = surface_map(voxels, surface_voxels(voxels, GRID), GRID, (0, 0, 0), (11, 13, 17), 1.0)
    column = packed[5, 6]
    assert column[8] == 128 + 127
    assert np.all(np.diff((column & 127).astype(int)[8:13]) <= 0)
    assert column[9] == round(127 * np.exp(-0.5))
    assert column[12] == 0


def test_empty_sets_give_empty_answers():
    none = np.zeros(0, dtype=np.int32)
    assert surface_voxels(none, GRID).shape == (0,)
    assert connected_components(none, GRID) == (pytest.approx(np.zeros(0)), 0)
    assert not surface_map(none, np.zeros(0, dtype=bool), GRID, (0, 0, 0), (3, 4, 5)).any()
    hull = colour_hull(none, np.zeros(0, dtype=bool), GRID, two_cameras(), None)
    assert len(hull) == 0
    assert hull.rgb.shape == (0, 3)
    residuals = silhouette_residuals(hull, [np.ones((30, 40), bool), np.zeros((22, 36), bool)], two_cameras())
    assert residuals.uncovered[0] == 1.0
    assert np.isnan(residuals.uncovered[1])
    assert np.isnan(residuals.surplus).all()


def two_cameras(offset: np.ndarray | None = None) -> CameraRig:
    """One on the +x side looking along -x, one on the -x side looking along +x, at the middle of GRID."""
    target = np.array([0.05, 0.35, 0.85]) + (np.zeros(3) if offset is None else offset)
    cameras = []
    for i, (side, size) in enumerate(((1.0, (40, 30)), (-1.0, (36, 22)))):
        forward = np.array([-side, 0.0, 0.0])
        right = np.cross(forward, [0.0, 0.0, 1.0])
        R = np.array([right, np.cross(forward, right), forward])
        eye = target - 4.0 * forward
        K = np.array([[60.0, 0.0, (size[0] - 1) / 2], [0.0, 60.0, (size[1] - 1) / 2], [0.0, 0.0, 1.0]])
        cameras.append(Camera(f"c{i}", size, K, np.zeros(0), R, -R @ eye))
    return CameraRig(tuple(cameras))


def test_a_wall_is_seen_from_its_own_side_and_coloured_by_it():
    dense = np.zeros(GRID.shape, dtype=bool)
    dense[3:8, 4:10, 5:12] = True
    voxels = np.flatnonzero(dense).astype(np.int32)
    rig = two_cameras()
    images = [np.full((30, 40, 3), (200, 10, 10), np.uint8), np.full((22, 36, 3), (10, 10, 220), np.uint8)]
    is_surface = surface_voxels(voxels, GRID)
    visible, pixels = visible_views(voxels, is_surface, GRID, rig)
    assert visible.shape == (len(voxels), 2)
    assert np.all(pixels[~is_surface] == -1)
    subs = GRID.subscripts(voxels)
    middle = (subs[:, 1] > 5) & (subs[:, 1] < 8) & (subs[:, 2] > 6) & (subs[:, 2] < 10)
    front, back = middle & (subs[:, 0] == 7), middle & (subs[:, 0] == 3)
    assert np.all(visible[front] == [True, False])
    assert np.all(visible[back] == [False, True])
    hull = colour_hull(voxels, is_surface, GRID, rig, images)
    assert np.all(hull.rgb[front] == (200, 10, 10))
    assert np.all(hull.rgb[back] == (10, 10, 220))
    assert np.all(hull.n_views[~is_surface] == 0)
    assert np.all(hull.rgb[hull.n_views == 0] == 0)
    both = hull.n_views == 2
    assert np.all(hull.rgb[both] == (105, 10, 115))
    assert not colour_hull(voxels, is_surface, GRID, rig, None).rgb.any()
    with pytest.raises(ValueError, match="images: expected"):
        colour_hull(voxels, is_surface, GRID, rig, images[::-1])


@given(seed=st.integers(0, 10_000))
@settings(max_examples=15, deadline=None)
def test_line_of_sight_agrees_with_segment_box_intersection(seed):
    """A voxel blocks when the segment runs inside it for a length; grazed corners (1e-9) may count either way."""
    rig = two_cameras(offset=np.array([0.0, 0.0131, 0.0071]))
    voxels = random_voxels(seed, 0.03)
    visible, pixels = visible_views(voxels, np.ones(len(voxels), dtype=bool), GRID, rig)
    subs = GRID.subscripts(voxels)
    n_blocked = 0
    for i in range(0, len(voxels), 3):
        for c, camera in enumerate(rig):
            if pixels[i, c] < 0:
                assert not visible[i, c]
                continue
            start = subs[i] + 0.5
            along = (camera.center - GRID.origin) / GRID.voxel_size_m - start
            far = np.abs(subs - subs[i]).max(axis=1) > 1
            ends = (np.stack([subs[far], subs[far] + 1]) - start) / along
            enter = np.maximum(ends.min(axis=0).max(axis=1), 0.0)
            leave = np.minimum(ends.max(axis=0).min(axis=1), 1.0)
            longest = (leave - enter).max(initial=-1.0)
            if abs(longest) > 1e-9:
                assert visible[i, c] == (longest < 0)
            n_blocked += longest > 0
    assert n_blocked > 0


def test_residuals_of_a_fitting_and_of_a_shifted_camera():
    dense = np.zeros(GRID.shape, dtype=bool)
    dense[3:8, 4:10, 5:12] = True
    voxels = np.flatnonzero(dense).astype(np.int32)
    rig = two_cameras()
    is_surface = surface_voxels(voxels, GRID)
    zeros = np.zeros(len(voxels), dtype=np.uint8)
    hull = Hull(GRID, voxels, is_surface, zeros, np.zeros((len(voxels), 3), np.uint8))
    masks = []
    for camera in rig:
        uv, _ = camera.project(GRID.centers(voxels))
        mask = np.zeros((camera.size[1], camera.size[0]), dtype=bool)
        columns, rows = np.round(uv).astype(int).T
        mask[rows, columns] = True
        masks.append(mask)
    good = silhouette_residuals(hull, masks, rig)
    assert np.all(good.uncovered == 0)
    masks[1] = np.roll(masks[1], 6, axis=1)
    bad = silhouette_residuals(hull, masks, rig)
    assert bad.uncovered[0] == 0
    assert bad.uncovered[1] > 0.3


def test_depth_buffer_agrees_with_the_line_walk_on_a_convex_body():
    """On a ball both must see the near side and not the far one; at the rim they may differ."""
    rig = two_cameras()
    centers = GRID.centers(np.arange(GRID.n_voxels, dtype=np.int32))
    middle = np.array([0.05, 0.35, 0.85])
    voxels = np.flatnonzero(np.linalg.norm(centers - middle, axis=1) < 0.42).astype(np.int32)
    is_surface = surface_voxels(voxels, GRID)
    line, pixels = visible_views(voxels, is_surface, GRID, rig)
    buffer, same_pixels = visible_views(voxels, is_surface, GRID, rig, "zbuffer")
    np.testing.assert_array_equal(pixels, same_pixels)
    assert not buffer[pixels < 0].any()
    towards = centers[voxels] - middle
    for c, side in enumerate((1.0, -1.0)):
        near = is_surface & (side * towards[:, 0] > 0.25) & (pixels[:, c] >= 0)
        far = is_surface & (side * towards[:, 0] < -0.25)
        assert near.any()
        assert far.any()
        assert buffer[near, c].all()
        assert not buffer[far, c].any()
        assert line[near, c].all()
        assert not line[far, c].any()
    hull = colour_hull(voxels, is_surface, GRID, rig, None, "zbuffer")
    np.testing.assert_array_equal(hull.n_views, buffer.sum(axis=1))
    with pytest.raises(ValueError, match="visibility"):
        visible_views(voxels, is_surface, GRID, rig, "rays")


def test_a_body_hides_another_from_the_depth_buffer():
    dense = np.zeros(GRID.shape, dtype=bool)
    dense[8:10, 2:11, 3:14] = True  # a wall on the +x side, before camera 0
    dense[2:4, 5:8, 6:10] = True  # a block behind it
    voxels = np.flatnonzero(dense).astype(np.int32)
    is_surface = surface_voxels(voxels, GRID)
    behind = is_surface & (GRID.subscripts(voxels)[:, 0] < 5)
    for visibility in ("line", "zbuffer"):
        visible, _ = visible_views(voxels, is_surface, GRID, two_cameras(), visibility)
        assert not visible[behind, 0].any()
        assert visible[behind & (GRID.subscripts(voxels)[:, 0] == 2), 1].all()


def test_a_voxel_that_two_cameras_see_has_the_mean_colour():
    dense = np.zeros(GRID.shape, dtype=bool)
    dense[3:8, 4:10, 5:12] = True
    voxels = np.flatnonzero(dense).astype(np.int32)
    near = two_cameras()[0]
    beside = dataclasses.replace(near, name="beside", t=near.t + np.array([0.05, 0.0, 0.0]))
    images = [
        np.full((30, 40, 3), (200, 10, 11), np.uint8),
        np.full((30, 40, 3), (101, 30, 220), np.uint8),
    ]
    is_surface = surface_voxels(voxels, GRID)
    hull = colour_hull(voxels, is_surface, GRID, CameraRig((near, beside)), images)
    both = hull.n_views == 2
    assert both.sum() > 20
    np.testing.assert_array_equal(hull.rgb[both], np.tile([151, 20, 116], (both.sum(), 1)))
