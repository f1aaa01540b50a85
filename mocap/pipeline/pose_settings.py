"""From the configuration to the method's settings: files are read here, and what does not fit is said by its key."""

from __future__ import annotations

from mocap.body import load_hierarchy, load_limbs
from mocap.data import StateLayout
from mocap.data.hierarchy import Hierarchy, levels_on, limbs_on
from mocap.errors import MocapError
from mocap.filters import FILTERS, FilterBudget
from mocap.filters.limb_settings import LimbSettings
from mocap.pipeline.config import PoseConfig

# Limits for `pose.limb_evidence = "own"`, chosen on one development scene (decision 16).
_OWN_OCCUPANCY = 0.15
_OWN_SPREAD_SHARE = 0.5


def filter_budget(pose: PoseConfig, layout: StateLayout) -> FilterBudget:
    """What the configured filter may spend on a frame, with the scalable body and the limbs that it uses.

    Raises MocapError when the hierarchy or the limbs cannot be read or do not fit the body. The filter's name is known
    to exist: `check_filter`.
    """
    kind = FILTERS[pose.filter]
    return FilterBudget(
        pose.filter,
        n_particles=pose.n_particles,
        n_layers=pose.n_layers,
        survival_rate=pose.survival_rate,
        resampling=pose.resampling,
        hierarchy=_hierarchy(pose, layout) if kind.uses_hierarchy else None,
        level_particles=pose.level_particles if kind.uses_hierarchy else (),
        level_layers=pose.level_layers,
        structural_rate=pose.structural_rate,
        crossing=pose.crossing,
        limbs=_limbs(pose, layout) if kind.uses_limbs else LimbSettings(),
    )


def check_filter(pose: PoseConfig, section: str, *, factorised: bool) -> None:
    """MocapError for an unknown filter, and for one that needs a likelihood of every part where `section` asks for a
    global one."""
    if pose.filter not in FILTERS:
        raise MocapError(
            f"configuration: pose.filter: there is no filter named {pose.filter!r}",
            remedy=f"use one of {', '.join(FILTERS)}",
        )
    if FILTERS[pose.filter].is_part_by_part and not factorised:
        raise MocapError(
            f"configuration: the filter {pose.filter} places the body part by part and needs a likelihood of "
            "every part",
            remedy=f"set {section}.factorised to true, or take another filter",
        )


def _hierarchy(pose: PoseConfig, layout: StateLayout) -> Hierarchy:
    hierarchy = load_hierarchy(pose.hierarchy)
    try:
        levels = levels_on(hierarchy, layout)
    except ValueError as error:
        raise MocapError(
            f"configuration: pose.hierarchy: {error}", remedy="take a hierarchy made for this body"
        ) from error
    if pose.level_particles and len(pose.level_particles) != len(levels.levels):
        raise MocapError(
            f"configuration: pose.level_particles has {len(pose.level_particles)} numbers, the hierarchy "
            f"{hierarchy.name} has {len(levels.levels)} levels",
            remedy="give one number for each level, or none at all",
        )
    return hierarchy


def _limbs(pose: PoseConfig, layout: StateLayout) -> LimbSettings:
    limbs = load_limbs(pose.limbs)
    try:
        limbs_on(limbs, layout)
    except ValueError as error:
        raise MocapError(
            f"configuration: pose.limbs: {error}", remedy="take limbs made for this body"
        ) from error
    if pose.limb_evidence == "own":
        return LimbSettings(
            limbs, own_data=True, lost_occupancy=_OWN_OCCUPANCY, lost_spread_share=_OWN_SPREAD_SHARE
        )
    return LimbSettings(limbs)
