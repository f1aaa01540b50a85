"""The carver against its definition, and properties that hold for every hull."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from mocap.data import Camera, CameraRig, VoxelGrid
from mocap.volume import Carver, carve_bruteforce, choose_grid, default_min_views
from mocap.volume.carve import nearest_pixel, pixels_of_points

SIZES = ((32, 24), (41, 30), (27, 35))


def random_camera(
    name: str, rng: np.random.Generator, *, is_fisheye: bool = False, n_dist: int = 4
) -> Camera:
    eye = rng.uniform(-1.0, 1.0, 3) * [2.5, 2.5, 0.8] + [0.0, 0.0, 1.2]
    target = rng.uniform(-0.4, 0.4, 3) + np.array([0.0, 0.0, 0.8])
    forward = target - eye
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, [0.05, 0.02, 1.0])
    right /= np.linalg.norm(right)
    R = Rotation.from_rotvec(rng.normal(0.0, 0.2, 3)).as_matrix() @ np.array(
        [right, np.cross(forward, right), forward]
    )
    size = SIZES[int(rng.integers(len(SIZES)))]
    focal = rng.uniform(0.4, 1.2) * size[0]
    K = np.array(
        [[focal, 0.0, size[0] / 2 + rng.normal()], [0.0, focal * 1.02, size[1] / 2], [0.0, 0.0, 1.0]]
    )
    dist = rng.normal(0.0, 0.1, n_dist) * ([1.0, 0.3, 0.05, 0.05] + [0.2] * 8)[:n_dist]
    return Camera(name, size, K, dist, R, -R @ eye, is_fisheye)


def random_scene(seed: int, n_cameras: int, density: float) -> tuple[CameraRig, VoxelGrid, list[np.ndarray]]:
    rng = np.random.default_rng(seed)
    cameras, masks = [], []
    for i in range(n_cameras):
        is_fisheye = rng.random() < 0.2
        n_dist = 4 if is_fisheye else int(rng.choice([0, 4, 5, 8]))
        cameras.append(random_camera(f"c{i}", rng, is_fisheye=is_fisheye, n_dist=n_dist))
        w, h = cameras[-1].size
        mask = rng.random((h, w)) < density * rng.random()
        v, u = int(rng.integers(h)), int(rng.integers(w))
        mask[v : v + h // 2, u : u + w // 2] = True
        masks.append(mask)
    shape = (int(rng.integers(3, 23)), int(rng.integers(3, 19)), int(rng.integers(3, 37)))
    return CameraRig(tuple(cameras)), VoxelGrid(np.array([-0.9, -0.7, 0.0]), shape, 0.083), masks


@given(
    seed=st.integers(0, 2**31),
    n_cameras=st.integers(1, 6),
    density=st.sampled_from([0.0, 0.05, 0.5, 3.0]),
    faulty=st.integers(0, 5),
    views=st.integers(0, 6),
)
@settings(max_examples=60, deadline=None)
def test_carver_equals_bruteforce_for_every_tolerance(seed, n_cameras, density, faulty, views):
    rig, grid, masks = random_scene(seed, n_cameras, density)
    k = min(faulty, n_cameras - 1)
    m = None if views == 0 else min(views, n_cameras)
    carver = Carver(rig, grid)
    expected = carve_bruteforce(rig, grid, masks, n_faulty_views=k, min_views=m)
    got = carver.carve(masks, n_faulty_views=k, min_views=m)
    assert got.dtype == np.int32
    np.testing.assert_array_equal(got, expected)
    np.testing.assert_array_equal(carver.carve(masks, n_faulty_views=k, min_views=m), expected)


def test_symmetric_rig_has_the_same_ties_in_both_implementations():
    """Voxel centres that project exactly between two pixels must round the same way."""
    cameras = []
    for i, angle in enumerate((0.0, 90.0, 180.0, 270.0)):
        a = np.deg2rad(angle)
        forward = -np.array([np.cos(a), np.sin(a), 0.0])
        right = np.cross(forward, [0.0, 0.0, 1.0])
        R = np.array([right, np.cross(forward, right), forward])
        K = np.array([[50.0, 0.0, 20.0], [0.0, 50.0, 15.0], [0.0, 0.0, 1.0]])
        cameras.append(Camera(f"c{i}", (40, 30), K, np.zeros(4), R, -R @ (-3.0 * forward + [0.0, 0.0, 0.8])))
    rig = CameraRig(tuple(cameras))
    grid = VoxelGrid(np.array([-0.8, -0.8, 0.0]), (16, 16, 16), 0.1)
    rng = np.random.default_rng(5)
    masks = [rng.random((30, 40)) < 0.7 for _ in rig]
    carver = Carver(rig, grid)
    for k in range(4):
        np.testing.assert_array_equal(
            carver.carve(masks, n_faulty_views=k), carve_bruteforce(rig, grid, masks, n_faulty_views=k)
        )


def test_pixels_of_the_kernel_are_those_of_camera_project():
    rng = np.random.default_rng(3)
    points = rng.uniform(-2.0, 2.0, (500, 3))
    kinds = [(False, 0), (False, 5), (False, 8), (True, 4), (False, 12)]
    for i, (is_fisheye, n_dist) in enumerate(kinds):
        camera = random_camera(f"c{i}", rng, is_fisheye=is_fisheye, n_dist=n_dist)
        expected = nearest_pixel(camera.project(points)[0], camera.size)
        np.testing.assert_array_equal(pixels_of_points(camera, points), expected)
        assert np.any(expected >= 0)


def test_nearest_pixel_has_its_centre_at_integers():
    uv = np.array(
        [[0.0, 0.0], [-0.49, 0.2], [-0.51, 0.2], [4.49, 2.0], [4.5, 2.0], [np.nan, 1.0], [1.0, 2.49]]
    )
    np.testing.assert_array_equal(nearest_pixel(uv, (5, 3)), [0, 0, -1, 14, -1, -1, 11])


def test_more_foreground_or_more_tolerance_only_adds_voxels():
    rig, grid, masks = random_scene(11, 5, 0.5)
    carver = Carver(rig, grid)
    previous = np.zeros(0, dtype=np.int32)
    for k in range(5):
        hull = carver.carve(masks, n_faulty_views=k, min_views=2)
        assert np.all(np.isin(previous, hull))
        previous = hull
    grown = [m | np.roll(m, 1, axis=0) for m in masks]
    before = carver.carve(masks, n_faulty_views=1, min_views=2)
    assert np.all(np.isin(before, carver.carve(grown, n_faulty_views=1, min_views=2)))


def test_camera_order_is_irrelevant():
    rig, grid, masks = random_scene(7, 5, 0.5)
    order = [3, 0, 4, 1, 2]
    other = CameraRig(tuple(rig[i] for i in order))
    for k in (0, 2):
        np.testing.assert_array_equal(
            Carver(rig, grid).carve(masks, n_faulty_views=k, min_views=3),
            Carver(other, grid).carve([masks[i] for i in order], n_faulty_views=k, min_views=3),
        )


def test_views_and_pixels_of_voxels():
    rig, grid, masks = random_scene(19, 4, 0.5)
    carver = Carver(rig, grid)
    voxels = np.arange(0, grid.n_voxels, 7, dtype=np.int32)
    pixels = np.column_stack([pixels_of_points(c, grid.centers(voxels)) for c in rig])
    np.testing.assert_array_equal(carver.pixels(voxels), pixels)
    np.testing.assert_array_equal(carver.n_seen(voxels), (pixels >= 0).sum(axis=1))
    full = [np.ones_like(m) for m in masks]
    hull = carver.carve(full, n_faulty_views=0, min_views=2)
    assert np.all(carver.n_seen(hull) >= 2)
    assert len(carver.carve([~m for m in full], n_faulty_views=0)) == 0


def test_default_min_views():
    assert [default_min_views(n) for n in (1, 2, 3, 4, 7)] == [1, 2, 3, 4, 4]


def test_mistakes_are_named():
    rig, grid, masks = random_scene(1, 3, 0.5)
    carver = Carver(rig, grid)
    with pytest.raises(ValueError, match=r"masks: expected one per camera \(3\), got 2"):
        carver.carve(masks[:2], n_faulty_views=0)
    with pytest.raises(TypeError, match="camera c0: expected a bool array"):
        carver.carve([m.astype(np.uint8) for m in masks], n_faulty_views=0)
    with pytest.raises(ValueError, match="camera c1: expected shape"):
        carver.carve([masks[0], masks[1][:-1], masks[2]], n_faulty_views=0)
    with pytest.raises(ValueError, match=r"n_faulty_views: expected 0 .. 2"):
        carver.carve(masks, n_faulty_views=3)
    with pytest.raises(ValueError, match="min_views"):
        carve_bruteforce(rig, grid, masks, n_faulty_views=0, min_views=4)


def test_a_table_that_would_not_fit_is_refused_with_numbers():
    rig, _, _ = random_scene(1, 6, 0.5)
    huge = VoxelGrid(np.zeros(3), (500, 500, 160), 0.01)
    with pytest.raises(ValueError, match=r"500 x 500 x 160 = 40,000,000 voxels and 6 cameras need \d+ MB"):
        Carver(rig, huge)
    assert Carver.table_megabytes(8, VoxelGrid(np.zeros(3), (250, 400, 100), 0.02)) < 700


def ring_rig(n_cameras: int, radius: float = 3.0) -> CameraRig:
    cameras = []
    for i in range(n_cameras):
        a = 2 * np.pi * i / n_cameras
        eye = np.array([radius * np.cos(a) + 1.0, radius * np.sin(a) - 0.5, 1.8])
        forward = np.array([1.0, -0.5, 0.9]) - eye
        forward /= np.linalg.norm(forward)
        right = np.cross(forward, [0.0, 0.0, 1.0])
        right /= np.linalg.norm(right)
        R = np.array([right, np.cross(forward, right), forward])
        K = np.array([[50.0, 0.0, 31.5], [0.0, 50.0, 23.5], [0.0, 0.0, 1.0]])
        cameras.append(Camera(f"c{i}", (64, 48), K, np.zeros(4), R, -R @ eye))
    return CameraRig(tuple(cameras))


def test_automatic_grid_holds_the_common_view_and_stays_among_the_cameras():
    rig = ring_rig(5)
    grid = choose_grid(rig, 0.05)
    assert grid.origin[2] == 0.0
    assert np.all(grid.origin[:2] < [0.2, -1.3])
    assert np.all(grid.upper[:2] > [1.8, 0.3])
    assert 2.0 < grid.upper[2] <= 2.4 + 0.05
    centers = np.array([c.center for c in rig])[:, :2]
    assert np.all(grid.origin[:2] > centers.min(axis=0) - 1.2)
    assert np.all(grid.upper[:2] < centers.max(axis=0) + 1.2)


def test_given_bounds_win_and_bad_rigs_are_named():
    rig = ring_rig(4)
    grid = choose_grid(rig, 0.1, bounds_m=((-1.0, -2.0, 0.0), (1.0, 2.0, 2.2)))
    assert grid.shape == (20, 40, 22)
    with pytest.raises(ValueError, match="voxel_size_m"):
        choose_grid(rig, 0.0)
    away = [Camera(c.name, c.size, c.K, c.dist, c.R, c.t + np.array([0.0, 50.0, 0.0])) for c in rig]
    with pytest.raises(ValueError, match="no point between the cameras"):
        choose_grid(CameraRig(tuple(away)), 0.1)


def test_an_automatic_grid_always_fits_the_tables():
    rig = ring_rig(6, radius=4.5)
    grid = choose_grid(rig, 0.012)
    assert Carver.table_megabytes(len(rig), grid) < 700


def test_hull_of_a_sphere_contains_it():
    rig = ring_rig(6)
    grid = choose_grid(rig, 0.08)
    center, radius = np.array([1.0, -0.5, 1.0]), 0.45
    masks = []
    for camera in rig:
        w, h = camera.size
        uv = np.stack(np.meshgrid(np.arange(w), np.arange(h)), axis=-1).astype(np.float64)
        rays = camera.rays(uv)
        along = (center - camera.center) @ np.moveaxis(rays, -1, 0).reshape(3, -1)
        gap2 = np.sum((center - camera.center) ** 2) - along**2
        # Half a pixel diagonal of margin: a centre may project onto a pixel whose own ray misses the sphere.
        slack = 0.5 * np.sqrt(2) / camera.K[0, 0] * along
        masks.append((gap2 <= (radius + slack) ** 2).reshape(h, w))
    hull = Carver(rig, grid).carve(masks, n_faulty_views=0)
    all_voxels = np.arange(grid.n_voxels, dtype=np.int32)
    in_sphere = np.linalg.norm(grid.centers(all_voxels) - center, axis=1) <= radius
    assert np.isin(all_voxels[in_sphere], hull).all()
    assert len(hull) < 2.5 * np.count_nonzero(in_sphere)
