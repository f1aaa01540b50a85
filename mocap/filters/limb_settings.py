"""Limbs that may be lost: when a limb counts as lost and as found again, and how it is looked for."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mocap.data.hierarchy import Limb


@dataclass(frozen=True)
class LimbSettings:
    """When a limb is lost and found again, and how its scout searches.

    limbs : the unitive model; None = every branch of the tree of parts, as a whole.
    """

    limbs: tuple[Limb, ...] | None = None
    lost_std_rad: float = np.deg2rad(15.0)
    """All angles of a lost limb spread more than this over the particles (reading guide 15)."""
    lost_occupancy: float = 0.05
    """The flesh of a lost limb's mean pose lies in occupied voxels to a smaller share than this."""
    found_std_rad: float = np.deg2rad(5.0)
    found_occupancy: float = 0.7
    own_data: bool = False
    """Count only flesh in occupied voxels that no other tracked part holds: a limb that has sunk into the trunk has
    data, but none of its own. False as published."""
    lost_spread_share: float | None = None
    """A lost limb's angles spread more than this share of what the filter's noise alone would give, instead of more
    than lost_std_rad, which is beyond the reach of small noise. None as published."""
    scout_particles: int = 120
    scout_layers: int = 12
    """Enough to close in from a limb's whole range in four angles: 0.3^(12 / 4) of it is 5 degrees."""
    scout_std_rad: float = np.deg2rad(60.0)
    """Noise of the scout's first layer; the particles before it lie anywhere in the limb's range."""
    scout_survival_rate: float = 0.3
    """Target ESS / N of the scout's layers, and the factor on its noise covariance."""


def own_data_limits(limbs: tuple[Limb, ...]) -> LimbSettings:
    """Limits for limbs of which only data of their own counts: chosen on one development scene (decision 16)."""
    return LimbSettings(limbs, own_data=True, lost_occupancy=0.15, lost_spread_share=0.5)
