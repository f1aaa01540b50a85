"""Hierarchical annealed particle swarm filter (HAPSOPF): a swarm for every part."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mocap.data.problem import ArticulatedProblem
from mocap.filters._swarm import Swarm, SwarmSettings, annealed_attraction, part_step, swarm_settings
from mocap.filters.record import Filter
from mocap.filters.state import FilterInfo, ParticleState

_PRINTED = Swarm(annealed_attraction, has_velocity=False, is_estimate_best=False, is_carried_on=True)
_DRAWN = replace(_PRINTED, is_carried_on=False, is_drawn=True)


def hapsopf_step(
    problem: ArticulatedProblem,
    state: ParticleState,
    settings: SwarmSettings,
    *,
    rng: np.random.Generator,
) -> tuple[ParticleState, FilterInfo]:
    """One frame of the hierarchical annealed particle swarm: a swarm per part that trusts its leader less and less.

    Before every part the particles are drawn by the weights of the part before it, as in partitioned sampling.
    Source: XN Alg. 6.1; departs from it: the draw of XN 6.1.2, which the algorithm does not print (decision 31).
    """
    return part_step(problem, state, settings, _DRAWN, rng=rng)


def hapsopf_printed_step(
    problem: ArticulatedProblem,
    state: ParticleState,
    settings: SwarmSettings,
    *,
    rng: np.random.Generator,
) -> tuple[ParticleState, FilterInfo]:
    """The same without a draw: every particle goes on from its own placements, and is weighed in the end.

    Source: XN Alg. 6.1 to the letter.
    """
    return part_step(problem, state, settings, _PRINTED, rng=rng)


HAPSOPF = Filter("hapsopf", "HAPSOPF", hapsopf_step, swarm_settings, is_part_by_part=True)
HAPSOPF_PRINTED = Filter(
    "hapsopf-printed", "HAPSOPF as printed", hapsopf_printed_step, swarm_settings, is_part_by_part=True
)
