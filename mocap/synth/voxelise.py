"""The voxels inside a posed body: exact winding numbers along vertical lines through the voxel centres."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mocap.data import VoxelGrid

Array = NDArray[np.float64]


def solid_voxels(vertices: Array, faces: NDArray[np.int64], grid: VoxelGrid) -> NDArray[np.int32]:
    """Linear indices (N,) int32, ascending, of the voxels whose centre is inside the closed mesh.

    vertices : (V, 3) m, world.  faces : (F, 3), outward. A point is inside where the winding number is positive, so
    that parts of a skinned mesh that run into each other count as solid. Voxels outside the grid are left out.
    """
    s = grid.voxel_size_m
    # A tiny shift of the lines against the mesh keeps them off vertices and edges.
    points = (vertices - grid.origin) / s - 0.5 + np.array([3.1e-7, 7.3e-7, 0.0])
    low = np.clip(np.floor(points.min(axis=0)).astype(int), 0, None)
    high = np.minimum(np.ceil(points.max(axis=0)).astype(int) + 1, grid.shape)
    if np.any(high <= low):
        return np.zeros(0, dtype=np.int32)
    a, b, c = (points[faces[:, k]] for k in range(3))
    double = (b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) - (b[:, 1] - a[:, 1]) * (c[:, 0] - a[:, 0])
    first = np.maximum(np.ceil(np.minimum(np.minimum(a, b), c)[:, :2]).astype(int), low[:2])
    last = np.minimum(np.floor(np.maximum(np.maximum(a, b), c)[:, :2]).astype(int), high[:2] - 1)
    n = np.maximum(last - first + 1, 0)
    used = np.flatnonzero((n[:, 0] * n[:, 1] > 0) & (double != 0))
    count = n[used, 0] * n[used, 1]
    face = np.repeat(used, count)
    order = np.arange(len(face)) - np.repeat(np.cumsum(count) - count, count)
    x = first[face, 0] + order // n[face, 1]
    y = first[face, 1] + order % n[face, 1]
    pa, pb, pc = a[face], b[face], c[face]
    wa = (pb[:, 0] - x) * (pc[:, 1] - y) - (pb[:, 1] - y) * (pc[:, 0] - x)
    wb = (pc[:, 0] - x) * (pa[:, 1] - y) - (pc[:, 1] - y) * (pa[:, 0] - x)
    wc = (pa[:, 0] - x) * (pb[:, 1] - y) - (pa[:, 1] - y) * (pb[:, 0] - x)
    sign = np.sign(double[face])
    # Edges that two triangles share belong to one of them; the shift makes exact ties impossible in practice.
    inside = (wa * sign >= 0) & (wb * sign >= 0) & (wc * sign >= 0)
    z = (wa * pa[:, 2] + wb * pb[:, 2] + wc * pc[:, 2])[inside] / double[face][inside]
    shape = tuple(high - low)
    winding = np.zeros((*shape[:2], shape[2] + 1), dtype=np.int32)
    level = np.clip(np.ceil(z).astype(int), low[2], high[2]) - low[2]
    # Going up, a face that looks down (negative area from above) is an entry.
    step = np.where(sign[inside] < 0, 1, -1)
    np.add.at(winding, (x[inside] - low[0], y[inside] - low[1], level), step)
    solid = np.cumsum(winding, axis=2)[:, :, :-1] > 0
    found = np.argwhere(solid) + low
    return grid.linear(found)
