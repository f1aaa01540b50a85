"""A hull on larger voxels."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mocap.data import VoxelGrid
from mocap.volume.surface import check_voxels

Voxels = NDArray[np.int32]


@dataclass(frozen=True, eq=False)
class CoarseVoxels:
    """A hull on larger voxels, and where every fine voxel went.

    grid : the coarse grid, of the same lower corner.  voxels : (M,) int32 ascending.
    rgb : (M, 3) uint8, mean over the coloured fine voxels.  has_colour : (M,) bool, there were some.
    row_of : (N,) int64, row of the coarse voxel that each fine one lies in or beside; -1 = there is none.
    """

    grid: VoxelGrid
    voxels: Voxels
    rgb: NDArray[np.uint8]
    has_colour: NDArray[np.bool_]
    row_of: NDArray[np.int64]


def coarsen(
    voxels: Voxels,
    grid: VoxelGrid,
    voxel_size_m: float,
    rgb: NDArray[np.uint8] | None = None,
    has_colour: NDArray[np.bool_] | None = None,
) -> CoarseVoxels:
    """The same hull on voxels of side voxel_size_m, which need not be a multiple of the fine side.

    voxels : (N,) int32 ascending.  rgb : (N, 3) uint8 and has_colour : (N,) bool; None = no colours.
    A coarse voxel is occupied when at least half of the fine centres in it are: the volume stays what it was, as
    with carving at that size.  A fine voxel whose coarse one is empty goes to an occupied neighbour, the one with the
    nearest centre among the 26, if there is one.
    """
    v = check_voxels(voxels, grid)
    if voxel_size_m < grid.voxel_size_m:
        raise ValueError(f"voxel_size_m is {voxel_size_m}, expected at least the hull's {grid.voxel_size_m}")
    extent = np.array(grid.shape) * grid.voxel_size_m
    coarse = VoxelGrid.from_bounds(grid.origin, grid.origin + extent, voxel_size_m)
    # Which coarse index each fine index falls into, and how many fine ones each coarse one holds, axis by axis.
    cells, capacity = [], []
    for n_fine, n_coarse in zip(grid.shape, coarse.shape, strict=True):
        cell = np.floor((np.arange(n_fine) + 0.5) * (grid.voxel_size_m / voxel_size_m) + 1e-9).astype(
            np.int64
        )
        cell = np.minimum(cell, n_coarse - 1)
        cells.append(cell)
        capacity.append(np.bincount(cell, minlength=n_coarse))
    subs = grid.subscripts(v)
    of_fine = np.column_stack([cell[subs[:, i]] for i, cell in enumerate(cells)])
    touched, inverse, count = np.unique(
        coarse.linear(of_fine).astype(np.int64), return_inverse=True, return_counts=True
    )
    inverse = inverse.reshape(-1)
    at = coarse.subscripts(touched.astype(np.int32))
    room = capacity[0][at[:, 0]] * capacity[1][at[:, 1]] * capacity[2][at[:, 2]]
    is_full = 2 * count >= room
    occupied = touched[is_full].astype(np.int32)
    row_of_touched = np.where(is_full, np.cumsum(is_full) - 1, -1)
    row_of = row_of_touched[inverse]
    _adopt(row_of, subs, grid, coarse, of_fine, occupied)

    colours = np.zeros((len(occupied), 3), dtype=np.uint8)
    n_coloured = np.zeros(len(occupied), dtype=np.int64)
    if rgb is not None and len(occupied):
        known = np.ones(len(v), dtype=np.bool_) if has_colour is None else has_colour
        inside = np.flatnonzero(known & (row_of_touched[inverse] >= 0))
        rows = row_of[inside]
        n_coloured = np.bincount(rows, minlength=len(occupied))
        for channel in range(3):
            total = np.bincount(rows, weights=rgb[inside, channel], minlength=len(occupied))
            colours[:, channel] = np.floor(total / np.maximum(n_coloured, 1) + 0.5)
    return CoarseVoxels(coarse, occupied, colours, n_coloured > 0, row_of)


def _adopt(
    row_of: NDArray[np.int64],
    subs: NDArray[np.int32],
    grid: VoxelGrid,
    coarse: VoxelGrid,
    of_fine: NDArray[np.int64],
    occupied: Voxels,
) -> None:
    """Give fine voxels in empty coarse ones to the occupied neighbour whose centre is nearest."""
    loose = np.flatnonzero(row_of < 0)
    if not len(loose) or not len(occupied):
        return
    point = (subs[loose] + 0.5) * (grid.voxel_size_m / coarse.voxel_size_m)
    best = np.full(len(loose), np.inf)
    steps = np.stack(np.meshgrid(*[(-1, 0, 1)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    for step in steps:
        cell = of_fine[loose] + step
        inside = np.all((cell >= 0) & (cell < np.array(coarse.shape)), axis=1)
        index = coarse.linear(np.where(inside[:, None], cell, 0))
        row = np.minimum(np.searchsorted(occupied, index), len(occupied) - 1)
        gap = np.linalg.norm(cell + 0.5 - point, axis=1)
        better = inside & (occupied[row] == index) & (gap < best)
        row_of[loose[better]] = row[better]
        best[better] = gap[better]
