"""Partitioned sampling (PS): a small particle filter for every part, in order; and for sets of parts at once."""

from __future__ import annotations

import numpy as np

from mocap.data.problem import ArticulatedProblem
from mocap.filters.partitioned import PartitionedSettings, partitioned_settings, partitioned_step
from mocap.filters.parts import part_sets
from mocap.filters.record import Filter
from mocap.filters.state import FilterInfo, ParticleState


def ps_step(
    problem: ArticulatedProblem,
    state: ParticleState,
    settings: PartitionedSettings,
    *,
    rng: np.random.Generator,
) -> tuple[ParticleState, FilterInfo]:
    """One frame of partitioned sampling: part after part, in the order of the layout.

    Source: XN Alg. 3.1 with P_j = {j}.
    """
    return partitioned_step(problem, state, settings, [[p] for p in range(problem.layout.n_parts)], rng=rng)


def parallel_ps_step(
    problem: ArticulatedProblem,
    state: ParticleState,
    settings: PartitionedSettings,
    *,
    rng: np.random.Generator,
) -> tuple[ParticleState, FilterInfo]:
    """One frame of partitioned sampling that resamples once for all parts of a set P_j.

    Source: XN 4.1 (Proposition 4-1).
    """
    return partitioned_step(problem, state, settings, part_sets(problem.layout), rng=rng)


PS = Filter("ps", "PS", ps_step, partitioned_settings, is_part_by_part=True)
PARALLEL_PS = Filter(
    "parallel-ps", "parallel PS", parallel_ps_step, partitioned_settings, is_part_by_part=True
)
