"""A hull on larger voxels."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mocap.data import VoxelGrid
from mocap.volume import _coarsen_kernels as kernels
from mocap.volume._kernels import subscripts_and_bounds
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
    lower = np.zeros(3, dtype=np.int64)
    shape = np.zeros(3, dtype=np.int64)
    subs, first, end = subscripts_and_bounds(v, grid.shape[1], grid.shape[2])
    if len(v):
        lower = np.array([cell[i] for cell, i in zip(cells, first, strict=True)])
        shape = np.array([cell[i - 1] for cell, i in zip(cells, end, strict=True)]) - lower + 1
    # The block of coarse cells about the hull.
    count = np.zeros(tuple(shape), dtype=np.int32)
    row = np.empty(tuple(shape), dtype=np.int32)
    occupied = np.empty(count.size, dtype=np.int32)
    place = kernels.count_cells(subs, *cells, lower, count)
    _, ny, nz = coarse.shape
    occupied = occupied[: kernels.number_full_cells(count, *capacity, lower, ny, nz, row, occupied)].copy()
    row_of = np.empty(len(v), dtype=np.int64)
    kernels.rows_of_fine(subs, place, lower, grid.voxel_size_m / coarse.voxel_size_m, row, row_of)

    total = np.zeros((len(occupied), 3), dtype=np.int64)
    n_coloured = np.zeros(len(occupied), dtype=np.int64)
    if rgb is not None:
        known = np.ones(len(v), dtype=np.bool_) if has_colour is None else has_colour
        kernels.mean_colours(place, row, rgb, known, total, n_coloured)
    colours = np.floor(total / np.maximum(n_coloured, 1)[:, None] + 0.5).astype(np.uint8)
    return CoarseVoxels(coarse, occupied, colours, n_coloured > 0, row_of)
