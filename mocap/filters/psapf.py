"""Annealing inside partitioned sampling: PSAPF (what XN calls APF) and, with swapping, SBAPF."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mocap.data.problem import ArticulatedProblem, StateLayout
from mocap.filters.annealing import BETA_MAX
from mocap.filters.budget import FilterBudget
from mocap.filters.partitioned import PartitionedSettings, partitioned_step
from mocap.filters.parts import part_sets
from mocap.filters.record import Filter
from mocap.filters.sbps import swap_parts
from mocap.filters.state import FilterInfo, ParticleState

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class PsapfSettings(PartitionedSettings):
    """Settings of partitioned sampling with annealing inside every set of parts.

    n_layers : times that a part is propagated and scored, each with n_particles. The last is not annealed; XN leaves it
    out of the count.
    """

    n_layers: int = 2
    survival_rate: float = 0.5
    """Target ESS / N of every annealed layer, and the factor on the noise covariance from layer to layer."""
    beta_max: float = BETA_MAX
    """Largest exponent of an annealed layer. Where a part's likelihood is flat the survival rate asks for more than 1:
    the layer then sharpens what XN 3.2.1 has it smooth (beta_0 > beta_1 > ...; the last layer's is 1). Both cannot be
    had; decision 18."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.n_layers < 1:
            raise ValueError(f"n_layers must be at least 1, got {self.n_layers}")
        if not 0 < self.survival_rate < 1:
            raise ValueError(f"survival_rate must lie in (0, 1), got {self.survival_rate}")
        if not self.beta_max > 0:
            raise ValueError(f"beta_max must be positive, got {self.beta_max}")


def psapf_step(
    problem: ArticulatedProblem,
    state: ParticleState,
    settings: PsapfSettings,
    *,
    rng: np.random.Generator,
) -> tuple[ParticleState, FilterInfo]:
    """One frame of an annealed particle filter for every part, in the order of the layout.

    Source: XN 3.2.4 and 4.4.2, XN Alg. 3.3 inside XN Alg. 3.1.
    """
    return partitioned_step(
        problem,
        state,
        settings,
        [[part] for part in range(problem.layout.n_parts)],
        rng=rng,
        n_layers=settings.n_layers,
        survival_rate=settings.survival_rate,
        beta_max=settings.beta_max,
    )


def sbapf_step(
    problem: ArticulatedProblem,
    state: ParticleState,
    settings: PsapfSettings,
    *,
    rng: np.random.Generator,
) -> tuple[ParticleState, FilterInfo]:
    """One frame of an annealed particle filter for every set P_j, with one swap after its layers.

    Source: XN 4.4.2.
    """
    return partitioned_step(
        problem,
        state,
        settings,
        part_sets(problem.layout),
        rng=rng,
        recombination=swap_parts,
        n_layers=settings.n_layers,
        survival_rate=settings.survival_rate,
        beta_max=settings.beta_max,
    )


def annealed_partitioned_settings(budget: FilterBudget, layout: StateLayout, std: Array) -> PsapfSettings:
    """Every particle is scored n_layers times per part.  Source: XN 4.4.4, where n_layers is L + 1."""
    return PsapfSettings(
        n_layers=budget.n_layers,
        n_particles=budget.n_particles,
        std=std,
        survival_rate=budget.survival_rate,
        resampling=budget.resampling,
    )


PSAPF = Filter("psapf", "APF", psapf_step, annealed_partitioned_settings, is_part_by_part=True)
SBAPF = Filter("sbapf", "SBAPF", sbapf_step, annealed_partitioned_settings, is_part_by_part=True)
