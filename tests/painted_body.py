"""A body in colours: what cameras around it see in pixels of its flesh."""

from __future__ import annotations

import numpy as np
from flesh_voxels import Flesh

from mocap.body import cones_of, joint_transforms
from mocap.body.flesh import cone_distances
from mocap.likelihood.colours import PixelRays

STEP_M = 0.01


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


def painted(flesh: Flesh, state: np.ndarray, *, seed: int, n: int = 900) -> PixelRays:
    """Those of `rays_at` that meet the body, and the colours there: waves of 15 to 25 cm."""
    rays = rays_at(flesh, state, seed=seed, n=n)
    origins, camera, directions = rays.origins, rays.camera, rays.directions
    cone, place = entries(flesh, state, origins[camera], directions)
    R, t = joint_transforms(flesh.body, state[None])
    joint = flesh.body.cones.joint[cone]
    local = np.einsum("mji,mj->mi", R[0, joint], place - t[0, joint])
    rgb = 128 + 70 * np.sin(local @ (2 * np.pi * np.diag([4.0, 5.0, 6.5])) + 1.7 * joint[:, None])
    seen = cone >= 0
    return PixelRays(origins, camera[seen], directions[seen], rgb[seen].astype(np.uint8))


def entries(
    flesh: Flesh, state: np.ndarray, origins: np.ndarray, directions: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The cone that every ray enters first, -1 for none, and where (M, 3): by steps along the ray, then by halving."""
    start, end = cones_of(flesh.body, state)
    radii = flesh.body.cones.radii
    cone, place = np.full(len(origins), -1), np.zeros((len(origins), 3))
    for i, (o, u) in enumerate(zip(origins, directions, strict=True)):
        depth = np.arange(1.8, 4.2, STEP_M)
        inside = (cone_distances(o + depth[:, None] * u, start, end, radii, True) <= 0).any(axis=1)
        if not inside.any():
            continue
        far = depth[int(inside.argmax())]
        near = far - STEP_M
        for _ in range(12):
            middle = 0.5 * (near + far)
            is_in = (cone_distances((o + middle * u)[None], start, end, radii, True) <= 0).any()
            near, far = (near, middle) if is_in else (middle, far)
        place[i] = o + far * u
        cone[i] = cone_distances(place[i][None], start, end, radii, True)[0].argmin()
    return cone, place
