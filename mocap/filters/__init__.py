"""Pose filters as functions on an articulated problem; they know no body and no image."""

from mocap.filters.budget import FilterBudget, FilterSettings
from mocap.filters.record import Filter, Step
from mocap.filters.registry import FILTERS, filter_settings
from mocap.filters.state import FilterInfo, ParticleState, initial_particles

__all__ = [
    "FILTERS",
    "Filter",
    "FilterBudget",
    "FilterInfo",
    "FilterSettings",
    "ParticleState",
    "Step",
    "filter_settings",
    "initial_particles",
]
