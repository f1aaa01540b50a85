"""From the configuration to a filter's settings: budgets, scalable bodies, limbs that may be lost."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mocap.body import load_hierarchy, load_limbs
from mocap.data import StateLayout
from mocap.data.hierarchy import levels_on, limbs_on
from mocap.errors import MocapError
from mocap.filters import (
    DdmaSettings,
    FilterSettings,
    LimbSettings,
    ShbmDdmaSettings,
    ShbmSettings,
    settings_for,
    shbm_settings,
)
from mocap.pipeline.config import PoseConfig

Array = NDArray[np.float64]

STRUCTURAL = frozenset({"shbm-apf", "shbm-ddma-pf"})
ADAPTIVE = frozenset({"ddma-pf", "shbm-ddma-pf"})
# Limits for `pose.limb_evidence = "own"`, chosen on one development scene (decision 16).
_OWN_OCCUPANCY = 0.15
_OWN_SPREAD_SHARE = 0.5


def filter_settings(pose: PoseConfig, layout: StateLayout, std: Array) -> FilterSettings:
    """Settings of the configured filter, with n_particles * n_layers evaluations of the whole state per frame.

    std : (D,) noise of one frame, m and rad.
    Raises MocapError when the hierarchy or the limbs cannot be read or do not fit the body.
    """
    settings = settings_for(
        pose.filter,
        layout=layout,
        std=std,
        n_particles=pose.n_particles,
        n_layers=pose.n_layers,
        alpha=pose.survival_rate,
        resampling=pose.resampling,
    )
    if pose.filter in STRUCTURAL:
        shbm = _structural(pose, layout, std)
        return ShbmDdmaSettings(shbm, _limbs(pose, layout)) if pose.filter in ADAPTIVE else shbm
    if isinstance(settings, DdmaSettings):
        return DdmaSettings(settings.apf, _limbs(pose, layout))
    return settings


def _structural(pose: PoseConfig, layout: StateLayout, std: Array) -> ShbmSettings:
    hierarchy = load_hierarchy(pose.hierarchy)
    try:
        levels = levels_on(hierarchy, layout)
    except ValueError as error:
        raise MocapError(
            f"configuration: pose.hierarchy: {error}", remedy="take a hierarchy made for this body"
        ) from error
    if not pose.level_particles:
        return shbm_settings(
            layout,
            std,
            pose.n_particles * pose.n_layers,
            hierarchy=hierarchy,
            n_layers=pose.level_layers,
            alpha=pose.survival_rate,
            alpha_structural=pose.structural_rate,
            crossing=pose.crossing,
            resampling=pose.resampling,
        )
    if len(pose.level_particles) != len(levels.levels):
        raise MocapError(
            f"configuration: pose.level_particles has {len(pose.level_particles)} numbers, the hierarchy "
            f"{hierarchy.name} has {len(levels.levels)} levels",
            remedy="give one number for each level, or none at all",
        )
    return ShbmSettings(
        std=std,
        hierarchy=hierarchy,
        level_particles=pose.level_particles,
        level_layers=(pose.level_layers,),
        alpha=pose.survival_rate,
        alpha_structural=pose.structural_rate,
        crossing=pose.crossing,
        resampling=pose.resampling,
    )


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
