"""The carver against its definition, and properties that hold for every hull."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from mocap.data import Camera, CameraRig, VoxelGrid
from mocap.volume import Carver, carve_bruteforce, choose_grid, default_min_views, votes_bruteforce
from mocap.volume.carve import _votes_of_planes, nearest_pixel, pixels_of_points

SIZES = ((32, 24), (41, 30), (27, 35))
SMALLEST_TABLE_MB = 0.12  # about one block of 16 with seven cameras


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


def hard_scene(seed: int) -> tuple[CameraRig, VoxelGrid, list[np.ndarray]]:
    """As random_scene, harder: 1 to 11 cameras, anywhere and of any kind, grids of up to five blocks of 16 a side."""
    rng = np.random.default_rng(seed)
    n_cameras = int(rng.integers(1, 12))
    rig, _, masks = random_scene(seed + 1, n_cameras, float(rng.choice([0.0, 0.05, 0.5, 3.0])))
    cameras = list(rig)
    for i in np.flatnonzero(rng.random(n_cameras) < 0.3):
        # inside the grid, looking anywhere, with a lens that folds back or twelve coefficients
        R = Rotation.from_rotvec(rng.normal(0.0, 2.0, 3)).as_matrix()
        dist = rng.normal(0.0, 0.6, int(rng.choice([4, 5, 8, 12]))) * 0.5
        eye = rng.uniform(-0.5, 0.5, 3) + np.array([0.0, 0.0, 1.0])
        cameras[i] = Camera(cameras[i].name, cameras[i].size, cameras[i].K, dist, R, -R @ eye)
    for mask in masks:
        if rng.random() < 0.15:
            mask[:] = rng.random() < 0.5
    shape = tuple(int(rng.integers(1, n)) for n in (66, 41, 50))
    side = float(rng.uniform(0.02, 0.12))
    return CameraRig(tuple(cameras)), VoxelGrid(rng.uniform(-1.0, 0.2, 3), shape, side), masks


@given(
    seed=st.integers(0, 2**31),
    n_cameras=st.integers(1, 6),
    density=st.sampled_from([0.0, 0.05, 0.5, 3.0]),
    faulty=st.integers(0, 5),
    views=st.integers(0, 6),
)
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


def all_votes(rig, grid):
    """(tolerance, min_views, outside) in all combinations."""
    n = len(rig)
    views = sorted({1, (n + 1) // 2, n})
    return [(k, m, o) for k in range(n) for m in views for o in ("abstain", "background")]


def check_every_vote(seed: int) -> None:
    rig, grid, masks = hard_scene(seed)
    carver = Carver(rig, grid)
    small = Carver(rig, grid, max_table_mb=3 * SMALLEST_TABLE_MB)
    parts = list(zip(*_votes_of_planes(rig, grid, masks), strict=True))
    voxels, _, n_seen, n_votes = (np.concatenate(p) for p in parts)
    for k, m, outside in all_votes(rig, grid):
        missing = (n_seen if outside == "abstain" else len(rig)) - n_votes
        expected = voxels[(n_seen >= m) & (missing <= k)]
        for one in (carver, small):
            got = one.carve(masks, n_faulty_views=k, min_views=m, outside=outside)
            np.testing.assert_array_equal(got, expected)
    for min_votes in range(1, len(rig) + 1):
        keep = n_votes >= min_votes
        for one in (carver, small):
            soft = one.votes(masks, min_votes=min_votes)
            np.testing.assert_array_equal(soft.voxels, voxels[keep])
            np.testing.assert_array_equal(soft.n_votes, n_votes[keep])
            np.testing.assert_array_equal(soft.n_seen, n_seen[keep])


@given(seed=st.integers(0, 2**31))
@settings(max_examples=15)
def test_every_tolerance_policy_and_vote_count_equals_the_definition(seed):
    """Also with tables for two blocks of 16 at a time, discarded and built again within one frame."""
    check_every_vote(seed)


@pytest.mark.slow
@given(seed=st.integers(0, 2**31))
@settings(max_examples=600)
def test_every_vote_equals_the_definition_on_many_scenes(seed):
    check_every_vote(seed)


def test_the_definition_is_that_of_the_votes():
    rig, grid, masks = random_scene(23, 5, 0.5)
    soft = votes_bruteforce(rig, grid, masks, min_votes=1)
    assert np.all((soft.n_votes >= 1) & (soft.n_votes <= soft.n_seen))
    assert np.all((soft.share > 0) & (soft.share <= 1))
    for k in range(5):
        hull = carve_bruteforce(rig, grid, masks, n_faulty_views=k, min_views=k + 1)
        expected = soft.voxels[(soft.n_seen - soft.n_votes <= k) & (soft.n_seen >= k + 1)]
        np.testing.assert_array_equal(hull, expected)
    np.testing.assert_array_equal(
        soft.at_least(1.0, 3), carve_bruteforce(rig, grid, masks, n_faulty_views=0, min_views=3)
    )
    strict = carve_bruteforce(rig, grid, masks, n_faulty_views=0, outside="background")
    np.testing.assert_array_equal(strict, soft.voxels[soft.n_votes == 5])


@given(seed=st.integers(0, 2**31))
@settings(max_examples=25)
def test_bounds_of_blocks_hold_before_their_voxels_are_projected(seed):
    """What the interval arithmetic says of a block of 16 must not contradict any of its voxels."""
    rig, grid, _ = hard_scene(seed)
    carver = Carver(rig, grid)
    level = carver._large
    box, sees_all, sees_some = level.box.copy(), level.sees_all.copy(), level.sees_some.copy()
    carver._build(np.arange(len(box), dtype=np.int32))
    bits = 1 << np.arange(len(rig))
    claims_all = (sees_all[:, None] & bits) > 0
    claims_none = (sees_some[:, None] & bits) == 0
    assert not np.any(claims_all & ~((level.sees_all[:, None] & bits) > 0))
    assert not np.any(claims_none & ((level.sees_some[:, None] & bits) > 0))
    seen = (level.sees_some[:, None] & bits) > 0
    for low in (0, 2):
        assert np.all(box[..., low][seen] <= level.box[..., low][seen])
        assert np.all(box[..., low + 1][seen] >= level.box[..., low + 1][seen])


def test_bounds_of_blocks_are_worth_having():
    """On a plain rig most of what the exact tables know is known without them."""
    rig = ring_rig(6)
    grid = VoxelGrid.from_bounds(np.array([-0.5, -2.0, 0.0]), np.array([2.5, 1.0, 2.0]), 0.04)
    carver = Carver(rig, grid)
    level = carver._large
    bounds = level.box.astype(float)
    carver._build(np.arange(len(bounds), dtype=np.int32))
    exact = level.box.astype(float)
    inside = exact[..., 1] >= 0

    def area(box):
        return ((box[..., 1] - box[..., 0] + 1) * (box[..., 3] - box[..., 2] + 1))[inside]

    assert np.median(area(bounds) / area(exact)) < 1.3


def test_tables_grow_with_the_space_that_is_visited():
    rig = ring_rig(6)
    grid = choose_grid(rig, 0.02)
    carver = Carver(rig, grid)
    assert carver.table_mb == 0
    masks = [np.zeros((48, 64), dtype=bool) for _ in rig]
    assert len(carver.carve(masks, n_faulty_views=0)) == 0
    assert carver.table_mb == 0
    for camera, mask in zip(rig, masks, strict=True):
        u, v = np.round(camera.project(np.array([[1.0, -0.5, 1.0]]))[0][0]).astype(int)
        mask[v - 3 : v + 4, u - 2 : u + 3] = True
    hull = carver.carve(masks, n_faulty_views=0)
    assert len(hull) > 100
    before = carver.table_mb
    assert 0 < before < 0.1 * SMALLEST_TABLE_MB * grid.n_voxels / 4096
    np.testing.assert_array_equal(carver.carve(masks, n_faulty_views=0), hull)
    assert carver.table_mb == before


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


def test_the_examples_of_the_page_run(capsys):
    page = Path(__file__).resolve().parents[2] / "docs" / "volumes.md"
    examples = re.findall(r"^```python\n(.*?)^```", page.read_text(encoding="utf-8"), re.M | re.S)
    assert len(examples) == 3
    names = {"__name__": "page"}
    for example in examples:
        exec(compile(example, page.name, "exec"), names)
    said = capsys.readouterr().out
    found = re.match(
        r"(\d+) voxels, \d+ on the surface, 1 blob\n\d+ voxels have .*\n(\d+) voxels; 4 of 5 cameras can judge",
        said,
    )
    assert found, said
    assert int(found[2]) >= int(found[1]), "a camera that abstains only adds voxels"
