"""Volumes that no silhouette needs: found by what they explain."""

from __future__ import annotations

import numpy as np
import pytest
from marker_world import ring, spotted

from mocap.data import CameraRig, VoxelGrid
from mocap.volume import Carver, connected_components, surface_voxels
from mocap.volume.phantoms import phantoms

GRID = VoxelGrid.from_bounds(np.array([-1.8, -1.8, 0.0]), np.array([1.8, 1.8, 1.9]), 0.04)
RIG = ring(4, size=(320, 248), dist=np.zeros(4))


def posts(*places: tuple[float, float], width_m: float = 0.4, height_m: float = 1.7) -> np.ndarray:
    """Voxels of upright posts as thick as people."""
    centers = GRID.centers(np.arange(GRID.n_voxels, dtype=np.int32))
    inside = np.zeros(len(centers), dtype=np.bool_)
    for place in places:
        beside = np.abs(centers[:, :2] - place).max(axis=1) < 0.5 * width_m
        inside |= beside & (centers[:, 2] < height_m)
    return np.flatnonzero(inside).astype(np.int32)


def gone(voxels: np.ndarray, masks: list[np.ndarray], rig: CameraRig = RIG) -> np.ndarray:
    return phantoms(voxels, surface_voxels(voxels, GRID), GRID, rig, masks)


@pytest.mark.parametrize(
    "places",
    [
        ((0.9, 0.4), (0.1, -0.4), (-0.7, 0.9)),
        ((-0.9, 0.1), (-0.1, -0.9), (0.3, 0.7)),
        ((-0.9, -0.7), (-0.6, 0.1), (-0.1, 0.9)),
        ((0.5, -0.1), (-0.6, 0.8), (-1.0, -0.4)),
    ],
)
def test_volumes_that_others_explain_are_nobody(places: tuple[tuple[float, float], ...]) -> None:
    """Three posts before four cameras leave volumes as large as themselves where their rays cross."""
    cast = posts(*places)
    masks = spotted(RIG, GRID.centers(cast))
    voxels = Carver(RIG, GRID).carve(masks, n_faulty_views=0)
    labels, _ = connected_components(voxels, GRID)
    litres = np.bincount(labels) * 1000 * GRID.voxel_size_m**3
    is_real = np.isin(voxels, cast)
    false = np.setdiff1d(np.flatnonzero(litres > 20.0), labels[is_real])
    assert len(false) > 0, "the scene has a phantom"
    found = gone(voxels, masks)
    assert found[np.isin(labels, false)].all()
    assert not found[is_real].any()


def test_people_stay_however_they_stand_before_each_other() -> None:
    towards = RIG[0].center[:2] / np.linalg.norm(RIG[0].center[:2])
    cast = posts(tuple(0.5 * towards), tuple(-0.5 * towards))
    assert not gone(cast, spotted(RIG, GRID.centers(cast))).any()


def test_one_piece_is_never_taken() -> None:
    cast = posts((0.0, 0.0))
    nothing = [np.zeros(camera.size[::-1], dtype=np.bool_) for camera in RIG]
    assert not gone(cast, nothing).any()
    assert not gone(np.zeros(0, dtype=np.int32), nothing).any()


def test_small_pieces_are_no_matter() -> None:
    """A hand before the trunk explains nothing either."""
    body = posts((0.0, 0.0))
    away = 0.45 * RIG[0].center / np.linalg.norm(RIG[0].center)
    centers = GRID.centers(np.arange(GRID.n_voxels, dtype=np.int32))
    near = np.linalg.norm(centers - (away + np.array([0.0, 0.0, 1.0])), axis=1) < 0.09
    hand = np.setdiff1d(np.flatnonzero(near), body).astype(np.int32)
    both = np.union1d(body, hand).astype(np.int32)
    assert connected_components(both, GRID)[1] == 2
    assert not gone(both, spotted(RIG, GRID.centers(body))).any()


def test_where_no_camera_has_a_say_nothing_is_taken() -> None:
    pair = posts((-0.8, 0.0), (0.8, 0.1))
    nothing = [np.zeros(camera.size[::-1], dtype=np.bool_) for camera in RIG]
    assert not gone(pair, nothing).any()


def test_with_fewer_than_four_cameras_nobody_is_taken() -> None:
    rig = ring(3, size=(320, 248), dist=np.zeros(4))
    cast = posts((0.9, 0.4), (0.1, -0.4), (-0.7, 0.9))
    masks = spotted(rig, GRID.centers(cast))
    voxels = Carver(rig, GRID).carve(masks, n_faulty_views=0)
    assert connected_components(voxels, GRID)[1] > 3
    assert not gone(voxels, masks, rig).any()
