"""Voxel likelihood: how well a pose explains the hull of one frame (CF 6.5)."""

from __future__ import annotations

import itertools
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mocap.body.flesh import LookUpTable
from mocap.body.kinematics import joint_transforms
from mocap.body.model import Body
from mocap.data.voxels import VoxelGrid
from mocap.likelihood._kernels import part_scores_kernel

Array = NDArray[np.float64]

SURFACE_MAX = 127  # bits 0-6 of a packed voxel
OCCUPIED_BIT = 128  # bit 7


@dataclass(frozen=True)
class VoxelLikelihoodSettings:
    """Variances of the four scores and the way parts are combined."""

    variance_out: float = 0.01
    """Source: CF Table 6.2."""
    variance_double: float = 0.01
    variance_empty: float = 0.1
    variance_surface: float = 0.1
    factorised: bool = True
    """Per-part likelihoods (CF 6.23); False pools all parts (CF 6.17-6.22)."""

    @property
    def variances(self) -> Array:
        return np.array([self.variance_out, self.variance_double, self.variance_empty, self.variance_surface])


@dataclass(frozen=True, eq=False)
class PackedVolume:
    """A crop of the hull as the likelihood reads it.

    crop : (nx, ny, nz) uint8; bit 7 = occupied, bits 0-6 = smoothed surface, 127 = on the surface. Its outermost
    layer is empty. lower_subscript : (3,) voxel subscript of crop[0, 0, 0] in the grid (may be negative).
    """

    crop: NDArray[np.uint8]
    lower_subscript: NDArray[np.int64]
    grid: VoxelGrid

    def __post_init__(self) -> None:
        if self.crop.ndim != 3 or self.crop.dtype != np.uint8:
            raise ValueError(
                f"crop must be a 3-D uint8 array, got {self.crop.dtype} of {self.crop.ndim} dims"
            )
        if self.crop.size >= 2**24:
            raise ValueError(f"crop of {self.crop.shape} voxels is too large (limit 2^24)")

    @property
    def lower_m(self) -> Array:
        """World position of the crop's lower corner, (3,) m."""
        return self.grid.origin + self.lower_subscript * self.grid.voxel_size_m


@dataclass(frozen=True, eq=False)
class PartScores:
    """The scores of CF 6.13-6.16 of N particles and P parts; each (N, P), in [0, 1].

    out : share of points outside the room (reading guide 10).  double : share in voxels that another part also
    holds.  occupied : share in occupied voxels.  surface : mean of 1 - smoothed surface over surface points.
    """

    out: Array
    double: Array
    occupied: Array
    surface: Array


def _counts_to_scores(counts: NDArray[np.int64], table: LookUpTable, n_parts: int) -> PartScores:
    size = np.bincount(table.part, weights=np.diff(table.start), minlength=n_parts)
    size_surface = np.bincount(table.part, weights=table.n_surface, minlength=n_parts)
    return PartScores(
        out=counts[..., 0] / size,
        double=counts[..., 1] / size,
        occupied=counts[..., 2] / size,
        surface=1.0 - counts[..., 3] / (SURFACE_MAX * np.maximum(size_surface, 1)),
    )


def part_scores(
    body: Body, table: LookUpTable, volume: PackedVolume, states: Array, *, n_threads: int = 1
) -> PartScores:
    """Scores of states (N, D) against one frame's volume.

    Double occupancy is counted on the voxels of the crop; points outside it meet nobody. States with NaN give
    every point outside the crop (occupied 0). The result does not depend on n_threads.
    Source: CF Eq. 6.12-6.16; departs from 6.13: outside means outside the room (reading guide 10).
    """
    s = np.ascontiguousarray(states, dtype=np.float64)
    if s.ndim != 2 or s.shape[1] != body.layout.n_columns:
        raise ValueError(f"states has shape {s.shape}, expected (N, {body.layout.n_columns})")
    counts = np.zeros((len(s), body.layout.n_parts, 4), dtype=np.int64)
    x, y, z = (np.ascontiguousarray(table.points[:, i]) for i in range(3))
    fixed: tuple[Any, ...] = (
        *body.chain,
        x,
        y,
        z,
        table.start,
        table.n_surface,
        table.joint,
        table.part,
        table.center,
        table.radius,
        volume.crop.reshape(-1),
        np.array(volume.crop.shape, dtype=np.int64),
        volume.lower_m,
        volume.grid.voxel_size_m,
        volume.grid.origin,
        volume.grid.upper,
    )
    n_chunks = min(n_threads, len(s))
    if n_chunks <= 1:
        part_scores_kernel(s, *fixed, counts)
    else:
        edges = np.linspace(0, len(s), n_chunks + 1).astype(int)
        with ThreadPoolExecutor(n_chunks) as pool:
            jobs = [
                pool.submit(part_scores_kernel, *(s[a:b], *fixed, counts[a:b]))
                for a, b in itertools.pairwise(edges)
            ]
            for job in jobs:
                job.result()
    return _counts_to_scores(counts, table, body.layout.n_parts)


