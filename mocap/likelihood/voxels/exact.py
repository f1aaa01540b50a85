"""Voxel likelihood: how well a pose explains the hull of one frame (CF 6.5)."""

from __future__ import annotations

import itertools
import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from mocap.arrays import Array
from mocap.body.flesh import LookUpTable
from mocap.body.kinematics import joint_transforms
from mocap.body.model import Body
from mocap.data.voxels import VoxelGrid
from mocap.likelihood.voxels._exact_kernels import (
    MAX_LIMB_PARTS,
    Box,
    Segments,
    limb_scores_kernel,
    part_scores_kernel,
    take_voxels,
)
from mocap.threads import in_parallel

SURFACE_MAX = 127  # bits 0-6 of a packed voxel
OCCUPIED_BIT = 128  # bit 7
_MIN_CHUNK = 32  # states for a thread of their own


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
    kind: Literal["exact", "fast"] = "exact"
    """All points of the body, or a sample of them (`fast.fast_part_scores`)."""
    n_points: int = 200
    """Points per part of the fast kind."""
    device: Literal["cpu", "cuda"] = "cpu"
    """What scores many states at once (`device.device_part_scores`)."""

    @property
    def variances(self) -> Array:
        return np.array([self.variance_out, self.variance_double, self.variance_empty, self.variance_surface])


@dataclass(frozen=True, eq=False)
class PackedVolume:
    """A crop of the hull as the likelihood reads it.

    crop : (nx, ny, nz) uint8; bit 7 = occupied, bits 0-6 = smoothed surface, 127 = on the surface. Its outermost
    layer is empty. lower_subscript : (3,) voxel subscript of crop[0, 0, 0] in the grid (may be negative).
    beyond : (2, 3) voxels by which the room goes on beyond the grid, below and above; it ends where the grid does if 0.
    """

    crop: NDArray[np.uint8]
    lower_subscript: NDArray[np.int64]
    grid: VoxelGrid
    beyond: NDArray[np.int64] = field(default_factory=lambda: np.zeros((2, 3), dtype=np.int64))

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

    @property
    def box(self) -> Box:
        """Place of crop and room, as the kernels take it."""
        return Box(
            shape=np.array(self.crop.shape, dtype=np.int64),
            lower=self.lower_m,
            voxel_size=float(self.grid.voxel_size_m),
            room_lower=self.grid.origin - self.beyond[0] * self.grid.voxel_size_m,
            room_upper=self.grid.upper + self.beyond[1] * self.grid.voxel_size_m,
        )


@dataclass(frozen=True, eq=False)
class PartScores:
    """The scores of CF 6.13-6.16 of N particles and P parts (or those asked for); each (N, P), in [0, 1].

    out : share of points outside the room (reading guide 10).  double : share in voxels that another part also
    holds.  occupied : share in occupied voxels.  surface : mean of 1 - smoothed surface over surface points.
    """

    out: Array
    double: Array
    occupied: Array
    surface: Array


@lru_cache(maxsize=64)
def selected(
    table: LookUpTable, parts: tuple[int, ...], given: tuple[int, ...]
) -> tuple[Segments, Array, Array]:
    """Segments of `parts` (scored) and then of `given` (placed only), and the parts' numbers of points, two (P',).

    Copied so that they lie together; a filter asks for the same few selections in every layer.
    """
    placed = [*parts, *given]
    column_of = {p: i for i, p in enumerate(placed)}
    order = [int(s) for p in placed for s in np.flatnonzero(table.part == p)]
    length, n_surface = np.diff(table.start)[order], table.n_surface[order]
    rows = [np.arange(table.start[s], table.start[s + 1]) for s in order]
    x, y, z = np.ascontiguousarray(table.points[np.concatenate(rows) if rows else []].T)
    column = np.array([column_of[p] for p in table.part[order].tolist()], dtype=np.int64)
    n_scored = int((column < len(parts)).sum())

    def per_part(count: NDArray[np.int64]) -> Array:
        sums = np.bincount(column[:n_scored], weights=count[:n_scored], minlength=len(parts))
        return sums.astype(np.float64)

    return (
        Segments(
            x=x,
            y=y,
            z=z,
            start=np.concatenate([[0], np.cumsum(length)]).astype(np.int64),
            n_surface=n_surface,
            joint=table.joint[order],
            part=column,
            center=table.center[order],
            radius=table.radius[order],
            n_scored=n_scored,
        ),
        per_part(length),
        per_part(n_surface),
    )


