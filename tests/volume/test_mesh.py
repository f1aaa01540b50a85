"""The smooth surface of a hull against bodies whose surface is known."""

from __future__ import annotations

import numpy as np
import pytest

from mocap.data import Hull, VoxelGrid
from mocap.volume import hull_mesh, surface_voxels

trimesh = pytest.importorskip("trimesh")
pytest.importorskip("skimage", reason="scikit-image: the extra `export`")

SIZE_M = 0.02
GRID = VoxelGrid(np.array([0.3, -0.5, 0.1]), (40, 44, 48), SIZE_M)
MIDDLE = GRID.origin + SIZE_M * np.array([20.0, 21.0, 23.0])
RADIUS_M = 10 * SIZE_M


def hull_where(inside, rgb=lambda places: np.full((len(places), 3), 90)):
    places = GRID.centers(np.arange(np.prod(GRID.shape), dtype=np.int32))
    voxels = np.flatnonzero(inside(places)).astype(np.int32)
    is_surface = surface_voxels(voxels, GRID)
    colours = np.where(is_surface[:, None], rgb(GRID.centers(voxels)), 0).astype(np.uint8)
    return Hull(GRID, voxels, is_surface, is_surface.astype(np.uint8), colours)


def ball(places):
    return np.linalg.norm(places - MIDDLE, axis=1) < RADIUS_M


def test_a_ball_is_smooth_closed_and_as_large():
    mesh = hull_mesh(hull_where(ball))
    solid = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    assert solid.is_watertight
    assert solid.volume == pytest.approx(
        4 / 3 * np.pi * RADIUS_M**3, rel=0.03
    )  # positive: faces look outwards
    outward = (solid.triangles_center - MIDDLE) / np.linalg.norm(
        solid.triangles_center - MIDDLE, axis=1, keepdims=True
    )
    off_deg = np.degrees(np.arccos(np.clip((outward * solid.face_normals).sum(axis=1), -1, 1)))
    assert np.percentile(off_deg, 95) < 12.0  # 37 without smoothing
    radii = np.linalg.norm(mesh.vertices - MIDDLE, axis=1)
    assert np.abs(radii - RADIUS_M).max() < 0.7 * SIZE_M
    np.testing.assert_allclose(mesh.vertices.mean(axis=0), MIDDLE, atol=0.05 * SIZE_M)


def test_an_arm_of_two_voxels_stays_and_keeps_its_girth():
    mesh = hull_mesh(hull_where(lambda p: (np.abs(p[:, 1:] - MIDDLE[1:]) < SIZE_M).all(axis=1)))
    solid = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    assert len(solid.split()) == 1
    # A bar of 2 x 2 voxels whose edges are rounded.
    assert solid.volume == pytest.approx(40 * 4 * SIZE_M**3, rel=0.3)
    assert np.ptp(mesh.vertices[:, 0]) > 38 * SIZE_M


def test_colours_are_those_of_the_voxels_near_by():
    def halves(places):
        is_left = places[:, 1] > MIDDLE[1]
        return np.where(is_left[:, None], [200, 10, 20], [10, 30, 220])

    hull = hull_where(ball, halves)
    mesh = hull_mesh(hull)
    left = mesh.vertices[:, 1] > MIDDLE[1] + 3 * SIZE_M
    right = mesh.vertices[:, 1] < MIDDLE[1] - 3 * SIZE_M
    assert (mesh.rgb[left] == [200, 10, 20]).all()
    assert (mesh.rgb[right] == [10, 30, 220]).all()
    unseen = Hull(GRID, hull.voxels, hull.is_surface, np.zeros_like(hull.n_views), np.zeros_like(hull.rgb))
    assert (hull_mesh(unseen).rgb == 150).all()


def test_nobody_gives_nothing():
    mesh = hull_mesh(hull_where(lambda places: np.zeros(len(places), dtype=bool)))
    assert (mesh.vertices.shape, mesh.faces.shape, mesh.rgb.shape) == ((0, 3), (0, 3), (0, 3))
