"""Pose filters as functions on an articulated problem; they know no body and no image."""

from collections.abc import Callable

from mocap.filters.apf import (
    ApfSettings,
    FilterInfo,
    ParticleState,
    apf_step,
    initial_particles,
    sir_step,
)
from mocap.filters.refine import RefineInfo, RefineSettings, refine
from mocap.filters.scout import ScoutInfo, ScoutSettings, scout_limbs

FilterStep = Callable[..., tuple[ParticleState, FilterInfo]]

# Every pose filter by the name that the command line takes.
FILTERS: dict[str, FilterStep] = {"sir": sir_step, "apf": apf_step}

__all__ = [
    "FILTERS",
    "ApfSettings",
    "FilterInfo",
    "FilterStep",
    "ParticleState",
    "RefineInfo",
    "RefineSettings",
    "ScoutInfo",
    "ScoutSettings",
    "apf_step",
    "initial_particles",
    "refine",
    "scout_limbs",
    "sir_step",
]