_scratch = threading.local()


def _cells(n: int) -> NDArray[np.uint32]:
    """Scratch of n cells, one per thread: a fresh one costs as much as a hundred evaluations in page faults."""
    held: NDArray[np.uint32] | None = getattr(_scratch, "cells", None)
    if held is None or len(held) < n:
        held = _scratch.cells = np.empty(n, dtype=np.uint32)
    return held[:n]


def check_states(body: Body, states: Array) -> Array:
    """States (N, D) as the kernels take them; ValueError for another shape."""
    s = np.ascontiguousarray(states, dtype=np.float64)
    if s.ndim != 2 or s.shape[1] != body.layout.n_columns:
        raise ValueError(f"states has shape {s.shape}, expected (N, {body.layout.n_columns})")
    return s


def chosen_parts(
    body: Body, parts: Sequence[int] | None, given: Sequence[int]
) -> tuple[tuple[int, ...], tuple[int, ...]]:
    """Parts to score, and parts that are only placed; ValueError for one that does not exist or comes twice."""
    P = body.layout.n_parts
    chosen = tuple(range(P)) if parts is None else tuple(int(p) for p in parts)
    placed = tuple(sorted({int(p) for p in given} - set(chosen)))
    if len(set(chosen)) < len(chosen) or not all(0 <= p < P for p in (*chosen, *placed)):
        raise ValueError(
            f"parts and given must be different indices in 0..{P - 1}, got {list(chosen)} and {list(given)}"
        )
    return chosen, placed


