"""The part of the room that the cameras can carve."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from mocap.data import CameraRig, VoxelGrid
from mocap.volume.carve import default_min_views, pixels_of_points

Array = NDArray[np.float64]

CEILING_M = 2.4  # a tall person with raised arms
PERSON_M = 1.8
REACH_M = 0.4  # an outstretched arm beyond the place where a person stands
_COARSE_M = 0.1
_BESIDE_LINE_M = 1.0  # where the cameras and their mirror images stand in one line
_SEEN_SHARE = 0.75  # of a person's height that enough cameras must see for a place to count


def choose_grid(
    rig: CameraRig,
    voxel_size_m: float,
    *,
    bounds_m: tuple[tuple[float, float, float], tuple[float, float, float]] | None = None,
    min_views: int | None = None,
) -> VoxelGrid:
    """Voxel grid over the given bounds, or over the places where enough cameras see a person.

    bounds_m : (lower, upper) corners, m, world; they win over everything else.  min_views : cameras that must see
    a voxel; default_min_views if None.
    Without bounds the grid lies within the convex hull (in plan) of the camera positions and of their mirror
    images in the point the cameras look at (cameras along one wall enclose nothing by themselves): people move
    among the cameras. A place counts when three quarters of a column of 1.8 m on the floor z = 0 are seen by
    min_views cameras. The grid is the box around these places, 0.4 m wider for reach, as far as min_views
    cameras see anything there, from the floor to at most 2.4 m. Where no place counts, it is the box around all
    points that enough cameras see.
    Raises ValueError when no point is seen by enough cameras, or for bad bounds.
    """
    if not voxel_size_m > 0:
        raise ValueError(f"voxel_size_m: expected a positive length, got {voxel_size_m}")
    if bounds_m is not None:
        return VoxelGrid.from_bounds(np.asarray(bounds_m[0]), np.asarray(bounds_m[1]), voxel_size_m)
    needed = default_min_views(len(rig)) if min_views is None else min_views
    return VoxelGrid.from_bounds(*_common_bounds(rig, needed), voxel_size_m)


@lru_cache(maxsize=8)
def _common_bounds(rig: CameraRig, needed: int) -> tuple[Array, Array]:
    """Lower and upper corner (3,) m of what so many cameras see, as `choose_grid` says; every stage asks for it."""
    columns = _plan_samples(rig)
    heights = np.arange(_COARSE_M / 2, CEILING_M, _COARSE_M)
    n_seen = np.zeros((len(heights), len(columns)), dtype=np.int64)
    for camera in rig:
        for row, z in zip(n_seen, heights, strict=True):
            row += pixels_of_points(camera, np.column_stack([columns, np.full(len(columns), z)])) >= 0
    common = n_seen >= needed
    if not np.any(common):
        raise ValueError(
            f"no point between the cameras and up to {CEILING_M} m above the floor z = 0 is seen by "
            f"{needed} of the {len(rig)} cameras; check the calibration's units and axes, or give room bounds"
        )
    place = common[heights < PERSON_M].mean(axis=0) >= _SEEN_SHARE
    if not np.any(place):
        place = common.any(axis=0)
    lower = columns[place].min(axis=0) - _COARSE_M / 2 - REACH_M
    upper = columns[place].max(axis=0) + _COARSE_M / 2 + REACH_M
    common &= np.all((columns > lower) & (columns < upper), axis=1)
    seen = columns[common.any(axis=0)]
    top = heights[common.any(axis=1)].max() + _COARSE_M / 2
    lower = np.maximum(lower, seen.min(axis=0) - _COARSE_M / 2)
    upper = np.minimum(upper, seen.max(axis=0) + _COARSE_M / 2)
    return np.array([*lower, 0.0]), np.array([*upper, top])


def _plan_samples(rig: CameraRig) -> Array:
    """Points (n, 2) m of a plan raster of the region where people may be."""
    import cv2

    centers = np.array([c.center for c in rig])
    target = look_at_point(rig)
    corners = np.concatenate([centers[:, :2], 2 * target[:2] - centers[:, :2]])
    hull = cv2.convexHull(corners.astype(np.float32)).reshape(-1, 2).astype(np.float64)
    if len(hull) < 3:
        hull = np.stack([hull.min(axis=0) - _BESIDE_LINE_M, hull.max(axis=0) + _BESIDE_LINE_M])
    lower, upper = hull.min(axis=0), hull.max(axis=0)
    axes = [np.arange(lo + _COARSE_M / 2, hi, _COARSE_M) for lo, hi in zip(lower, upper, strict=True)]
    plan = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2)
    if len(hull) < 3:
        return plan
    contour = hull.astype(np.float32).reshape(-1, 1, 2)
    gap = np.array([cv2.pointPolygonTest(contour, (float(x), float(y)), True) for x, y in plan])
    return plan[gap >= 0]


def look_at_point(rig: CameraRig) -> Array:
    """World point (3,) m nearest to all optical axes, in front of the cameras and within 6 m of them.

    Parallel axes meet nowhere: then it is the point 3 m in front of the mean camera.
    """
    centers = np.array([c.center for c in rig])
    axes = np.array([c.R[2] for c in rig])
    across = np.eye(3) - axes[:, :, None] * axes[:, None, :]
    normal = across.sum(axis=0)
    ahead = centers.mean(axis=0) + 3.0 * axes.mean(axis=0)
    if np.linalg.eigvalsh(normal)[0] < 1e-3 * len(rig):
        return ahead
    point = np.linalg.solve(normal, np.einsum("cij,cj->i", across, centers))
    in_front = np.einsum("cj,cj->c", point - centers, axes) > 0
    if np.mean(in_front) < 0.5 or np.linalg.norm(point - centers, axis=1).min() > 6.0:
        return ahead
    return point
