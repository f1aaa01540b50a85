"""Parts of the state: which of them can be processed together, and what moves with each."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mocap.data.problem import ArticulatedProblem, StateLayout

Array = NDArray[np.float64]
Indices = NDArray[np.int64]
Mask = NDArray[np.bool_]


def part_sets(layout: StateLayout) -> list[list[int]]:
    """The sets P_1, P_2, ... of parts that are processed in parallel.

    P_1 holds the roots (several objects have several), P_j the parts whose parents all lie in the sets before. Given
    their parents and their own past, the parts of a set are independent of each other and of all that is placed
    before them, so that the order inside a set does not matter.
    Source: XN 4.1, Eq. 4.1.
    """
    depth = np.zeros(layout.n_parts, dtype=np.int64)
    for part, parent in enumerate(layout.parent_of_part):
        if parent >= 0:
            depth[part] = depth[parent] + 1
    return [np.flatnonzero(depth == level).tolist() for level in range(int(depth.max(initial=-1)) + 1)]


def owners(layout: StateLayout, parts: list[int]) -> Indices:
    """Which of some parts each part of the layout hangs on or is, (P,): an index into `parts`, or -1 for none.

    All that belongs to one of them is the swapping set of a tree.  Source: XN Definition 4-2.
    """
    owner = np.full(layout.n_parts, -1, dtype=np.int64)
    owner[parts] = np.arange(len(parts))
    for part, parent in enumerate(layout.parent_of_part):
        if owner[part] < 0 <= parent:
            owner[part] = owner[parent]
    return owner


def columns_in(layout: StateLayout, parts: list[int]) -> Mask:
    """Which columns belong to some parts, (D,)."""
    is_wanted = np.zeros(layout.n_parts, dtype=np.bool_)
    is_wanted[parts] = True
    wanted: Mask = is_wanted[layout.part_of_column]
    return wanted


def require_parts(problem: ArticulatedProblem, particles: Array) -> None:
    """ValueError unless the likelihood tells the parts apart.

    One particle is scored to find out, because a global likelihood looks like any other when asked for one part.
    """
    n_parts = problem.layout.n_parts
    n_scores = problem.log_likelihood(particles[:1]).shape[1]
    if n_scores != n_parts:
        raise ValueError(
            "a filter that works part by part needs one log-likelihood for each part: expected "
            f"{n_parts} columns, got {n_scores}; with a global likelihood use sir, apf, pso or apsopf"
        )


def part_scores(
    problem: ArticulatedProblem, particles: Array, parts: list[int], given: list[int]
) -> tuple[Array, bool]:
    """Log-likelihoods of some parts (N, len(parts)), without NaN, and whether one of them says nothing.

    A part without data (no finite value for any particle) gets 0 for every particle: it then neither prefers
    nor excludes anything. NaN counts as zero likelihood (-inf).
    Source: XN Eq. 3.2.
    """
    scores = np.array(problem.log_likelihood(particles, parts=parts, given=given), dtype=np.float64)
    if scores.shape != (len(particles), len(parts)):
        raise ValueError(
            f"log_likelihood returned shape {scores.shape}, expected {(len(particles), len(parts))}"
        )
    scores[np.isnan(scores)] = -np.inf
    is_dead = np.isneginf(scores).all(axis=0)
    scores[:, is_dead] = 0.0
    return scores, bool(is_dead.any())
