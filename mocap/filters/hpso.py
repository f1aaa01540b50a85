"""Hierarchical particle swarm optimisation (HPSO): a swarm for every part, settled before the next is searched."""

from __future__ import annotations

import numpy as np

from mocap.data.problem import ArticulatedProblem
from mocap.filters._swarm import Swarm, SwarmSettings, constant_attraction, part_step, swarm_settings
from mocap.filters.record import Filter
from mocap.filters.state import FilterInfo, ParticleState

_SWARM = Swarm(
    constant_attraction, has_velocity=True, is_estimate_best=True, is_carried_on=False, is_settled=True
)


def hpso_step(
    problem: ArticulatedProblem,
    state: ParticleState,
    settings: SwarmSettings,
    *,
    rng: np.random.Generator,
) -> tuple[ParticleState, FilterInfo]:
    """One frame of hierarchical particle swarm optimisation: every part is settled before the next is searched.

    All particles end at one pose: an optimiser has no spread.
    Source: XN 3.2.5; departs from it: the next part's last state is no extra constraint.
    """
    return part_step(problem, state, settings, _SWARM, rng=rng)


HPSO = Filter("hpso", "HPSO", hpso_step, swarm_settings, is_part_by_part=True)
