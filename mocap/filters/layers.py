"""The annealing loop that the annealed filters share: resample, propagate, weigh with w^beta, layer after layer."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mocap.data.problem import ArticulatedProblem
from mocap.filters.annealing import annealed, layer_scales, next_beta
from mocap.filters.resampling import RESAMPLING
from mocap.filters.weights import effective_sample_size, normalise_log_weights

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Layers:
    """What came out of an annealing loop.

    particles : (N, D), weights : (N,), log_likelihood : (N,), of the last layer.  beta, ess : (L,).
    best : (D,) the particle of highest likelihood over all layers; best_log_likelihood its value.
    is_degenerate : every weight was zero in some layer.
    """

    particles: Array
    weights: Array
    log_likelihood: Array
    beta: Array
    ess: Array
    best: Array
    best_log_likelihood: float
    is_degenerate: bool


def anneal(
    problem: ArticulatedProblem,
    particles: Array,
    weights: Array | None,
    *,
    n_particles: int,
    n_layers: int,
    std: Array,
    survival_rate: float,
    resampling: str,
    parts: Sequence[int] | None = None,
    given: Sequence[int] = (),
    rng: np.random.Generator,
) -> Layers:
    """Run particles (M, D) with their weights (M,) through n_layers annealing layers of n_particles.

    weights : None for particles that were just resampled; the first layer then takes them as they are.
    std : (D,) noise of the first layer.  survival_rate : of every layer, and the factor on the noise covariance.
    parts, given : as in `ArticulatedProblem.log_likelihood`; None = all.
    Source: CF Alg. 3, Eq. 3.18-3.22.
    """
    resample = RESAMPLING[resampling]
    betas, ess = [], []
    best, best_value = particles[0], -np.inf
    is_degenerate = False
    log_likelihood = np.zeros(0)
    for scale in layer_scales(n_layers, survival_rate):
        if weights is not None:
            particles = particles[resample(weights, n_particles, rng=rng)]
        particles = problem.propagate(particles, std * scale, rng=rng)
        log_likelihood = problem.log_likelihood(particles, parts, given).sum(axis=1)
        beta = next_beta(log_likelihood, survival_rate)
        weights, log_mean = normalise_log_weights(annealed(log_likelihood, beta))
        is_degenerate |= not np.isfinite(log_mean)
        betas.append(beta)
        ess.append(effective_sample_size(weights))
        top = int(np.argmax(np.nan_to_num(log_likelihood, nan=-np.inf)))
        if log_likelihood[top] > best_value:
            best, best_value = particles[top].copy(), float(log_likelihood[top])
    if weights is None:
        weights = np.full(len(particles), 1.0 / len(particles))
    return Layers(
        particles, weights, log_likelihood, np.array(betas), np.array(ess), best, best_value, is_degenerate
    )
