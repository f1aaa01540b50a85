"""Particle filter with combinatorial resampling (PFCR): SBPS that draws from all exchanges instead of one."""

from __future__ import annotations

import numpy as np

from mocap.data.problem import ArticulatedProblem, StateLayout
from mocap.filters.combinatorial import combinatorial
from mocap.filters.partitioned import (
    Partial,
    PartitionedSettings,
    partitioned_settings,
    partitioned_step,
)
from mocap.filters.parts import part_sets
from mocap.filters.record import Filter
from mocap.filters.state import FilterInfo, ParticleState
from mocap.filters.swapping import parents_placement
from mocap.filters.weights import normalise_log_weights


def combine_parts(
    layout: StateLayout, partial: Partial, parts: list[int], *, scheme: str, rng: np.random.Generator
) -> Partial:
    """As many particles, of equal weight, drawn from all exchanges of the set's parts.

    Source: XN Alg. 5.1; departs from it: the new weights are equal, because the draw has used them up.
    """
    n = len(partial.weights)
    groups = np.stack([parents_placement(layout, partial.placed, part) for part in parts], axis=1)
    centers, sources = combinatorial(partial.scores[:, parts], groups, n, rng=rng, scheme=scheme)
    return partial.take(centers).with_parts_of(partial, layout, parts, sources)


def combine_parts_weighted(
    layout: StateLayout, partial: Partial, parts: list[int], *, scheme: str, rng: np.random.Generator
) -> Partial:
    """The same, and the drawn particles keep the product of their parts' weights.

    Source: XN Alg. 5.1, lines 4 and 7.
    """
    drawn = combine_parts(layout, partial, parts, scheme=scheme, rng=rng)
    weights, _ = normalise_log_weights(drawn.scores[:, parts].sum(axis=1))
    return drawn.with_weights(weights)


def pfcr_step(
    problem: ArticulatedProblem,
    state: ParticleState,
    settings: PartitionedSettings,
    *,
    rng: np.random.Generator,
) -> tuple[ParticleState, FilterInfo]:
    """One frame of the particle filter with combinatorial resampling.

    A set's weights are used twice: to draw, and as the weights of what was drawn, by which the next set draws again.
    Source: XN 5.2.2: SBPS with its exchange and resampling replaced by XN Alg. 5.1.
    """
    return partitioned_step(
        problem,
        state,
        settings,
        part_sets(problem.layout),
        rng=rng,
        recombination=combine_parts_weighted,
        counts_as="resampling",
    )


def pfcr_equal_step(
    problem: ArticulatedProblem,
    state: ParticleState,
    settings: PartitionedSettings,
    *,
    rng: np.random.Generator,
) -> tuple[ParticleState, FilterInfo]:
    """The same with equal weights after each draw, which counts evidence once and converges to the posterior.

    Source: XN 5.2.2; departs from XN Alg. 5.1 in the new weights (decision 18).
    """
    return partitioned_step(
        problem,
        state,
        settings,
        part_sets(problem.layout),
        rng=rng,
        recombination=combine_parts,
        counts_as="resampling",
    )


PFCR = Filter("pfcr", "PFCR", pfcr_step, partitioned_settings, is_part_by_part=True)
PFCR_EQUAL = Filter(
    "pfcr-equal", "PFCR, equal weights", pfcr_equal_step, partitioned_settings, is_part_by_part=True
)
