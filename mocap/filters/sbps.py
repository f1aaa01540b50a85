"""Swapping-based partitioned sampling (SBPS): parts of one set change places so that good ones meet."""

from __future__ import annotations

import numpy as np

from mocap.data.problem import ArticulatedProblem, StateLayout
from mocap.filters.partitioned import (
    Partial,
    PartitionedSettings,
    partitioned_settings,
    partitioned_step,
)
from mocap.filters.parts import part_sets
from mocap.filters.record import Filter
from mocap.filters.state import FilterInfo, ParticleState
from mocap.filters.swapping import parents_placement, swap_sources
from mocap.filters.weights import normalise_log_weights


def swap_parts(
    layout: StateLayout, partial: Partial, parts: list[int], *, scheme: str, rng: np.random.Generator
) -> Partial:
    """Particles with the parts of a set sorted by weight wherever they may be exchanged, and weights to match.

    Source: XN 4.3, Eq. 4.5.
    """
    sources = [
        swap_sources(partial.scores[:, part], parents_placement(layout, partial.placed, part))
        for part in parts
    ]
    swapped = partial.with_parts_of(partial, layout, parts, np.stack(sources, axis=1))
    weights, _ = normalise_log_weights(swapped.scores[:, parts].sum(axis=1))
    return swapped.with_weights(weights)


def sbps_step(
    problem: ArticulatedProblem,
    state: ParticleState,
    settings: PartitionedSettings,
    *,
    rng: np.random.Generator,
) -> tuple[ParticleState, FilterInfo]:
    """One frame of swapping-based partitioned sampling.

    Source: XN 4.2-4.3; SW 5.2-5.3.
    """
    return partitioned_step(
        problem, state, settings, part_sets(problem.layout), rng=rng, recombination=swap_parts
    )


SBPS = Filter("sbps", "SBPS", sbps_step, partitioned_settings, is_part_by_part=True)
