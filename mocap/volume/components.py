"""Connected components of a sparse voxel set."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mocap.data import VoxelGrid
from mocap.volume import _kernels
from mocap.volume.surface import check_voxels

# How far the z-intervals of two runs may miss each other and still touch: (across a side, across an edge).
_SLACK = {6: (0, -1), 18: (1, 0), 26: (1, 1)}


def connected_components(
    voxels: NDArray[np.int32], grid: VoxelGrid, connectivity: int = 26
) -> tuple[NDArray[np.int32], int]:
    """Component of each occupied voxel, the largest component first.

    voxels : (N,) int32 ascending.  connectivity : 6, 18 or 26 neighbours.
    Returns labels (N,) int32 in 0 .. n - 1, ordered by size (equal sizes by first voxel), and n; N = 0 gives
    n = 0.
    """
    if connectivity not in _SLACK:
        raise ValueError(f"connectivity: expected 6, 18 or 26, got {connectivity}")
    v = check_voxels(voxels, grid)
    if len(v) == 0:
        return np.zeros(0, dtype=np.int32), 0
    root = np.empty(len(v), dtype=np.int32)
    run = np.empty(len(v), dtype=np.int32)
    side, corner = _SLACK[connectivity]
    n_runs = _kernels.union_runs(v, grid.shape[1], grid.shape[2], side, corner, root, run)
    sizes = np.zeros(n_runs, dtype=np.int64)
    _kernels.count_runs(root, run, sizes)
    roots = np.flatnonzero(sizes)
    order = np.argsort(-sizes[roots], kind="stable")
    rank = np.empty(n_runs, dtype=np.int32)
    rank[roots[order]] = np.arange(len(roots), dtype=np.int32)
    _kernels.name_runs(rank, root, run)
    return run, len(roots)
