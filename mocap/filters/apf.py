"""Annealed particle filter (APF) and, with one layer and beta = 1, the plain SIR filter."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mocap.data.problem import ArticulatedProblem, StateLayout
from mocap.filters.budget import FilterBudget
from mocap.filters.estimate import weighted_mean
from mocap.filters.layers import anneal
from mocap.filters.record import Filter
from mocap.filters.resampling import RESAMPLING
from mocap.filters.state import FilterInfo, ParticleState
from mocap.filters.weights import effective_sample_size, normalise_log_weights

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class ApfSettings:
    """Settings of the annealed particle filter.

    std : (D,) standard deviation of the first layer's noise, m and rad ("P_0", reading guide 2).
    """

    n_layers: int
    n_particles: int
    std: Array
    survival_rate: float = 0.5
    """Survival rate of every layer, and the factor on the noise covariance from layer to layer (CF 3.2.2)."""
    resampling: str = "systematic"

    def __post_init__(self) -> None:
        if self.n_layers < 1 or self.n_particles < 2:
            raise ValueError(
                f"n_layers >= 1 and n_particles >= 2, got {self.n_layers} and {self.n_particles}"
            )
        if self.resampling not in RESAMPLING:
            raise ValueError(f"resampling {self.resampling!r} is none of {', '.join(RESAMPLING)}")


def apf_step(
    problem: ArticulatedProblem,
    state: ParticleState,
    settings: ApfSettings,
    *,
    rng: np.random.Generator,
) -> tuple[ParticleState, FilterInfo]:
    """One frame of the annealed particle filter: L layers of resample, propagate, weigh with w^beta.

    state : particles (M, D) of the last frame with their weights; M may differ from n_particles.
    Source: CF Alg. 3, Eq. 3.18-3.22.
    """
    layers = anneal(
        problem,
        state.particles,
        state.weights,
        n_particles=settings.n_particles,
        n_layers=settings.n_layers,
        std=settings.std,
        survival_rate=settings.survival_rate,
        resampling=settings.resampling,
        rng=rng,
    )
    info = FilterInfo(
        estimate=weighted_mean(layers.particles, layers.weights, problem.layout.is_circular),
        best=layers.best,
        best_log_likelihood=layers.best_log_likelihood,
        beta=layers.beta,
        ess=layers.ess,
        n_evaluations=settings.n_particles * settings.n_layers,
        is_degenerate=layers.is_degenerate,
    )
    return ParticleState(layers.particles, layers.weights), info


def sir_step(
    problem: ArticulatedProblem,
    state: ParticleState,
    settings: ApfSettings,
    *,
    rng: np.random.Generator,
) -> tuple[ParticleState, FilterInfo]:
    """One frame of the plain particle filter: resample, propagate, weigh with the likelihood itself.

    `n_layers` of the settings multiplies the particles, so that both filters spend equal evaluations.
    Source: CF Alg. 1, Eq. 3.9, 3.12, 3.16.
    """
    n = settings.n_particles * settings.n_layers
    ancestors = RESAMPLING[settings.resampling](state.weights, n, rng=rng)
    particles = problem.propagate(state.particles[ancestors], settings.std, rng=rng)
    log_likelihood = problem.log_likelihood(particles).sum(axis=1)
    weights, log_mean = normalise_log_weights(log_likelihood)
    top = int(np.argmax(np.nan_to_num(log_likelihood, nan=-np.inf)))
    info = FilterInfo(
        estimate=weighted_mean(particles, weights, problem.layout.is_circular),
        best=particles[top].copy(),
        best_log_likelihood=float(log_likelihood[top]),
        beta=np.ones(1),
        ess=np.array([effective_sample_size(weights)]),
        n_evaluations=n,
        is_degenerate=not np.isfinite(log_mean),
    )
    return ParticleState(particles, weights), info


def annealed_settings(budget: FilterBudget, layout: StateLayout, std: Array) -> ApfSettings:
    """n_layers layers of n_particles; the plain filter multiplies the two itself."""
    return ApfSettings(
        n_layers=budget.n_layers,
        n_particles=budget.n_particles,
        std=std,
        survival_rate=budget.survival_rate,
        resampling=budget.resampling,
    )


SIR = Filter("sir", "PF", sir_step, annealed_settings)
APF = Filter("apf", "PFAPF", apf_step, annealed_settings)
