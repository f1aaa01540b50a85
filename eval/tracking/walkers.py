"""Two persons, ellipsoids in clothes of one colour each, who walk past each other: hulls with an exact truth."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from eval.tracking.hulls import HullClip
from mocap.arrays import Array
from mocap.data import Camera, CameraRig, Hull, Tracks, VoxelGrid
from mocap.volume import surface_voxels
from mocap.volume.carve import Carver

CLOTHES = ((200, 40, 40), (40, 60, 200))
_SPEED_M_S, _FPS, _HALF_WAY_M = 1.0, 15.0, 1.6
_PERSON_SEMI_M = (0.22, 0.22, 0.85)
_ROOM = "meeting_01"  # whose five cameras see the carved clips
_GREY = (120, 115, 105)
_COLOUR_STD = 20.0
_NEAR = 1.3  # voxels within so many squared semi-axes of a person have the colour of the clothes
_TROLLEY_SEMI_M, _TROLLEY_BEHIND_M = (0.22, 0.22, 0.45), 0.35
_N_PIECES = 3.0  # torn out of a silhouette, and as many false ones: mean of a Poisson distribution
_PIECE = (0.05, 0.15)  # their radius, in heights of the silhouette
_SEED = 43


@dataclass(frozen=True)
class Dirt:
    """What spoils carved hulls.

    is_torn : round pieces are missing from every silhouette of every camera, anew in every frame, and false ones lie
    around it.  has_trolley : each person pulls a grey thing of 0.9 m, which is foreground too.
    """

    is_torn: bool = False
    has_trolley: bool = False


def ellipsoid(grid: VoxelGrid, center: ArrayLike, semi: ArrayLike) -> NDArray[np.int32]:
    """The voxels of an ellipsoid."""
    inside = _squared(grid.centers(np.arange(grid.n_voxels, dtype=np.int32)), center, semi) < 1.0
    return np.flatnonzero(inside).astype(np.int32)


def _squared(points: Array, center: ArrayLike, semi: ArrayLike) -> Array:
    return np.asarray((((points - np.asarray(center)) / np.asarray(semi)) ** 2).sum(axis=1))


def _walk(gap_m: float, times_fps: int) -> Iterator[tuple[Array, Array]]:
    """The middles of both persons, frame by frame."""
    fps = times_fps * _FPS
    for f in range(int(2 * _HALF_WAY_M / _SPEED_M_S * fps) + 1):
        x = -_HALF_WAY_M + f * _SPEED_M_S / fps
        yield (
            np.array([x, gap_m / 2, _PERSON_SEMI_M[2]]),
            np.array([-x, -gap_m / 2, _PERSON_SEMI_M[2]]),
        )


def _room(voxel_m: float) -> VoxelGrid:
    reach = _HALF_WAY_M + 0.5
    return VoxelGrid.from_bounds(np.array([-reach, -1.0, 0.0]), np.array([reach, 1.0, 1.8]), voxel_m)


def _clip(name: str, fps: float, places: list[tuple[Array, Array]], hulls: list[Hull]) -> HullClip:
    frame = np.repeat(np.arange(len(places)), 2)
    person = np.tile([1, 2], len(places))
    truth = Tracks(frame, person, frame / fps, np.concatenate(places).reshape(-1, 3))
    return HullClip(name, fps, np.arange(len(places)), tuple(hulls), truth, None)


def crossing_clip(gap_m: float, voxel_m: float = 0.05) -> HullClip:
    """The two with a gap between their middles, at 15 frames/s; where they overlap the hull is one."""
    grid = _room(voxel_m)
    places, hulls = list(_walk(gap_m, 1)), []
    for pair in places:
        voxels = np.union1d(*(ellipsoid(grid, place, _PERSON_SEMI_M) for place in pair)).astype(np.int32)
        first, second = (((grid.centers(voxels) - place) ** 2).sum(axis=1) for place in pair)
        rgb = np.where((first <= second)[:, None], *(np.array(c, dtype=np.uint8) for c in CLOTHES))
        hulls.append(_hull(grid, voxels, rgb.astype(np.uint8)))
    return _clip(f"crossing {gap_m:g} m", _FPS, places, hulls)


def carved_clip(gap_m: float, voxel_m: float, dirt: Dirt, times_fps: int) -> HullClip:
    """The two as five cameras of a meeting room see them, carved from their silhouettes.

    times_fps : as many times the frames in the same seconds.
    """
    rig, grid = _cameras(), _room(voxel_m)
    carver, rng = Carver(rig, grid), np.random.default_rng(_SEED)
    places, hulls = list(_walk(gap_m, times_fps)), []
    for pair in places:
        masks = [_silhouettes(camera, pair, dirt, rng) for camera in rig]
        voxels = carver.carve(masks, n_faulty_views=1, min_views=3)
        near = np.stack([_squared(grid.centers(voxels), place, _PERSON_SEMI_M) for place in pair])
        clothes = np.array([*CLOTHES, _GREY])
        rgb = clothes[np.where(near.min(axis=0) < _NEAR, near.argmin(axis=0), 2)]
        rgb = rgb + _COLOUR_STD * rng.standard_normal(rgb.shape)
        hulls.append(_hull(grid, voxels, np.clip(rgb, 0, 255).astype(np.uint8)))
    return _clip(f"carved {gap_m:g} m", times_fps * _FPS, places, hulls)


@cache
def _cameras() -> CameraRig:
    from mocap.synth.scene import load_scene
    from mocap.synth.world import build_world

    return build_world(load_scene(_ROOM)).rig


def _hull(grid: VoxelGrid, voxels: NDArray[np.int32], rgb: NDArray[np.uint8]) -> Hull:
    surface = surface_voxels(voxels, grid)
    return Hull(grid, voxels, surface, surface.astype(np.uint8), rgb)


def _silhouettes(
    camera: Camera, pair: tuple[Array, Array], dirt: Dirt, rng: np.random.Generator
) -> NDArray[np.bool_]:
    """The foreground (H, W) of one camera."""
    out = np.zeros((camera.size[1], camera.size[0]), dtype=np.uint8)
    for place, ahead in zip(pair, (1.0, -1.0), strict=True):
        own = np.zeros_like(out)
        outline = _outline(camera, place, np.array(_PERSON_SEMI_M))
        cv2.fillConvexPoly(own, outline, 1)
        if dirt.has_trolley:
            semi = np.array(_TROLLEY_SEMI_M)
            behind = np.array([place[0] - ahead * _TROLLEY_BEHIND_M, place[1], semi[2]])
            cv2.fillConvexPoly(own, _outline(camera, behind, semi), 1)
        if dirt.is_torn:
            _tear(own, outline, rng)
        out |= own
    return out > 0


def _outline(camera: Camera, center: Array, semi: Array) -> NDArray[np.int32]:
    """The outline (C, 1, 2) px of an ellipsoid."""
    polar, around = np.meshgrid(np.linspace(0, np.pi, 24), np.linspace(0, 2 * np.pi, 32))
    unit = np.stack([np.sin(polar) * np.cos(around), np.sin(polar) * np.sin(around), np.cos(polar)], axis=-1)
    uv, _ = camera.project(unit.reshape(-1, 3) * semi + center)
    return np.asarray(cv2.convexHull(np.round(uv).astype(np.int32)))


def _tear(mask: NDArray[np.uint8], outline: NDArray[np.int32], rng: np.random.Generator) -> None:
    """Round pieces missing from a silhouette, then false ones in and around it, in place."""
    low, high = outline[:, 0].min(axis=0), outline[:, 0].max(axis=0)
    size = high - low
    for value, wide in ((0, 1.0), (1, 2.0)):
        for _ in range(rng.poisson(_N_PIECES)):
            u, v = (low + high) / 2 + wide * (rng.random(2) - 0.5) * size
            cv2.circle(mask, (round(u), round(v)), round(size[1] * rng.uniform(*_PIECE)), value, -1)
