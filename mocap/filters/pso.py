"""Particle swarm optimisation (PSO) of the whole state, one swarm a frame."""

from __future__ import annotations

import numpy as np

from mocap.data.problem import ArticulatedProblem
from mocap.filters._swarm import Swarm, SwarmSettings, constant_attraction, swarm_settings, whole_step
from mocap.filters.record import Filter
from mocap.filters.state import FilterInfo, ParticleState

_SWARM = Swarm(constant_attraction, has_velocity=True, is_estimate_best=True, is_carried_on=False)


def pso_step(
    problem: ArticulatedProblem,
    state: ParticleState,
    settings: SwarmSettings,
    *,
    rng: np.random.Generator,
) -> tuple[ParticleState, FilterInfo]:
    """One frame of particle swarm optimisation on the whole state; the estimate is the best particle.

    Source: XN 3.2.2, Alg. 3.4.
    """
    return whole_step(problem, state, settings, _SWARM, rng=rng)


PSO = Filter("pso", "PSO", pso_step, swarm_settings)
