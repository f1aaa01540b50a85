"""Equal budgets: settings with which every filter spends the same number of likelihood evaluations per frame."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from mocap.data.problem import StateLayout
from mocap.filters.apf import ApfSettings
from mocap.filters.ddma import DdmaSettings, ShbmDdmaSettings
from mocap.filters.partitioned import PartitionedSettings
from mocap.filters.psapf import PsapfSettings
from mocap.filters.psipf import PsipfSettings
from mocap.filters.shbm import ShbmSettings, shbm_settings
from mocap.filters.swarm import SwarmSettings

Array = NDArray[np.float64]


class FilterSettings(Protocol):
    """What all settings have in common: the number of particles to start with."""

    @property
    def n_particles(self) -> int: ...


@dataclass(frozen=True, eq=False)
class Budget:
    """What a frame may cost: n_particles * n_layers evaluations of the whole state.

    An evaluation of one part counts as its share, 1 / P.  std : (D,) noise of one frame, m and rad.
    """

    layout: StateLayout
    std: Array
    n_particles: int
    n_layers: int
    alpha: float
    resampling: str

    @property
    def n_evaluations(self) -> int:
        return self.n_particles * self.n_layers


def _annealed(budget: Budget) -> ApfSettings:
    """n_layers layers of n_particles; the plain filter multiplies the two itself."""
    return ApfSettings(
        n_layers=budget.n_layers,
        n_particles=budget.n_particles,
        std=budget.std,
        alpha=budget.alpha,
        resampling=budget.resampling,
    )


def _structural(budget: Budget) -> ShbmSettings:
    """Two layers for each model, by depth in the tree of parts; a coarse model's particle costs its parts' share."""
    return shbm_settings(
        budget.layout,
        budget.std,
        budget.n_evaluations,
        alpha=budget.alpha,
        resampling=budget.resampling,
    )


def _adaptive(budget: Budget) -> DdmaSettings:
    """The annealed filter's budget; scouts for lost limbs come on top."""
    return DdmaSettings(_annealed(budget))


def _structural_adaptive(budget: Budget) -> ShbmDdmaSettings:
    return ShbmDdmaSettings(_structural(budget))


def _partitioned(budget: Budget) -> PartitionedSettings:
    """Every particle is scored once per part, which makes one evaluation: n_particles * n_layers particles."""
    return PartitionedSettings(n_particles=budget.n_evaluations, std=budget.std, resampling=budget.resampling)


def _annealed_partitioned(budget: Budget) -> PsapfSettings:
    """Every particle is scored n_layers times per part.  Source: XN 4.4.4, where n_layers is L + 1."""
    return PsapfSettings(
        n_layers=budget.n_layers,
        n_particles=budget.n_particles,
        std=budget.std,
        alpha=budget.alpha,
        resampling=budget.resampling,
    )


def _intervals(budget: Budget) -> PsipfSettings:
    """n_particles * n_layers placements of every part; as many particles are kept as can try 27 each: a joint with
    three angles gets three values in each of them."""
    n = budget.n_evaluations
    return PsipfSettings(n_particles=n, std=budget.std, n_kept=max(n // 27, 1))


def _swarm(budget: Budget) -> SwarmSettings:
    """One draw and n_layers - 1 moves of n_particles, but at least one move: a swarm of one layer is two of half."""
    n_iterations = max(budget.n_layers - 1, 1)
    return SwarmSettings(
        n_particles=max(budget.n_evaluations // (n_iterations + 1), 2),
        n_iterations=n_iterations,
        std=budget.std,
        alpha=budget.alpha,
        resampling=budget.resampling,
    )


# How each filter of FILTERS spends a budget.
SETTINGS: dict[str, Callable[[Budget], FilterSettings]] = {
    "sir": _annealed,
    "apf": _annealed,
    "shbm-apf": _structural,
    "ddma-pf": _adaptive,
    "shbm-ddma-pf": _structural_adaptive,
    "ps": _partitioned,
    "parallel-ps": _partitioned,
    "sbps": _partitioned,
    "sbapf": _annealed_partitioned,
    "pfcr": _partitioned,
    "psapf": _annealed_partitioned,
    "psipf": _intervals,
    "pso": _swarm,
    "hpso": _swarm,
    "apsopf": _swarm,
    "chapsopf": _swarm,
    "hapsopf": _swarm,
}


def settings_for(
    name: str,
    *,
    layout: StateLayout,
    std: Array,
    n_particles: int,
    n_layers: int,
    alpha: float = 0.5,
    resampling: str = "systematic",
) -> FilterSettings:
    """Settings of a filter that spends about n_particles * n_layers evaluations of the whole state per frame.

    std : (D,) noise of one frame, m and rad. Raises ValueError for an unknown name or impossible numbers.
    Source: XN 4.4.4 (equal numbers of likelihood evaluations, reading guide 23).
    """
    if name not in SETTINGS:
        raise ValueError(f"filter {name!r} is none of {', '.join(SETTINGS)}")
    if n_particles < 2 or n_layers < 1:
        raise ValueError(f"n_layers >= 1 and n_particles >= 2, got {n_layers} and {n_particles}")
    if std.shape != (layout.n_columns,):
        raise ValueError(f"std has shape {std.shape}, expected ({layout.n_columns},)")
    return SETTINGS[name](Budget(layout, std, n_particles, n_layers, alpha, resampling))