def run_chunks(score: Callable[[int, int], None], n: int, n_threads: int) -> None:
    """Call score(first, last) so that 0..n is covered, on several threads when that pays."""
    n_chunks = min(n_threads, n // _MIN_CHUNK)
    if n_chunks <= 1:
        score(0, n)
        return
    edges = np.linspace(0, n, n_chunks + 1).astype(int)
    in_parallel(lambda chunk: score(*chunk), list(itertools.pairwise(edges)), n_chunks)


def counts_to_scores(counts: NDArray[np.int64], size: Array, size_surface: Array) -> PartScores:
    """The scores that counts (N, P', 4) of a kernel mean.  size, size_surface : (P',), as of `selected`."""
    return PartScores(
        out=counts[..., 0] / size,
        double=counts[..., 1] / size,
        occupied=counts[..., 2] / size,
        surface=1.0 - counts[..., 3] / (SURFACE_MAX * np.maximum(size_surface, 1)),
    )


def part_scores(
    body: Body,
    table: LookUpTable,
    volume: PackedVolume,
    states: Array,
    *,
    parts: Sequence[int] | None = None,
    given: Sequence[int] = (),
    n_threads: int = 1,
) -> PartScores:
    """Scores of states (N, D) against one frame's volume.

    parts : the parts to score, in the order of the columns; None = all.  given : parts that are placed but not
    scored: they count in the double occupancy of the others; all other parts are absent.
    Double occupancy is counted on the voxels of the crop; points outside it meet nobody. States with NaN give
    every point outside the crop (occupied 0). The result does not depend on n_threads.
    Raises ValueError for states of a wrong shape and for parts that do not exist or come twice.
    Source: CF Eq. 6.12-6.16; departs from 6.13: outside means outside the room (reading guide 10).
    """
    s = check_states(body, states)
    chosen, placed = chosen_parts(body, parts, given)
    segments, size, size_surface = selected(table, chosen, placed)
    counts = np.zeros((len(s), len(chosen), 4), dtype=np.int64)
    crop = volume.crop.reshape(-1)

    def score(first: int, last: int) -> None:
        part_scores_kernel(
            s[first:last], body.chain, segments, volume.box, crop, _cells(crop.size), counts[first:last]
        )

    run_chunks(score, len(s), n_threads)
    return counts_to_scores(counts, size, size_surface)


@dataclass(frozen=True, eq=False)
class HeldBody:
    """One limb's scores while the rest of the body holds still: those of `part_scores` with the rest as `given`, at the
    price of the limb alone.

    limb : parts, in the order of the columns.
    """

    body: Body
    table: LookUpTable
    volume: PackedVolume
    limb: tuple[int, ...]
    _taken: NDArray[np.uint8]

    def scores(self, states: Array) -> PartScores:
        """Scores of states (N, D) that differ from the held one in the limb's columns only, (N, limb's parts) each."""
        s = check_states(self.body, states)
        segments, size, size_surface = selected(self.table, self.limb, ())
        counts = np.zeros((len(s), len(self.limb), 4), dtype=np.int64)
        crop = self.volume.crop.reshape(-1)
        limb_scores_kernel(s, self.body.chain, segments, self.volume.box, crop, self._taken, counts)
        return counts_to_scores(counts, size, size_surface)


def held_body(
    body: Body, table: LookUpTable, volume: PackedVolume, state: Array, limb: Sequence[int]
) -> HeldBody:
    """The body of a state (D,), of which only a limb will move.

    Raises ValueError for a limb of no or of more than MAX_LIMB_PARTS parts, and for parts that do not exist or come
    twice.
    """
    parts, rest = chosen_parts(body, limb, range(body.layout.n_parts))
    if not 0 < len(parts) <= MAX_LIMB_PARTS:
        raise ValueError(f"a limb has 1 to {MAX_LIMB_PARTS} parts, got {len(parts)}")
    taken = np.zeros(volume.crop.size, dtype=np.uint8)
    segments, _, _ = selected(table, rest, ())
    take_voxels(check_states(body, state[None])[0], body.chain, segments, volume.box, taken)
    return HeldBody(body, table, volume, parts, taken)


def part_scores_numpy(
    body: Body,
    table: LookUpTable,
    volume: PackedVolume,
    states: Array,
    *,
    parts: Sequence[int] | None = None,
    given: Sequence[int] = (),
) -> PartScores:
    """The same scores written plainly with numpy: the kernel's twin and the benchmark's competitor.

    It counts in voxel units and float32 as the kernel does, so that both agree on points at a voxel's border. Voxel 0
    of the crop, part of its empty rim, is where the kernel puts points from outside: nobody meets there.
    """
    P = body.layout.n_parts
    chosen, placed = chosen_parts(body, parts, given)
    R, t = joint_transforms(body, states)
    box = volume.box
    voxel_size, crop_lower = box.voxel_size, box.lower
    A = (R / voxel_size).astype(np.float32)
    b = ((t - crop_lower) / voxel_size).astype(np.float32)
    room_lower = ((box.room_lower - crop_lower) / voxel_size).astype(np.float32)
    room_upper = ((box.room_upper - crop_lower) / voxel_size).astype(np.float32)
    counts = np.zeros((len(states), P, 4), dtype=np.int64)
    shape = np.array(volume.crop.shape)
    flat = volume.crop.reshape(-1)
    segment = np.repeat(np.arange(len(table.joint)), np.diff(table.start))
    is_surface = np.arange(len(segment)) - table.start[segment] < table.n_surface[segment]
    present = np.isin(table.part[segment], (*chosen, *placed))
    segment, is_surface, points = segment[present], is_surface[present], table.points[present]
    part, joint = table.part[segment], table.joint[segment]
    x, y, z = (points[:, i, None] for i in range(3))
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
    return counts_to_scores(counts[:, list(chosen)], *selected(table, chosen, placed)[1:])


def factorised_log_likelihood(
    scores: PartScores, body: Body, settings: VoxelLikelihoodSettings, parts: Sequence[int] | None = None
) -> Array:
    """Per-part log-likelihoods, (N, P'): -1/2 sum of d^2 / sigma^2 over the four scores.

    parts : the parts of the scores' columns; None = all.
    Source: CF Eq. 6.23-6.25 with the factors of Table 6.2; Empty = 1 - Occ (reading guide 12).
    """
    factors = body.variance if parts is None else body.variance[np.array(parts, dtype=np.int64)]
    variance = settings.variances * factors
    d = np.stack([scores.out, scores.double, 1.0 - scores.occupied, scores.surface], axis=-1)
    return -0.5 * np.sum(d**2 / variance, axis=-1)


def global_log_likelihood(
    scores: PartScores,
    table: LookUpTable,
    settings: VoxelLikelihoodSettings,
    parts: Sequence[int] | None = None,
) -> Array:
    """One log-likelihood for the whole body, (N, 1): scores pooled over parts by their number of points.

    parts : the parts of the scores' columns; None = all.
    Source: CF Eq. 6.17-6.22.
    """
    columns = slice(None) if parts is None else np.array(parts, dtype=np.int64)
    n_parts = int(table.part.max()) + 1
    size = np.bincount(table.part, weights=np.diff(table.start), minlength=n_parts)[columns]
    size_surface = np.bincount(table.part, weights=table.n_surface, minlength=n_parts)[columns]

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
