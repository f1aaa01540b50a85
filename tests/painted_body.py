"""A body in colours: what cameras around it see in pixels of its flesh."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from flesh_voxels import Flesh
from marker_world import ring

from mocap.body import cones_of, joint_transforms
from mocap.data import CameraRig
from mocap.likelihood.colours import PixelRays
from mocap.likelihood.colours._kernels import see_cones
from mocap.likelihood.residuals import Crops, person_crops, pinhole_view


def rays_at(flesh: Flesh, state: np.ndarray, *, seed: int, n: int = 900) -> PixelRays:
    """Rays from four cameras around a body in a pose (D,) through points in and beside its flesh; all are black."""
    rng = np.random.default_rng(seed)
    angle = np.array([0.3, 1.9, 3.4, 5.0])
    origins = np.column_stack([3 * np.cos(angle), 3 * np.sin(angle), np.full(4, 1.2)])
    start, end = cones_of(flesh.body, state)
    k = rng.integers(0, len(start), n)
    aim = start[k] + rng.random((n, 1)) * (end[k] - start[k]) + rng.normal(0.0, 0.03, (n, 3))
    camera = np.sort(np.arange(n) % 4)
    directions = aim - origins[camera]
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    return PixelRays(origins, camera, directions, np.zeros((n, 3), dtype=np.uint8))


def cameras_around() -> CameraRig:
    """Four small cameras around a body at the origin."""
    return ring(4, (192, 240), np.zeros(5))


def painted(flesh: Flesh, state: np.ndarray, rig: CameraRig) -> list[np.ndarray]:
    """What cameras see of a body in a pose (D,): waves of colour of 15 to 25 cm, grey around it; (H, W, 3) each."""
    body = flesh.body
    start, end = cones_of(body, state)
    R, t = joint_transforms(body, state[None])
    pictures = []
    for camera in rig:
        width, height = camera.size
        uv = np.stack(np.meshgrid(np.arange(width), np.arange(height)), axis=-1).reshape(-1, 2)
        directions = camera.rays(uv.astype(float))
        n = len(uv)
        columns = np.concatenate([np.tile(camera.center[:, None], n), directions.T]).astype(np.float32)
        depth, miss = np.full(n, np.float32(np.inf)), np.zeros(n, np.float32)
        cone, at = np.full(n, np.int32(-1)), np.zeros(n, np.float32)
        see_cones(columns, start, end, body.cones.radii, depth, miss, cone, at)
        rgb = np.full((n, 3), 90.0)
        seen = np.isfinite(depth) & (cone >= 0)
        joint = body.cones.joint[cone[seen]]
        places = camera.center + depth[seen, None] * directions[seen]
        local = np.einsum("mji,mj->mi", R[0, joint], places - t[0, joint])
        rgb[seen] = 128 + 70 * np.sin(local @ (2 * np.pi * np.diag([4.0, 5.0, 6.5])) + 1.7 * joint[:, None])
        pictures.append(rgb.astype(np.uint8).reshape(height, width, 3))
    return pictures


def crops_of(flesh: Flesh, state: np.ndarray, rig: CameraRig, pictures: Sequence[np.ndarray]) -> Crops:
    """What cameras show around a body alone in a room."""
    hull = flesh.hull(state)
    return person_crops(
        [pinhole_view(camera) for camera in rig],
        pictures,
        flesh.grid.centers(hull.voxels[hull.is_surface]),
        np.zeros((0, 3)),
        is_used=[True] * len(rig.cameras),
        hidden=[None] * len(rig.cameras),
    )
