"""Surface of a voxel set, and its smoothed map for the likelihood."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mocap.data import VoxelGrid
from mocap.volume import _kernels

Voxels = NDArray[np.int32]

OCCUPIED_BIT = 128
SURFACE_LEVELS = 127


def check_voxels(voxels: Voxels, grid: VoxelGrid) -> Voxels:
    """The list as contiguous int32; raises ValueError unless it is strictly ascending and inside the grid."""
    # Read-only arrays would make the compiler build every kernel a second time.
    v = np.require(voxels, np.int32, ("C", "W"))
    if v.ndim != 1 or (len(v) and (v[0] < 0 or v[-1] >= grid.n_voxels or np.any(v[1:] <= v[:-1]))):
        raise ValueError(f"voxels: expected ascending linear indices in 0 .. {grid.n_voxels - 1}, shape (N,)")
    return v


def subscripts_and_bounds(
    voxels: Voxels, grid: VoxelGrid
) -> tuple[NDArray[np.int32], NDArray[np.int64], NDArray[np.int64]]:
    """Subscripts (N, 3) of a list (N,), ascending, and their lower and upper corner, (3,) each, the upper exclusive."""
    v = check_voxels(voxels, grid)
    subs, lower, upper = _kernels.subscripts_and_bounds(v, grid.shape[1], grid.shape[2])
    return subs, lower, upper


def surface_voxels(
    voxels: Voxels, grid: VoxelGrid, unknown: Voxels | None = None, *, beyond_is_empty: bool = True
) -> NDArray[np.bool_]:
    """Whether each occupied voxel has an empty 6-neighbour; below the grid it is empty.

    voxels : (N,) int32 ascending.  unknown : (U,) the same, voxels that may be occupied: where the next one is unknown
    nobody has seen a surface.  beyond_is_empty : whether beside and above the grid it is empty too, or unknown.
    Returns (N,) bool; N = 0 gives an empty array.
    """
    v = check_voxels(voxels, grid)
    is_surface = np.zeros(len(v), dtype=np.bool_)
    if len(v):
        subs, lower, upper = subscripts_and_bounds(v, grid)
        crop = np.zeros(tuple(upper - lower + 2), dtype=np.uint8)
        _kernels.fill_crop(subs, lower - 1, crop)
        if unknown is not None:
            _kernels.fill_crop(subscripts_and_bounds(unknown, grid)[0], lower - 1, crop)
        if not beyond_is_empty:
            fill_beyond(crop, lower - 1, grid, 1)
        _kernels.surface_of_crop(subs, lower - 1, crop, is_surface)
    return is_surface


def gaussian_weights(sigma_voxels: float) -> NDArray[np.float32]:
    """One-dimensional Gaussian weights, (2 r + 1,), r = ceil(2 sigma), sum 1; sigma 0 gives [1]."""
    if not (math.isfinite(sigma_voxels) and 0 <= sigma_voxels <= 8):
        raise ValueError(f"sigma_voxels: expected 0 .. 8, got {sigma_voxels}")
    if sigma_voxels == 0:
        return np.ones(1, dtype=np.float32)
    r = math.ceil(2 * sigma_voxels)
    weights = np.exp(-0.5 * (np.arange(-r, r + 1) / sigma_voxels) ** 2)
    return (weights / weights.sum()).astype(np.float32)


def surface_map(
    voxels: Voxels,
    is_surface: NDArray[np.bool_],
    grid: VoxelGrid,
    lower_sub: ArrayLike,
    upper_sub: ArrayLike,
    sigma_voxels: float = 1.0,
) -> NDArray[np.uint8]:
    """Occupancy and proximity to the surface, one byte per voxel of a crop.

    voxels : (N,) int32 ascending.  is_surface : (N,) bool.
    lower_sub, upper_sub : (3,) voxel subscripts of the crop, upper exclusive; they may exceed the grid.
    Returns uint8 of shape upper_sub - lower_sub; its element (0, 0, 0) is the voxel lower_sub. Bit 7 =
    occupied; bits 0-6 = 127 x the surface smoothed with a Gaussian of sigma_voxels (cut at 2 sigma),
    remapped to [0, 1]. The outermost layer of the crop is zero whatever it holds, so that clamping an index
    into the crop reads "empty" for everything outside.
    Source: CF 6.5.1, text before Eq. 6.16. The remapping is ours: 1 is what a flat sheet of surface voxels
    has on itself, larger values (edges, thin limbs) saturate; a maximum over the frame would depend on one
    corner.
    """
    v = check_voxels(voxels, grid)
    lower = np.asarray(lower_sub, dtype=np.int64)
    upper = np.asarray(upper_sub, dtype=np.int64)
    if lower.shape != (3,) or upper.shape != (3,) or np.any(upper - lower < 1):
        raise ValueError(f"crop: expected lower < upper, each (3,), got {lower_sub!r} and {upper_sub!r}")
    if len(is_surface) != len(v):
        raise ValueError(f"is_surface: expected ({len(v)},), got {np.shape(is_surface)}")
    packed = np.zeros(tuple(upper - lower), dtype=np.uint8)
    if len(v):
        kernel = gaussian_weights(sigma_voxels)
        subs, first, last = subscripts_and_bounds(v, grid)
        # Work arrays only where the surface reaches; the crop may be far larger.
        r = len(kernel) // 2
        corner = np.maximum(first - lower - r, -r)
        extent = np.minimum(last - lower + r, np.array(packed.shape) + r) - corner
        if np.all(extent > 0):
            work = np.zeros((2, *extent), dtype=np.float32)
            gain = np.float32(SURFACE_LEVELS / kernel.max())
            outer = np.ascontiguousarray(is_surface, dtype=np.bool_)
            _kernels.smooth_surface(subs, outer, lower, kernel, gain, corner, work[0], work[1], packed)
    return packed


def mark_unknown(
    packed: NDArray[np.uint8], lower_sub: NDArray[np.int64], unknown: NDArray[np.int32], value: int
) -> None:
    """Set the bits of a value where a map of a crop, but for its outermost layer, holds unknown voxels (U, 3)."""
    _kernels.mark_inner(unknown, lower_sub, np.uint8(value), packed)


def bounds_within(
    subs: NDArray[np.int32], low: NDArray[np.int64], high: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.int64]] | None:
    """Corners, (3,) each, the upper exclusive, of those subscripts (N, 3) that lie in low .. high, both included; None
    where none does."""
    n, lower, upper = _kernels.bounds_within(subs, low, high)
    return (lower, upper) if n else None


def fill_beyond(crop: NDArray[np.uint8], lower_sub: NDArray[np.int64], grid: VoxelGrid, value: int) -> None:
    """Set the bits of a value in what of a crop lies beside or above the grid."""
    before, after = np.maximum(-lower_sub, 0), np.array(grid.shape) - lower_sub
    beside = (crop[: before[0]], crop[after[0] :], crop[:, : before[1]], crop[:, after[1] :])
    for part in (*beside, crop[:, :, after[2] :]):
        part |= np.uint8(value)
