"""Canonical hierarchical swarm filter (CHAPSOPF): HAPSOPF with an inertial velocity instead of sampling noise."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mocap.data.problem import ArticulatedProblem
from mocap.filters._swarm import Swarm, SwarmSettings, annealed_attraction, part_step, swarm_settings
from mocap.filters.record import Filter
from mocap.filters.state import FilterInfo, ParticleState

_PRINTED = Swarm(annealed_attraction, has_velocity=True, is_estimate_best=False, is_carried_on=True)
_DRAWN = replace(_PRINTED, is_carried_on=False, is_drawn=True)


def chapsopf_step(
    problem: ArticulatedProblem,
    state: ParticleState,
    settings: SwarmSettings,
    *,
    rng: np.random.Generator,
) -> tuple[ParticleState, FilterInfo]:
    """One frame of HAPSOPF with an inertial velocity in the place of the sampling noise.

    Source: XN 6.2; the draw before every part as in HAPSOPF (decision 31).
    """
    return part_step(problem, state, settings, _DRAWN, rng=rng)


def chapsopf_printed_step(
    problem: ArticulatedProblem,
    state: ParticleState,
    settings: SwarmSettings,
    *,
    rng: np.random.Generator,
) -> tuple[ParticleState, FilterInfo]:
    """The same without a draw, as XN Alg. 6.1 prints it for HAPSOPF.

    Source: XN 6.2.
    """
    return part_step(problem, state, settings, _PRINTED, rng=rng)


CHAPSOPF = Filter("chapsopf", "CHAPSOPF", chapsopf_step, swarm_settings, is_part_by_part=True)
CHAPSOPF_PRINTED = Filter(
    "chapsopf-printed", "CHAPSOPF as printed", chapsopf_printed_step, swarm_settings, is_part_by_part=True
)
