"""Free space and measured surfaces against closed forms: a plate and a bar before a camera."""

from __future__ import annotations

import numpy as np
import pytest

from mocap.data import Camera, VoxelGrid
from mocap.data.depth import DepthNoise
from mocap.volume.depth import DepthView, is_free, measured_surface

R = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, -1.0], [-1.0, 0.0, 0.0]])  # looks along -x from x = 3
CAMERA = Camera(
    "c", (96, 80), np.array([[90.0, 0, 47.5], [0, 92.0, 39.5], [0, 0, 1]]), np.zeros(4), R, -R @ [3.0, 0, 1.0]
)
GRID = VoxelGrid(np.array([-0.3, -0.42, 0.7]), (21, 28, 23), 0.03)
NOISE = DepthNoise(0.004, 0.001)
PLATE_M = 2.97  # depth of the plate; in the world x = 0.03


def everything() -> np.ndarray:
    return np.arange(GRID.n_voxels, dtype=np.int32)


def plate(depth_m: float = PLATE_M) -> np.ndarray:
    return np.full(CAMERA.size[::-1], depth_m, dtype=np.float32)


def view(depth_m: np.ndarray) -> DepthView:
    return DepthView(CAMERA, depth_m, NOISE)


def test_deviation_grows_with_the_square() -> None:
    np.testing.assert_allclose(NOISE.std_m(np.array([0.0, 1.0, 3.0])), [0.004, 0.005, 0.013])


def test_what_lies_well_before_the_plate_is_free_and_all_else_is_kept() -> None:
    voxels = everything()
    depth = 3.0 - GRID.centers(voxels)[:, 0]
    limit = PLATE_M - NOISE.std_m(np.array(PLATE_M)) - 0.5 * GRID.voxel_size_m
    np.testing.assert_array_equal(is_free(voxels, GRID, [view(plate())]), depth < limit)


def test_a_pixel_without_reading_says_nothing() -> None:
    depth_m = plate()
    depth_m[:, 40:52] = 0.0
    voxels = everything()
    uv = CAMERA.project(GRID.centers(voxels))[0]
    in_hole = (uv[:, 0] > 39.5) & (uv[:, 0] < 51.5)
    free = is_free(voxels, GRID, [view(depth_m)])
    assert in_hole.any()
    assert not free[in_hole].any()
    assert free[~in_hole].any()
    assert not np.isfinite(measured_surface(voxels, GRID, [view(depth_m * 0)])).any()


def test_a_voxel_at_an_edge_is_judged_by_the_nearest_reading() -> None:
    depth_m = plate(5.0)
    depth_m[:, 48:] = 2.7  # a thing stands in the right half
    voxels = everything()
    centers = GRID.centers(voxels)
    at_edge = (np.abs(CAMERA.project(centers)[0][:, 0] - 47.0) < 0.4) & (3.0 - centers[:, 0] > 2.72)
    assert at_edge.any()
    assert not is_free(voxels, GRID, [view(depth_m)])[at_edge].any()


@pytest.mark.parametrize("shift_m", [-0.02, 0.0, 0.02])
def test_surface_voxels_move_to_the_measured_plane(shift_m: float) -> None:
    voxels = everything()
    centers = GRID.centers(voxels)
    rng = np.random.default_rng(3)
    noisy = plate(PLATE_M + shift_m) + rng.normal(0.0, 0.004, CAMERA.size[::-1]).astype(np.float32)
    measured = measured_surface(voxels, GRID, [view(noisy)])
    moved = np.isfinite(measured[:, 0])
    depth = 3.0 - centers[:, 0]
    std = NOISE.std_m(depth)
    # Far within the limits all move, outside of them none.
    assert moved[np.abs(depth - PLATE_M - shift_m) < 0.01].all()
    assert not moved[depth - PLATE_M - shift_m > 0.5 * GRID.voxel_size_m + std + 0.02].any()
    assert not moved[PLATE_M + shift_m - depth > GRID.voxel_size_m + 3 * std + 0.02].any()
    near = np.abs(depth - PLATE_M - shift_m) < 0.01
    # Nine readings of 4 mm: 1.3 mm; six deviations. The sides of the window are cut off nowhere near.
    np.testing.assert_allclose(measured[near, 0], 3.0 - PLATE_M - shift_m, atol=0.008)
    # Along the line of sight: the pixel stays.
    np.testing.assert_allclose(
        CAMERA.project(measured[near].astype(np.float64))[0], CAMERA.project(centers[near])[0], atol=1e-3
    )


def test_the_far_side_of_a_thin_thing_is_not_pulled_to_its_near_side() -> None:
    voxels = everything()
    depth = 3.0 - GRID.centers(voxels)[:, 0]
    far_side = np.abs(depth - PLATE_M - 0.045) < 0.005
    assert far_side.any()
    assert not np.isfinite(measured_surface(voxels[far_side], GRID, [view(plate())])).any()


def test_no_view_and_no_voxel() -> None:
    voxels = everything()
    assert not is_free(voxels, GRID, []).any()
    assert np.isnan(measured_surface(voxels, GRID, [])).all()
    none = np.zeros(0, dtype=np.int32)
    assert is_free(none, GRID, [view(plate())]).shape == (0,)
    assert measured_surface(none, GRID, [view(plate())]).shape == (0, 3)


def test_two_views_are_averaged() -> None:
    voxels = everything()
    first, second = view(plate(PLATE_M)), view(plate(PLATE_M + 0.01))
    near = np.abs(3.0 - GRID.centers(voxels)[:, 0] - PLATE_M) < 0.01
    measured = measured_surface(voxels[near], GRID, [first, second])
    np.testing.assert_allclose(measured[:, 0], 3.0 - PLATE_M - 0.005, atol=1e-4)
