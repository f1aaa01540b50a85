"""By how much a point of the room is uncertain because of the calibration alone."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mocap.arrays import Array
from mocap.calibrate.bundle import Adjusted
from mocap.calibrate.lens import project

_LOOK_M = 4.0  # how far before a camera the room is drawn


@dataclass(frozen=True, eq=False)
class UncertaintyMap:
    """deviation_m : (Y, X), standard deviation (root mean square distance) of a point at `height_m`; NaN where fewer
    than two cameras see it.  x, y : (X,), (Y,) m, world."""

    x: Array
    y: Array
    height_m: float
    deviation_m: Array


def point_deviations(adjusted: Adjusted, points: Array) -> Array:
    """(N,) m for points (N, 3) m of the world; NaN where fewer than two cameras see the point.

    A point is where its pixels meet best.  With cameras that are off by c its pixels meet at
    dX = (J^T J)^-1 J^T A c, J the derivatives of the pixels by the point and A by the cameras.
    """
    found = np.full(len(points), np.nan)
    for n, point in enumerate(points):
        J, A = _derivatives(adjusted, point)
        if len(J) >= 4:
            lever = np.linalg.solve(J.T @ J, J.T @ A)
            found[n] = np.sqrt(np.trace(lever @ adjusted.covariance @ lever.T))
    return found


def uncertainty_map(adjusted: Adjusted, *, height_m: float = 1.0, step_m: float = 0.2) -> UncertaintyMap:
    """Deviations at one height in the part of the room that holds the cameras and what they look at."""
    cameras = [adjusted.bundle.camera(name) for name in adjusted.names]
    looked_at = [camera.center + _LOOK_M * camera.R[2] for camera in cameras]
    places = np.array([*(camera.center for camera in cameras), *looked_at])[:, :2]
    spans = zip(places.min(axis=0), places.max(axis=0), strict=True)
    x, y = (np.arange(a, b + step_m / 2, step_m) for a, b in spans)
    at = np.meshgrid(x, y)
    points = np.column_stack([at[0].ravel(), at[1].ravel(), np.full(at[0].size, height_m)])
    return UncertaintyMap(x, y, height_m, point_deviations(adjusted, points).reshape(at[0].shape))


def _derivatives(adjusted: Adjusted, point: Array) -> tuple[Array, Array]:
    """Of the pixels of a point in all cameras that see it: by the point (2c, 3), by all cameras (2c, C * block)."""
    bundle = adjusted.bundle
    by_point, by_cameras = [], []
    for name in adjusted.names:
        camera = bundle.camera(name)
        if not camera.contains(camera.project(point[None])[0])[0]:
            continue
        _, by_pose, by_lens = project(point[None], bundle.places[name], bundle.lenses[name], bundle.model)
        # A point moves in the camera's frame as the camera's shift does.
        by_point.append(by_pose[:, 3:] @ camera.R)
        own = np.zeros((2, len(adjusted.covariance)))
        own[:, adjusted.block_of(name)] = by_pose if bundle.keeps_lenses else np.hstack([by_pose, by_lens])
        by_cameras.append(own)
    if not by_point:
        return np.zeros((0, 3)), np.zeros((0, len(adjusted.covariance)))
    return np.concatenate(by_point), np.concatenate(by_cameras)