def part_scores_numpy(body: Body, table: LookUpTable, volume: PackedVolume, states: Array) -> PartScores:
    """The same scores written plainly with numpy: the kernel's twin and the benchmark's competitor.

    It counts in voxel units and float32 as the kernel does, so that both agree on points at a voxel's border. Voxel 0
    of the crop, part of its empty rim, is where the kernel puts points from outside: nobody meets there.
    """
    P = body.layout.n_parts
    R, t = joint_transforms(body, states)
    voxel_size, crop_lower = volume.grid.voxel_size_m, volume.lower_m
    A = (R / voxel_size).astype(np.float32)
    b = ((t - crop_lower) / voxel_size).astype(np.float32)
    room_lower = ((volume.grid.origin - crop_lower) / voxel_size).astype(np.float32)
    room_upper = ((volume.grid.upper - crop_lower) / voxel_size).astype(np.float32)
    counts = np.zeros((len(states), P, 4), dtype=np.int64)
    shape = np.array(volume.crop.shape)
    flat = volume.crop.reshape(-1)
    segment = np.repeat(np.arange(len(table.joint)), np.diff(table.start))
    part, joint = table.part[segment], table.joint[segment]
    is_surface = np.arange(len(segment)) - table.start[segment] < table.n_surface[segment]
    x, y, z = (table.points[:, i, None] for i in range(3))
    owner = np.zeros(volume.crop.size, dtype=part.dtype)
    is_shared = np.zeros(volume.crop.size, dtype=np.bool_)
    for n in range(len(states)):
        a = A[n, joint]
        at = a[:, :, 0] * x + a[:, :, 1] * y + a[:, :, 2] * z + b[n, joint]
        with np.errstate(invalid="ignore"):
            out = np.any((at < room_lower) | (at > room_upper), axis=1)
            inside = np.all((at >= 0) & (at < shape.astype(np.float32)), axis=1)
        cell = np.floor(np.where(inside[:, None], at, 0.0)).astype(np.int64)
        linear = (cell[:, 0] * shape[1] + cell[:, 1]) * shape[2] + cell[:, 2]
        inside &= linear > 0
        # The last part to be written into a voxel owns it; whoever finds another owner there shares it.
        owner[linear[inside]] = part[inside]
        shared = linear[inside & (owner[linear] != part)]
        is_shared[shared] = True
        double = inside & is_shared[linear]
        is_shared[shared] = False
        value = np.where(inside, flat[linear], 0)
        counts[n, :, 0] = np.bincount(part, weights=out, minlength=P)
        counts[n, :, 1] = np.bincount(part, weights=double, minlength=P)
        counts[n, :, 2] = np.bincount(part, weights=value >> 7, minlength=P)
        counts[n, :, 3] = np.bincount(part, weights=np.where(is_surface, value & SURFACE_MAX, 0), minlength=P)
    return _counts_to_scores(counts, table, P)


def factorised_log_likelihood(scores: PartScores, body: Body, settings: VoxelLikelihoodSettings) -> Array:
    """Per-part log-likelihoods, (N, P): -1/2 sum of d^2 / sigma^2 over the four scores.

    Source: CF Eq. 6.23-6.25 with the factors of Table 6.2; Empty = 1 - Occ (reading guide 12).
    """
    variance = settings.variances * body.variance
    d = np.stack([scores.out, scores.double, 1.0 - scores.occupied, scores.surface], axis=-1)
    return -0.5 * np.sum(d**2 / variance, axis=-1)


def global_log_likelihood(scores: PartScores, table: LookUpTable, settings: VoxelLikelihoodSettings) -> Array:
    """One log-likelihood for the whole body, (N, 1): scores pooled over parts by their number of points.

    Source: CF Eq. 6.17-6.22.
    """
    n_parts = scores.out.shape[1]
    size = np.bincount(table.part, weights=np.diff(table.start), minlength=n_parts)
    size_surface = np.bincount(table.part, weights=table.n_surface, minlength=n_parts)

    def pooled(score: Array, weight: NDArray[np.number]) -> Array:
        return score @ weight / weight.sum()

    d = np.stack(
        [
            pooled(scores.out, size),
            pooled(scores.double, size),
            1.0 - pooled(scores.occupied, size),
            pooled(scores.surface, size_surface),
        ],
        axis=-1,
    )
    return -0.5 * np.sum(d**2 / settings.variances, axis=-1)[:, None]
