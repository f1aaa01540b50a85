"""Swapping: parts exchanged between particles that agree on everything these parts depend on."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mocap.data.problem import StateLayout
from mocap.filters._kernels import swap_sources_kernel

Array = NDArray[np.float64]
Indices = NDArray[np.int64]


def placements(
    layout: StateLayout, placed: Indices, particles: Array, parts: list[int], is_moved: NDArray[np.bool_]
) -> Indices:
    """Placement numbers after some parts were propagated: two particles share a part's number only if they share
    its placement.

    placed : (N, P) numbers so far, parents' up to date.  is_moved : (D,) columns that got noise. A part that moved
    has a new place in every particle; one that did not (or has no columns) agrees where its parent's
    placement and its own columns agree. Returns a new (N, P).
    """
    placed = placed.copy()
    for part in parts:
        columns = layout.columns_of(part)
        if is_moved[columns].any():
            placed[:, part] = np.arange(len(particles))
        else:
            key = np.column_stack([parents_placement(layout, placed, part), particles[:, columns]])
            placed[:, part] = np.unique(key, axis=0, return_inverse=True)[1].reshape(-1)
    return placed


def parents_placement(layout: StateLayout, placed: Indices, part: int) -> Indices:
    """Groups of particles among which a part may be exchanged, (N,): those with the same parent's placement.

    Roots depend on nothing, all particles are one group. Particles whose parent is in the same place are copies
    made by resampling, so they agree on the past too: almost admissible permutations.
    Source: XN Definition 4-4.
    """
    parent = int(layout.parent_of_part[part])
    return np.zeros(len(placed), dtype=np.int64) if parent < 0 else placed[:, parent]


def swap_sources(log_weights: Array, groups: Indices) -> Indices:
    """From which particle each one takes a part, (N,): inside every group the first takes the best, and so on.

    log_weights : (N,) of the part.  groups : (N,). A permutation that never leaves a group. When all parts of a
    set are sorted like this, best meets best, which makes the sum of any increasing convex function of the
    particles' weights as large as swapping can make it.
    Source: XN 4.3, Eq. 4.5.
    """
    sources = np.empty(len(groups), dtype=np.int64)
    swap_sources_kernel(np.ascontiguousarray(log_weights), compact_groups(groups), sources)
    return sources


def compact_groups(groups: Indices) -> Indices:
    """The same groups (N,) with numbers in 0..N-1."""
    if len(groups) and (groups.min() < 0 or groups.max() >= len(groups)):
        return np.unique(groups, return_inverse=True)[1].reshape(-1)
    return np.ascontiguousarray(groups)
