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


def combine_parts(
    layout: StateLayout, partial: Partial, parts: list[int], *, scheme: str, rng: np.random.Generator
) -> Partial:
    """As many particles, of equal weight, drawn from all exchanges of the set's parts.

    Source: XN Alg. 5.1.
    """
    n = len(partial.weights)
    groups = np.stack([parents_placement(layout, partial.placed, part) for part in parts], axis=1)
    centers, sources = combinatorial(partial.scores[:, parts], groups, n, rng=rng, scheme=scheme)
    return partial.take(centers).with_parts_of(partial, layout, parts, sources)


def pfcr_step(
    problem: ArticulatedProblem,
    state: ParticleState,
    settings: PartitionedSettings,
    *,
    rng: np.random.Generator,
) -> tuple[ParticleState, FilterInfo]:
    """One frame of the particle filter with combinatorial resampling.

    Source: XN 5.2.2: SBPS with its exchange and resampling replaced by XN Alg. 5.1.
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
