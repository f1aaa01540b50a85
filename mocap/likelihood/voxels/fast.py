"""Fast voxel likelihood: the scores of CF 6.13-6.16 from a sample of the points, overlaps from maps of the parts."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from mocap.arrays import Array
from mocap.body.flesh import LookUpTable
from mocap.body.model import Body
from mocap.likelihood.voxels._exact_kernels import Segments
from mocap.likelihood.voxels._fast_kernels import (
    FastSample,
    Overlap,
    fast_scores_kernel,
    picked_on_path,
)
from mocap.likelihood.voxels.exact import (
    SURFACE_MAX,
    PackedVolume,
    PartScores,
    check_states,
    chosen_parts,
    run_chunks,
)

Index = NDArray[np.int64]

# A voxel of the size of the table's spacing, thrown at random deep into a part that is turned at random, holds at
# least one of its points with this chance (20,000 draws: 0.827): "rotating a discrete part leaves holes" (CF B).
_FILLED = 0.827
_MAP_CELLS_PER_SPACING = 2
_POINTS_PER_OVERLAP_POINT = 3
_SURFACE_SHARE = 0.5  # of the sample; surface points are a third of all, but both scores need them


def fast_part_scores(
    body: Body,
    table: LookUpTable,
    volume: PackedVolume,
    states: Array,
    *,
    n_points: int = 200,
    parts: Sequence[int] | None = None,
    given: Sequence[int] = (),
    n_threads: int = 1,
) -> PartScores:
    """Scores of states (N, D) like `part_scores`, from at most n_points points per part.

    The sample is fixed, so that equal states have equal scores. Double occupancy is the expected share of a pair's
    points in common voxels, over all placements of the voxel grid, from a third as many points of the smaller part.
    Raises ValueError for n_points below 1.
    Departs from CF Eq. 6.13-6.16: estimates; decision 17 gives their agreement with the exact scores.
    """
    s = check_states(body, states)
    chosen, placed = chosen_parts(body, parts, given)
    sample = fast_sample(table, chosen, placed, n_points)
    scores = np.zeros((len(s), len(chosen), 4))
    crop, box = volume.crop.reshape(-1), volume.box

    def score(first: int, last: int) -> None:
        fast_scores_kernel(s[first:last], body.chain, sample, box, crop, scores[first:last])

    run_chunks(score, len(s), n_threads)
    return shares_to_scores(scores)


def shares_to_scores(scores: Array) -> PartScores:
    """The scores that the numbers (N, P', 4) of a kernel mean."""
    return PartScores(
        out=scores[..., 0],
        double=scores[..., 1],
        occupied=scores[..., 2],
        surface=1.0 - scores[..., 3] / SURFACE_MAX,
    )


def spread_sample(points: Array, n: int) -> Index:
    """At most n of the points (M, 3), evenly spread: every M / n-th along a path through halved boxes.  Ascending."""
    if n >= len(points):
        return np.arange(len(points))
    picks = ((np.arange(n) + 0.5) * len(points) / n).astype(np.int64) if n else np.zeros(0, dtype=np.int64)
    return np.sort(picked_on_path(np.ascontiguousarray(points, dtype=np.float64), picks))


def segment_map(points: Array, spacing_m: float) -> tuple[NDArray[np.uint8], Array, float]:
    """Chance of sharing a voxel with points (M, 3) on a lattice, around them: (map, lower corner (3,) m, cell m).

    map : (nx, ny, nz) uint8, 255 = certain. For a voxel thrown at random around a position, the expected number of
    the lattice's points in it is their trilinear interpolation at that position.
    """
    cell = spacing_m / _MAP_CELLS_PER_SPACING
    first = points.min(axis=0)
    at = np.round((points - first) / spacing_m).astype(np.int64)
    n_lattice = at.max(axis=0) + 1
    member = np.zeros(n_lattice + 4)
    member[tuple((at + 2).T)] = 1.0
    # Cells from one spacing before the first lattice point to one after the last one, and a rim.
    n_cells = (n_lattice + 1) * _MAP_CELLS_PER_SPACING
    value = member
    for axis in range(3):
        centre = (
            1.0 + (np.arange(n_cells[axis]) + 0.5) / _MAP_CELLS_PER_SPACING
        )  # in lattice steps, padded by 2
        low = np.floor(centre).astype(int)
        share = (centre - low).reshape([-1 if k == axis else 1 for k in range(3)])
        value = np.take(value, low, axis=axis) * (1 - share) + np.take(value, low + 1, axis=axis) * share
    map_ = np.pad(np.round(255 * _FILLED * np.minimum(value, 1.0)).astype(np.uint8), 1)
    return map_, first - spacing_m - cell, cell


@lru_cache(maxsize=64)
def fast_sample(
    table: LookUpTable, parts: tuple[int, ...], given: tuple[int, ...], n_points: int
) -> FastSample:
    """Sample and maps for parts that are scored and parts that are only placed."""
    if n_points < 1:
        raise ValueError(f"n_points must be positive, got {n_points}")
    n_overlap_points = max(n_points // _POINTS_PER_OVERLAP_POINT, 1)
    placed = [*parts, *given]
    column_of = {p: i for i, p in enumerate(placed)}
    order = [int(s) for p in placed for s in np.flatnonzero(table.part == p)]
    size = table.part_sizes
    surface_size = np.bincount(table.part, weights=table.n_surface)
    column = np.array([column_of[p] for p in table.part[order].tolist()], dtype=np.int64)

    rows, overlap_rows, n_surface = [], [], []
    share_surface, share_inner, share_of_surface, points_per_sample = [], [], [], []
    for s in order:
        lo, hi = int(table.start[s]), int(table.start[s + 1])
        middle = lo + int(table.n_surface[s])
        points = table.points.astype(np.float64)
        part_size = size[table.part[s]]
        # The part's sample is shared out over its segments, and over surface and inside.
        own = n_points * (hi - lo) / part_size
        n_outer = min(middle - lo, round(own * _SURFACE_SHARE))
        n_outer = max(n_outer, min(middle - lo, 1))
        n_inner = min(hi - middle, max(round(own) - n_outer, 1))
        outer = lo + spread_sample(points[lo:middle], n_outer)
        inner = middle + spread_sample(points[middle:hi], n_inner)
        n_overlap = max(1, min(hi - lo, round(n_overlap_points * (hi - lo) / part_size)))
        rows.append(np.concatenate([outer, inner]))
        overlap_rows.append(lo + spread_sample(points[lo:hi], n_overlap))
        n_surface.append(len(outer))
        share_surface.append((middle - lo) / max(len(outer), 1) / part_size)
        share_inner.append((hi - middle) / max(len(inner), 1) / part_size)
        share_of_surface.append((middle - lo) / max(len(outer), 1) / max(surface_size[table.part[s]], 1))
        points_per_sample.append((hi - lo) / n_overlap)

    def columns(chosen: list[Index]) -> tuple[NDArray[np.float32], ...]:
        return tuple(np.ascontiguousarray(table.points[np.concatenate(chosen) if chosen else []].T))

    def starts(chosen: list[Index]) -> Index:
        return np.concatenate([[0], np.cumsum([len(c) for c in chosen])]).astype(np.int64)

    maps = [_map_of(table, s) for s in order]
    pairs = [
        (a, b) if size[table.part[order[a]]] <= size[table.part[order[b]]] else (b, a)
        for a in range(len(order))
        for b in range(a)
        if column[a] != column[b] and min(column[a], column[b]) < len(parts)
    ]
    x, y, z = columns(rows)
    ox, oy, oz = columns(overlap_rows)
    n_scored = int((column < len(parts)).sum())
    return FastSample(
        segments=Segments(
            x=x,
            y=y,
            z=z,
            start=starts(rows),
            n_surface=np.array(n_surface, dtype=np.int64),
            joint=table.joint[order],
            part=column,
            center=table.center[order],
            radius=table.radius[order] + table.spacing_m,
            n_scored=n_scored,
        ),
        share_surface=np.array(share_surface),
        share_inner=np.array(share_inner),
        share_of_surface=np.array(share_of_surface),
        size=size[list(parts)].astype(np.float64),
        overlap=Overlap(
            x=ox,
            y=oy,
            z=oz,
            start=starts(overlap_rows),
            points_per_sample=np.array(points_per_sample),
            pairs=np.array(pairs, dtype=np.int64).reshape(-1, 2),
            maps=np.concatenate([m[0].ravel() for m in maps] or [np.zeros(0, np.uint8)]),
            map_start=np.concatenate([[0], np.cumsum([m[0].size for m in maps])])[:-1].astype(np.int64),
            map_shape=np.array([m[0].shape for m in maps], dtype=np.int64).reshape(-1, 3),
            map_lower=np.array([m[1] for m in maps]).reshape(-1, 3),
            box_lower=np.array([m[1] for m in maps]).reshape(-1, 3),
            box_upper=np.array([m[1] + m[2] * np.array(m[0].shape) for m in maps]).reshape(-1, 3),
            cell=table.spacing_m / _MAP_CELLS_PER_SPACING,
        ),
    )


@lru_cache(maxsize=256)
def _map_of(table: LookUpTable, segment: int) -> tuple[NDArray[np.uint8], Array, float]:
    points = table.points[table.start[segment] : table.start[segment + 1]].astype(np.float64)
    return segment_map(points, table.spacing_m)
