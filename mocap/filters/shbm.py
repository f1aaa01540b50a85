"""SHBM-APF: structural annealing over a scalable model, from a coarse one to the full one."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mocap.data.hierarchy import Hierarchy, LevelsOf, depth_hierarchy, levels_on
from mocap.data.problem import ArticulatedProblem, StateLayout
from mocap.filters.annealing import layer_scales
from mocap.filters.budget import FilterBudget
from mocap.filters.crossing import CROSSING
from mocap.filters.estimate import weighted_mean
from mocap.filters.layers import Layers, anneal
from mocap.filters.record import Filter
from mocap.filters.resampling import RESAMPLING
from mocap.filters.state import FilterInfo, ParticleState
from mocap.filters.structural import backward, forward, level_std, particles_per_level

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class ShbmSettings:
    """Settings of the annealed particle filter over a scalable model.

    hierarchy : the models, coarse to fine; None = by depth in the tree of parts.  level_particles, level_layers :
    particles and annealing layers of each model; one number of layers holds for all.  std : (D,) noise of a column
    in the model that adds it, m and rad.
    """

    std: Array
    hierarchy: Hierarchy | None = None
    level_particles: tuple[int, ...] = (300, 500, 300)
    """Source: CF Eq. 7.29."""
    level_layers: tuple[int, ...] = (2,)
    survival_rate: float = 0.5
    """Target ESS / N of every layer, and the factor on the noise covariance from layer to layer (CF 7.5.1)."""
    structural_rate: float = 0.8
    """Factor on the noise covariance from model to model (CF 7.5.1)."""
    crossing: str = "mirror"
    resampling: str = "systematic"

    def __post_init__(self) -> None:
        if min(self.level_particles, default=0) < 2 or min(self.level_layers, default=0) < 1:
            raise ValueError(
                "level_particles >= 2 and level_layers >= 1, "
                f"got {list(self.level_particles)} and {list(self.level_layers)}"
            )
        if len(self.level_layers) not in (1, len(self.level_particles)):
            raise ValueError(
                f"{len(self.level_layers)} level_layers for {len(self.level_particles)} level_particles"
            )
        if self.crossing not in CROSSING:
            raise ValueError(f"crossing {self.crossing!r} is none of {', '.join(CROSSING)}")
        if self.resampling not in RESAMPLING:
            raise ValueError(f"resampling {self.resampling!r} is none of {', '.join(RESAMPLING)}")

    @property
    def n_particles(self) -> int:
        """Particles of the finest model, which are those that live on."""
        return self.level_particles[-1]

    @property
    def n_layers(self) -> tuple[int, ...]:
        """Layers of each model."""
        if len(self.level_layers) == 1:
            return self.level_layers * len(self.level_particles)
        return self.level_layers


@dataclass(frozen=True, eq=False)
class ShbmInfo(FilterInfo):
    """What the filter tells beyond `FilterInfo`.

    beta and ess run over the layers of all models.  level_estimates : (M, D) estimate of each model, with the columns
    that it does not have pinned (CF Eq. 7.11).  level_best : (M,) highest log-likelihood of each, of its own parts.
    """

    level_estimates: Array | None = None
    level_best: Array | None = None


def shbm_step(
    problem: ArticulatedProblem,
    state: ParticleState,
    settings: ShbmSettings,
    *,
    rng: np.random.Generator,
) -> tuple[ParticleState, ShbmInfo]:
    """One frame of SHBM-APF: the coarsest model is filtered, handed on to the next finer one, and so on.

    state : particles (M, D) of the finest model of the last frame with their weights. The sets of the coarser models
    follow from it (G_backward), so that nothing else has to live between frames.
    Raises ValueError when the hierarchy does not fit the layout or the settings.
    Source: CF 7.3, Eq. 7.9-7.13.
    """
    layers, levels = structural_layers(problem, state, settings, rng=rng)
    return ParticleState(layers[-1].particles, layers[-1].weights), shbm_info(
        problem, settings, levels, layers
    )


def structural_layers(
    problem: ArticulatedProblem,
    state: ParticleState,
    settings: ShbmSettings,
    *,
    absent: Collection[int] = (),
    rng: np.random.Generator,
) -> tuple[list[Layers], LevelsOf]:
    """The annealing layers of every model, coarse to fine.

    absent : parts that no model has in this frame: they are neither scored nor placed, and columns that move nothing
    else keep the value that they have in the finest set.
    Source: CF Eq. 7.9-7.14.
    """
    levels = _levels_for(problem, settings)
    is_free = ~np.isin(problem.layout.part_of_column, list(absent))
    sets = backward(state.particles, state.weights, levels, settings.level_particles, rng=rng)
    found: list[Layers] = []
    for i, level in enumerate(levels.levels):
        particles = sets[0]
        if found:
            particles = forward(
                found[-1].particles, found[-1].weights, sets[i], levels, i, settings.crossing, rng=rng
            )
        std = level_std(
            levels,
            i,
            settings.std,
            settings.n_layers,
            survival_rate=settings.survival_rate,
            structural_rate=settings.structural_rate,
        )
        found.append(
            anneal(
                problem,
                particles,
                None,
                n_particles=settings.level_particles[i],
                n_layers=settings.n_layers[i],
                std=np.where(is_free, std, 0.0),
                survival_rate=settings.survival_rate,
                resampling=settings.resampling,
                parts=[p for p in level.parts if p not in absent],
                rng=rng,
            )
        )
    return found, levels


def structural_noise(levels: LevelsOf, settings: ShbmSettings) -> Array:
    """Standard deviation (D,) of the noise that a column gets in all layers of all models together."""
    variance = np.zeros_like(settings.std)
    for i, n_layers in enumerate(settings.n_layers):
        first = level_std(
            levels,
            i,
            settings.std,
            settings.n_layers,
            survival_rate=settings.survival_rate,
            structural_rate=settings.structural_rate,
        )
        variance += np.sum(layer_scales(n_layers, settings.survival_rate) ** 2) * first**2
    return np.sqrt(variance)


def shbm_info(
    problem: ArticulatedProblem,
    settings: ShbmSettings,
    levels: LevelsOf,
    layers: Sequence[Layers],
    *,
    absent: Collection[int] = (),
) -> ShbmInfo:
    """What people and plots need of a structural annealing run."""
    layout = problem.layout
    estimates, values, cost = [], [], 0.0
    for level, n_layers, own in zip(levels.levels, settings.n_layers, layers, strict=True):
        parts = [p for p in level.parts if p not in absent]
        mean = weighted_mean(own.particles, own.weights, layout.is_circular)
        estimates.append(np.where(level.has, mean, levels.pinned))
        values.append(own.best_log_likelihood)
        cost += len(own.particles) * n_layers * len(parts) / layout.n_parts
    return ShbmInfo(
        estimate=estimates[-1],
        best=layers[-1].best,
        best_log_likelihood=layers[-1].best_log_likelihood,
        beta=np.concatenate([own.beta for own in layers]),
        ess=np.concatenate([own.ess for own in layers]),
        n_evaluations=round(cost),
        is_degenerate=any(own.is_degenerate for own in layers),
        level_estimates=np.array(estimates),
        level_best=np.array(values),
    )


def _levels_for(problem: ArticulatedProblem, settings: ShbmSettings) -> LevelsOf:
    layout = problem.layout
    hierarchy = settings.hierarchy or depth_hierarchy(layout)
    levels = levels_on(hierarchy, layout)
    _require_one_for_each(settings.level_particles, hierarchy)
    return levels


def _require_one_for_each(level_particles: Sequence[int], hierarchy: Hierarchy) -> None:
    if len(hierarchy.levels) != len(level_particles):
        raise ValueError(
            f"level_particles has {len(level_particles)} numbers, the hierarchy {hierarchy.name} has "
            f"{len(hierarchy.levels)} levels"
        )


def structural_settings(budget: FilterBudget, layout: StateLayout, std: Array) -> ShbmSettings:
    """The budget's evaluations shared out by the columns that models add, or the numbers of particles that it names.

    A particle of a coarse model costs only the share of the parts that it scores, so that there are more of them than
    n_evaluations / level_layers.
    Raises ValueError when the hierarchy does not fit the layout or level_particles.
    Source: CF Eq. 7.21; departs from it in what is counted (reading guide 23).
    """
    hierarchy = budget.hierarchy or depth_hierarchy(layout)
    levels = levels_on(hierarchy, layout)
    if budget.level_particles:
        _require_one_for_each(budget.level_particles, hierarchy)
    return ShbmSettings(
        std=std,
        hierarchy=budget.hierarchy,
        level_particles=budget.level_particles or _affordable(budget, levels, layout.n_parts),
        level_layers=(budget.level_layers,),
        survival_rate=budget.survival_rate,
        structural_rate=budget.structural_rate,
        crossing=budget.crossing,
        resampling=budget.resampling,
    )


def _affordable(budget: FilterBudget, levels: LevelsOf, n_parts: int) -> tuple[int, ...]:
    """Particles of each model that the budget's evaluations pay for."""
    dimensions = levels.dimensions
    cost = budget.level_layers * sum(
        k * len(level.parts) / n_parts for k, level in zip(dimensions, levels.levels, strict=True)
    )
    return particles_per_level(dimensions, round(budget.n_evaluations * sum(dimensions) / cost))


SHBM_APF = Filter("shbm-apf", "SHBM-APF", shbm_step, structural_settings, uses_hierarchy=True)
