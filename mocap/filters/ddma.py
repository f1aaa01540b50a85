"""DDMA-PF: a filter that drops limbs without data from its model, and scouts that look for them until they are back.

A limb is a chain of units (`mocap.data.hierarchy.Limb`); how many of them are in the model is the state vector s_t of
the source. Problems without voxels (no `occupancy`) are judged by the spread of the particles alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from mocap.data.hierarchy import LimbIndices, limbs_on, tree_limbs
from mocap.data.problem import ArticulatedProblem, OccupancyProblem, StateLayout
from mocap.filters.annealing import layer_scales
from mocap.filters.apf import ApfSettings, annealed_settings
from mocap.filters.budget import FilterBudget
from mocap.filters.estimate import weighted_mean
from mocap.filters.layers import Layers, anneal
from mocap.filters.limb_settings import LimbSettings
from mocap.filters.record import Filter
from mocap.filters.resampling import RESAMPLING
from mocap.filters.shbm import (
    ShbmSettings,
    shbm_info,
    structural_layers,
    structural_noise,
    structural_settings,
)
from mocap.filters.state import FilterInfo, ParticleState

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class DdmaSettings:
    """apf : the filter of the limbs that are there.  limbs : when they go and come."""

    apf: ApfSettings
    limbs: LimbSettings = field(default_factory=LimbSettings)

    @property
    def n_particles(self) -> int:
        return self.apf.n_particles


@dataclass(frozen=True, eq=False)
class ShbmDdmaSettings:
    """shbm : the filter of the limbs that are there.  limbs : when they go and come."""

    shbm: ShbmSettings
    limbs: LimbSettings = field(default_factory=LimbSettings)

    @property
    def n_particles(self) -> int:
        return self.shbm.n_particles


@dataclass(frozen=True, eq=False)
class DdmaState(ParticleState):
    """n_units : for every limb, how many of its units are in the model; what lies beyond is lost.  Source: CF 7.4.1."""

    n_units: tuple[int, ...] = ()


@dataclass(frozen=True, eq=False)
class DdmaInfo(FilterInfo):
    """What the filter tells beyond `FilterInfo`.

    n_units : for every limb, units that are in the model after this frame.  spread : (D,) standard deviation of every
    column over the particles.  occupancy : (P,) of the filter's estimate, NaN for lost
    parts, None without voxels.  n_scouts : scouts that
    searched in this frame.
    """

    n_units: tuple[int, ...] = ()
    spread: Array | None = None
    occupancy: Array | None = None
    n_scouts: int = 0


def ddma_step(
    problem: ArticulatedProblem,
    state: ParticleState,
    settings: DdmaSettings,
    *,
    rng: np.random.Generator,
) -> tuple[DdmaState, DdmaInfo]:
    """One frame of DDMA-PF with the annealed particle filter for the limbs that are there.

    state : particles (M, D) with their weights; a plain `ParticleState` has all limbs. Columns of lost limbs keep
    their last values until their scout has found them.
    Source: CF 7.4.
    """
    limbs = _limbs_of(problem, settings.limbs)
    n_units = _units_in(state, limbs)
    absent = _absent_parts(limbs, n_units)
    apf, layout = settings.apf, problem.layout
    present = [p for p in range(layout.n_parts) if p not in absent]
    layers = anneal(
        problem,
        state.particles,
        state.weights,
        n_particles=apf.n_particles,
        n_layers=apf.n_layers,
        std=np.where(np.isin(layout.part_of_column, absent), 0.0, apf.std),
        survival_rate=apf.survival_rate,
        resampling=apf.resampling,
        parts=present,
        rng=rng,
    )
    info = FilterInfo(
        estimate=weighted_mean(layers.particles, layers.weights, layout.is_circular),
        best=layers.best,
        best_log_likelihood=layers.best_log_likelihood,
        beta=layers.beta,
        ess=layers.ess,
        n_evaluations=round(apf.n_particles * apf.n_layers * len(present) / layout.n_parts),
        is_degenerate=layers.is_degenerate,
    )
    noise = apf.std * np.sqrt(np.sum(layer_scales(apf.n_layers, apf.survival_rate) ** 2))
    return _lose_and_find(problem, layers, info, limbs, n_units, noise, settings.limbs, rng=rng)


def shbm_ddma_step(
    problem: ArticulatedProblem,
    state: ParticleState,
    settings: ShbmDdmaSettings,
    *,
    rng: np.random.Generator,
) -> tuple[DdmaState, DdmaInfo]:
    """One frame of DDMA-PF with SHBM-APF for the limbs that are there: every model loses the lost limbs.

    Source: CF 9.2, which leaves the combination to future work.
    """
    limbs = _limbs_of(problem, settings.limbs)
    n_units = _units_in(state, limbs)
    absent = _absent_parts(limbs, n_units)
    found, levels = structural_layers(problem, state, settings.shbm, absent=absent, rng=rng)
    info = shbm_info(problem, settings.shbm, levels, found, absent=absent)
    noise = structural_noise(levels, settings.shbm)
    return _lose_and_find(problem, found[-1], info, limbs, n_units, noise, settings.limbs, rng=rng)


def spread_of(particles: Array, mean: Array, is_circular: NDArray[np.bool_]) -> Array:
    """Standard deviation of every column over particles (N, D) around their mean (D,), all alike.

    Source: CF Eq. 7.27; departs from it as printed, which is a variance: its thresholds are standard deviations
    (reading guide 15).
    """
    d = particles - mean
    d = np.where(is_circular, np.arctan2(np.sin(d), np.cos(d)), d)
    return np.sqrt(np.mean(d * d, axis=0))


def _lose_and_find(
    problem: ArticulatedProblem,
    layers: Layers,
    info: FilterInfo,
    limbs: Sequence[LimbIndices],
    n_units: tuple[int, ...],
    noise: Array,
    settings: LimbSettings,
    *,
    rng: np.random.Generator,
) -> tuple[DdmaState, DdmaInfo]:
    """Judge every limb after the filter; send scouts for those that were lost before this frame.

    noise : (D,) standard deviation of the filter's noise over all its layers.
    """
    layout = problem.layout
    absent = _absent_parts(limbs, n_units)
    spread = spread_of(layers.particles, info.estimate, layout.is_circular)
    placed = [p for p in range(layout.n_parts) if p not in absent]
    occupancy = _occupancy(problem, info.estimate, placed, settings)
    share = settings.lost_spread_share
    wide = np.full(layout.n_columns, settings.lost_std_rad) if share is None else share * noise
    particles, estimate = layers.particles, info.estimate
    cost = float(info.n_evaluations)
    now, n_scouts = [], 0
    for limb, n_there in zip(limbs, n_units, strict=True):
        n_kept = n_there
        for unit in range(n_there):
            if _is_lost(spread > wide, occupancy, limb, unit, settings):
                n_kept = unit  # what hangs on a lost unit is lost with it
                break
        if n_there < len(limb.parts):
            scouted = LimbIndices(limb.name, limb.parts[: n_there + 1], limb.columns[: n_there + 1])
            scouts = _scout(problem, estimate, scouted, absent, settings, rng=rng)
            n_scouts += 1
            cost += settings.scout_particles * settings.scout_layers * _n_parts(scouted) / layout.n_parts
            mean = weighted_mean(scouts.particles, scouts.weights, layout.is_circular)
            if n_kept == n_there and _is_found(problem, scouts, mean, scouted, placed, settings):
                n_kept = n_there + 1
                columns = np.concatenate(scouted.columns)
                chosen = RESAMPLING["systematic"](scouts.weights, len(particles), rng=rng)
                particles, estimate = particles.copy(), estimate.copy()
                particles[:, columns] = scouts.particles[np.ix_(rng.permutation(chosen), columns)]
                estimate[columns] = mean[columns]
        now.append(n_kept)
    observed = np.ones(layout.n_parts, dtype=np.bool_)
    observed[_absent_parts(limbs, tuple(now))] = False
    return (
        DdmaState(particles, layers.weights, tuple(now)),
        DdmaInfo(
            estimate=estimate,
            best=info.best,
            best_log_likelihood=info.best_log_likelihood,
            beta=info.beta,
            ess=info.ess,
            n_evaluations=round(cost),
            is_degenerate=info.is_degenerate,
            observed_parts=observed,
            n_units=tuple(now),
            spread=spread,
            occupancy=occupancy,
            n_scouts=n_scouts,
        ),
    )


def _is_lost(
    is_wide: NDArray[np.bool_],
    occupancy: Array | None,
    limb: LimbIndices,
    unit: int,
    settings: LimbSettings,
) -> bool:
    """Every angle of the unit is wide, and its flesh has next to no data."""
    if not np.all(is_wide[limb.columns[unit]]):
        return False
    return occupancy is None or float(occupancy[list(limb.parts[unit])].mean()) < settings.lost_occupancy


def _is_found(
    problem: ArticulatedProblem,
    scouts: Layers,
    mean: Array,
    limb: LimbIndices,
    placed: Sequence[int],
    settings: LimbSettings,
) -> bool:
    """Every angle of the limb is narrow, and every unit of it lies in data."""
    spread = spread_of(scouts.particles, mean, problem.layout.is_circular)
    if not np.all(spread[np.concatenate(limb.columns)] < settings.found_std_rad):
        return False
    own = [p for unit in limb.parts for p in unit]
    occupancy = _occupancy(problem, mean, sorted({*placed, *own}), settings)
    return occupancy is None or all(
        float(occupancy[list(parts)].mean()) > settings.found_occupancy for parts in limb.parts
    )


def _scout(
    problem: ArticulatedProblem,
    estimate: Array,
    limb: LimbIndices,
    absent: Sequence[int],
    settings: LimbSettings,
    *,
    rng: np.random.Generator,
) -> Layers:
    """An annealed filter in the columns of one limb up to its first lost unit; the rest of the body holds still.

    It starts anywhere in the limb's range; half of it keeps the angles of the units that are still there. What is
    tracked takes up room for the limb, not the other way round.
    """
    layout = problem.layout
    n = settings.scout_particles
    columns = np.concatenate(limb.columns)
    low, high = layout.lower[columns], layout.upper[columns]
    is_bounded = np.isfinite(low) & np.isfinite(high)
    low = np.where(is_bounded, low, estimate[columns] - np.pi)
    high = np.where(is_bounded, high, estimate[columns] + np.pi)
    particles = np.tile(estimate, (n, 1))
    particles[:, columns] = low + rng.random((n, len(columns))) * (high - low)
    kept = columns[: len(columns) - len(limb.columns[-1])]
    particles[: n // 2, kept] = estimate[kept]
    std = np.zeros(layout.n_columns)
    std[columns] = settings.scout_std_rad
    parts = [p for unit in limb.parts for p in unit]
    return anneal(
        problem,
        particles,
        None,
        n_particles=n,
        n_layers=settings.scout_layers,
        std=std,
        survival_rate=settings.scout_survival_rate,
        resampling="systematic",
        parts=parts,
        given=[p for p in range(layout.n_parts) if p not in absent and p not in parts],
        rng=rng,
    )


def _n_parts(limb: LimbIndices) -> int:
    return sum(len(unit) for unit in limb.parts)


def _occupancy(
    problem: ArticulatedProblem, state: Array, placed: Sequence[int], settings: LimbSettings
) -> Array | None:
    """Share of every placed part in data, (P,), NaN for the others; None for a problem that knows no voxels."""
    if not isinstance(problem, OccupancyProblem):
        return None
    shares = np.full(problem.layout.n_parts, np.nan)
    shares[list(placed)] = problem.occupancy(state[None], placed, own=settings.own_data)[0]
    return shares


def _limbs_of(problem: ArticulatedProblem, settings: LimbSettings) -> tuple[LimbIndices, ...]:
    return limbs_on(tree_limbs(problem.layout) if settings.limbs is None else settings.limbs, problem.layout)


def _units_in(state: ParticleState, limbs: Sequence[LimbIndices]) -> tuple[int, ...]:
    if isinstance(state, DdmaState) and len(state.n_units) == len(limbs):
        return state.n_units
    return tuple(len(limb.parts) for limb in limbs)


def _absent_parts(limbs: Sequence[LimbIndices], n_units: Sequence[int]) -> list[int]:
    return [p for limb, n in zip(limbs, n_units, strict=True) for unit in limb.parts[n:] for p in unit]


def adaptive_settings(budget: FilterBudget, layout: StateLayout, std: Array) -> DdmaSettings:
    """The annealed filter's budget; scouts for lost limbs come on top."""
    return DdmaSettings(annealed_settings(budget, layout, std), _fitting_limbs(budget, layout))


def structural_adaptive_settings(budget: FilterBudget, layout: StateLayout, std: Array) -> ShbmDdmaSettings:
    """The structural filter's budget; scouts for lost limbs come on top."""
    return ShbmDdmaSettings(structural_settings(budget, layout, std), _fitting_limbs(budget, layout))


def _fitting_limbs(budget: FilterBudget, layout: StateLayout) -> LimbSettings:
    """The budget's limbs; ValueError when they are not limbs of this layout."""
    if budget.limbs.limbs is not None:
        limbs_on(budget.limbs.limbs, layout)
    return budget.limbs


DDMA_PF = Filter("ddma-pf", "DDMA-PF", ddma_step, adaptive_settings, uses_limbs=True)
SHBM_DDMA_PF = Filter(
    "shbm-ddma-pf",
    "SHBM-DDMA-PF",
    shbm_ddma_step,
    structural_adaptive_settings,
    uses_hierarchy=True,
    uses_limbs=True,
)
