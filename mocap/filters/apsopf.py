"""Annealed particle swarm filter (APSOPF) of the whole state."""

from __future__ import annotations

import numpy as np

from mocap.data.problem import ArticulatedProblem
from mocap.filters._swarm import Swarm, SwarmSettings, swarm_settings, whole_step
from mocap.filters.record import Filter
from mocap.filters.state import FilterInfo, ParticleState


def exponential_attraction(settings: SwarmSettings, m: int) -> float:
    """Attraction of APSOPF in iteration m = 1..M.  Source: XN Eq. 3.9."""
    return settings.beta_0 * float(np.exp(1.0 - m / settings.n_iterations))


_SWARM = Swarm(exponential_attraction, has_velocity=False, is_estimate_best=False, is_carried_on=True)


def apsopf_step(
    problem: ArticulatedProblem,
    state: ParticleState,
    settings: SwarmSettings,
    *,
    rng: np.random.Generator,
) -> tuple[ParticleState, FilterInfo]:
    """One frame of the annealed particle swarm on the whole state.

    Source: XN 3.2.2, Eq. 3.9.
    """
    return whole_step(problem, state, settings, _SWARM, rng=rng)


APSOPF = Filter("apsopf", "APSOPF", apsopf_step, swarm_settings)
