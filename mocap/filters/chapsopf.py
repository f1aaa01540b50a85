"""Canonical hierarchical swarm filter (CHAPSOPF): HAPSOPF with an inertial velocity instead of sampling noise."""

from __future__ import annotations

import numpy as np

from mocap.data.problem import ArticulatedProblem
from mocap.filters._swarm import Swarm, SwarmSettings, annealed_attraction, part_step, swarm_settings
from mocap.filters.record import Filter
from mocap.filters.state import FilterInfo, ParticleState

_SWARM = Swarm(annealed_attraction, has_velocity=True, is_estimate_best=False, is_carried_on=True)


def chapsopf_step(
    problem: ArticulatedProblem,
    state: ParticleState,
    settings: SwarmSettings,
    *,
    rng: np.random.Generator,
) -> tuple[ParticleState, FilterInfo]:
    """One frame of HAPSOPF with an inertial velocity in the place of the sampling noise.

    Source: XN 6.2.
    """
    return part_step(problem, state, settings, _SWARM, rng=rng)


CHAPSOPF = Filter("chapsopf", "CHAPSOPF", chapsopf_step, swarm_settings, is_part_by_part=True)
