"""Hierarchical annealed particle swarm filter (HAPSOPF): a swarm for every part."""

from __future__ import annotations

import numpy as np

from mocap.data.problem import ArticulatedProblem
from mocap.filters._swarm import Swarm, SwarmSettings, annealed_attraction, part_step, swarm_settings
from mocap.filters.record import Filter
from mocap.filters.state import FilterInfo, ParticleState

_SWARM = Swarm(annealed_attraction, has_velocity=False, is_estimate_best=False, is_carried_on=True)


def hapsopf_step(
    problem: ArticulatedProblem,
    state: ParticleState,
    settings: SwarmSettings,
    *,
    rng: np.random.Generator,
) -> tuple[ParticleState, FilterInfo]:
    """One frame of the hierarchical annealed particle swarm: a swarm per part that trusts its leader less and less.

    Source: XN Alg. 6.1.
    """
    return part_step(problem, state, settings, _SWARM, rng=rng)


HAPSOPF = Filter("hapsopf", "HAPSOPF", hapsopf_step, swarm_settings, is_part_by_part=True)
