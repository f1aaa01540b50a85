"""A light scene for the benchmark: a ring of cameras and a person of spheres, drawn as discs."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from mocap.data import Camera, CameraRig, VoxelGrid

Array = NDArray[np.float64]

ROOM_LOWER = (-2.5, -2.0, 0.0)
ROOM_UPPER = (2.5, 2.0, 2.2)
# (from, to, radius) of the limbs, metres, the body's own frame.
_LIMBS = (
    ((0.0, 0.0, 1.60), (0.0, 0.0, 1.68), 0.10),
    ((0.0, 0.0, 1.05), (0.0, 0.0, 1.38), 0.15),
    ((0.0, 0.0, 0.92), (0.0, 0.0, 1.05), 0.14),
    ((0.0, 0.20, 1.40), (0.10, 0.34, 1.15), 0.05),
    ((0.10, 0.34, 1.15), (0.32, 0.30, 1.02), 0.04),
    ((0.0, -0.20, 1.40), (-0.12, -0.33, 1.16), 0.05),
    ((-0.12, -0.33, 1.16), (-0.10, -0.40, 0.92), 0.04),
    ((0.0, 0.10, 0.92), (0.16, 0.11, 0.50), 0.08),
    ((0.16, 0.11, 0.50), (0.06, 0.11, 0.08), 0.055),
    ((0.0, -0.10, 0.92), (-0.04, -0.11, 0.50), 0.08),
    ((-0.04, -0.11, 0.50), (-0.30, -0.11, 0.12), 0.055),
)


@dataclass(frozen=True, eq=False)
class Scene:
    """rig, grid (2 cm over 5 x 4 x 2.2 m), masks and images of some frames: masks[frame][camera] (H, W) bool."""

    rig: CameraRig
    grid: VoxelGrid
    masks: tuple[tuple[NDArray[np.bool_], ...], ...]
    images: tuple[tuple[NDArray[np.uint8], ...], ...]
    empty: tuple[NDArray[np.uint8], ...]


def look_at(name: str, eye: Array, target: Array, size: tuple[int, int], focal: float, dist: Array) -> Camera:
    """Camera at `eye` whose axis points at `target`, upright."""
    forward = (target - eye) / np.linalg.norm(target - eye)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    R = np.array([right, np.cross(forward, right), forward])
    K = np.array([[focal, 0.0, (size[0] - 1) / 2], [0.0, focal, (size[1] - 1) / 2], [0.0, 0.0, 1.0]])
    return Camera(name, size, K, dist, R, -R @ eye)


def ring(n_cameras: int, size: tuple[int, int] = (640, 480)) -> CameraRig:
    """Cameras on a circle of 3.2 m at changing heights, with some barrel distortion."""
    cameras = []
    for i in range(n_cameras):
        angle = 2 * np.pi * i / n_cameras + 0.3
        eye = np.array(
            [3.2 * np.cos(angle), 3.0 * np.sin(angle), 1.4 + 0.9 * ((i * 3) % n_cameras) / n_cameras]
        )
        target = np.array([0.0, 0.0, 0.95])
        dist = np.array([-0.12, 0.04, 0.0, 0.0])
        cameras.append(look_at(f"cam_{i}", eye, target, size, 0.66 * size[0], dist))
    return CameraRig(tuple(cameras))


def person_mask(camera: Camera, position: Array, heading: float) -> NDArray[np.bool_]:
    """Silhouette of the person standing at position (2,) m, drawn as discs of spheres along the limbs."""
    canvas = np.zeros((camera.size[1], camera.size[0]), dtype=np.uint8)
    c, s = np.cos(heading), np.sin(heading)
    turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    for start, end, radius in _LIMBS:
        along = np.linspace(0.0, 1.0, 16)[:, None]
        local = (1 - along) * np.array(start) + along * np.array(end)
        uv, depth = camera.project(local @ turn.T + [position[0], position[1], 0.0])
        for (u, v), z in zip(uv, depth, strict=True):
            if np.isfinite(u):
                cv2.circle(canvas, (round(u), round(v)), round(camera.K[0, 0] * radius / z), 1, -1)
    return canvas.astype(np.bool_)


def make_scene(n_frames: int = 6, *, rng: np.random.Generator) -> Scene:
    """Seven cameras 640 x 480, one person who walks on a small circle, textured rooms with noise."""
    rig = ring(7)
    grid = VoxelGrid.from_bounds(np.array(ROOM_LOWER), np.array(ROOM_UPPER), 0.02)
    walls = [_texture(camera.size, rng) for camera in rig]
    masks, images = [], []
    for f in range(n_frames):
        angle = 0.35 * f
        position = np.array([0.7 * np.cos(angle), 0.7 * np.sin(angle)])
        silhouettes = tuple(person_mask(camera, position, angle + np.pi / 2) for camera in rig)
        masks.append(silhouettes)
        images.append(tuple(_photograph(w, m, rng) for w, m in zip(walls, silhouettes, strict=True)))
    empty = tuple(np.round(w).astype(np.uint8) for w in walls)
    return Scene(rig, grid, tuple(masks), tuple(images), empty)


def _texture(size: tuple[int, int], rng: np.random.Generator) -> Array:
    coarse = rng.uniform(90.0, 180.0, (12, 16, 3))
    return cv2.resize(coarse, size, interpolation=cv2.INTER_CUBIC)


def _photograph(wall: Array, mask: NDArray[np.bool_], rng: np.random.Generator) -> NDArray[np.uint8]:
    """The person before the wall, a soft shadow beside it, and sensor noise."""
    shadow = cv2.GaussianBlur(np.roll(mask, 40, axis=1).astype(np.float64), (0, 0), 6)
    picture = wall * (1.0 - 0.35 * shadow[:, :, None])
    picture[mask] = (60.0, 80.0, 140.0)
    noise = rng.normal(0.0, 2.0, picture.shape)
    return np.clip(picture + noise, 0, 255).astype(np.uint8)
