"""Voxel files read back by trimesh and numpy, which share no code with the writers."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import trimesh

from mocap.data import Hull, VoxelGrid
from mocap.errors import MocapError
from mocap.io.formats._writing import ANIMATION_FROM_WORLD
from mocap.io.formats.voxels import (
    UNSEEN_GREY,
    hull_quads,
    write_voxels_glb,
    write_voxels_npz,
    write_voxels_ply,
)
from mocap.volume import surface_voxels

GRID = VoxelGrid(np.array([-0.4, 0.3, 0.1]), (7, 9, 11), 0.05)
TOLERANCE_M = 1e-6  # float32 of lengths below 2 m
ONE_LEVEL = 1  # of 255: a colour through linear light and back in eight bits


def make_hull(seed: int = 3) -> Hull:
    """A solid block with a hole and a loose voxel; some of the surface is seen by nobody."""
    rng = np.random.default_rng(seed)
    dense = np.zeros(GRID.shape, dtype=bool)
    dense[1:6, 2:8, 1:9] = True
    dense[2, 3, 4] = False
    dense[6, 8, 10] = True
    voxels = np.flatnonzero(dense).astype(np.int32)
    is_surface = surface_voxels(voxels, GRID)
    n_views = (rng.integers(0, 4, len(voxels)) * is_surface).astype(np.uint8)
    rgb = rng.integers(0, 256, (len(voxels), 3)).astype(np.uint8)
    rgb[n_views == 0] = 0
    return Hull(GRID, voxels, is_surface, n_views, rgb)


EMPTY = Hull(
    GRID,
    np.zeros(0, dtype=np.int32),
    np.zeros(0, dtype=bool),
    np.zeros(0, dtype=np.uint8),
    np.zeros((0, 3), dtype=np.uint8),
)


def glb_colours(path: Path) -> np.ndarray:
    """COLOR_0 (V, 3) of the only mesh, by the glTF specification; trimesh drops it beside a material."""
    data = path.read_bytes()
    n_text = int.from_bytes(data[12:16], "little")
    document = json.loads(data[20 : 20 + n_text])
    binary = data[28 + n_text :]
    accessor = document["accessors"][document["meshes"][0]["primitives"][0]["attributes"]["COLOR_0"]]
    view = document["bufferViews"][accessor["bufferView"]]
    rows = np.frombuffer(binary, np.uint8, 4 * accessor["count"], view["byteOffset"]).reshape(-1, 4)
    return rows[:, :3]


def test_points_of_the_surface_with_their_colours(tmp_path: Path) -> None:
    hull = make_hull()
    write_voxels_ply(tmp_path / "a.ply", hull)
    cloud = trimesh.load(tmp_path / "a.ply")
    outer = hull.select(hull.is_surface)
    assert np.abs(cloud.vertices - outer.centers).max() < TOLERANCE_M
    expected = np.where((outer.n_views > 0)[:, None], outer.rgb, UNSEEN_GREY)
    np.testing.assert_array_equal(cloud.colors[:, :3], expected)
    assert b"n_views" in (tmp_path / "a.ply").read_bytes()[:400]


def test_cubes_are_a_closed_surface_around_the_volume(tmp_path: Path) -> None:
    hull = make_hull()
    write_voxels_ply(tmp_path / "a.ply", hull, cubes=True)
    write_voxels_glb(tmp_path / "a.glb", hull)
    from_ply = trimesh.load(tmp_path / "a.ply", process=True, merge_tex=True)
    from_glb = trimesh.load(tmp_path / "a.glb", force="mesh")
    for mesh, turn in ((from_ply, np.eye(3)), (from_glb, ANIMATION_FROM_WORLD)):
        corners = np.asarray(mesh.vertices) @ turn
        plain = trimesh.Trimesh(corners, mesh.faces, process=True)
        plain.merge_vertices(merge_tex=True, merge_norm=True)
        # Outward faces: the volume is positive and that of the voxels.
        assert plain.volume == pytest.approx(len(hull) * GRID.voxel_size_m**3, rel=1e-4)
        assert plain.is_watertight
        assert np.abs(plain.bounds[0] - hull.centers.min(axis=0) + GRID.voxel_size_m / 2).max() < TOLERANCE_M


def test_faces_have_the_colour_of_their_voxel(tmp_path: Path) -> None:
    hull = make_hull()
    corners, normals, rgb = hull_quads(hull)
    inside = corners.mean(axis=1) - normals * GRID.voxel_size_m / 2
    rows = np.searchsorted(hull.voxels, GRID.voxels_of(inside))
    np.testing.assert_array_equal(GRID.voxels_of(inside), hull.voxels[rows])
    expected = np.where((hull.n_views > 0)[:, None], hull.rgb, UNSEEN_GREY)[rows]
    np.testing.assert_array_equal(rgb, expected)
    write_voxels_glb(tmp_path / "a.glb", hull)
    linear = glb_colours(tmp_path / "a.glb") / 255.0
    srgb = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    bright = np.repeat(expected, 4, axis=0) > 60  # below, eight bits of linear light are coarse
    error = np.abs(np.round(255 * srgb) - np.repeat(expected, 4, axis=0))[bright]
    assert error.max() <= 2 * ONE_LEVEL


def test_archive_holds_everything(tmp_path: Path) -> None:
    hull = make_hull()
    write_voxels_npz(tmp_path / "a.npz", hull)
    with np.load(tmp_path / "a.npz", allow_pickle=False) as found:
        grid = VoxelGrid(found["origin_m"], tuple(found["shape"]), float(found["voxel_size_m"]))
        np.testing.assert_array_equal(grid.centers(found["voxels"]), hull.centers)
        assert np.abs(found["xyz_m"] - hull.centers).max() < TOLERANCE_M
        for name in ("voxels", "rgb", "n_views", "is_surface"):
            np.testing.assert_array_equal(found[name], getattr(hull, name))


@pytest.mark.parametrize("suffix", ["ply", "npz", "glb"])
def test_same_hull_same_bytes_and_nobody_is_no_error(tmp_path: Path, suffix: str) -> None:
    write = {"ply": write_voxels_ply, "npz": write_voxels_npz, "glb": write_voxels_glb}[suffix]
    first, second = tmp_path / f"a.{suffix}", tmp_path / f"b.{suffix}"
    write(first, make_hull())
    write(second, make_hull())
    assert first.read_bytes() == second.read_bytes()
    write(first, EMPTY)
    assert first.stat().st_size > 0
    if suffix == "ply":
        assert b"element vertex 0" in first.read_bytes()
        write_voxels_ply(first, EMPTY, cubes=True)
        assert b"element face 0" in first.read_bytes()
    if suffix == "glb":
        assert len(trimesh.load(first).geometry) == 0


def test_a_folder_that_is_not_there_is_named(tmp_path: Path) -> None:
    with pytest.raises(MocapError, match="cannot write the file"):
        write_voxels_ply(tmp_path / "missing" / "a.ply", make_hull())
