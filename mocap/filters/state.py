"""Particles of a frame and what a filter says about it: what every pose filter takes and gives back."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from mocap.data.problem import ArticulatedProblem

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class ParticleState:
    """What the next step needs.  particles : (N, D); weights : (N,), normalised."""

    particles: Array
    weights: Array


@dataclass(frozen=True, eq=False)
class FilterInfo:
    """What people and plots need.

    estimate : (D,).  best : (D,) the particle of highest likelihood over all layers; best_log_likelihood its value.
    beta, ess : one per layer, first to run first.  n_evaluations : likelihood evaluations spent.
    is_degenerate : every weight was zero in some layer, so that the estimate rests on the noise alone.
    seconds : wall time by kind of work ("resampling", "swapping", "likelihood", ...) in filters that measure it.
    observed_parts : (P,) bool, the parts that data speaks for; None when the filter does not judge.
    """

    estimate: Array
    best: Array
    best_log_likelihood: float
    beta: Array
    ess: Array
    n_evaluations: int
    is_degenerate: bool
    seconds: dict[str, float] = field(default_factory=dict)
    observed_parts: NDArray[np.bool_] | None = None


def initial_particles(problem: ArticulatedProblem, state: Array, n: int) -> ParticleState:
    """All particles at one state (D,), equal weights: the first layer's noise spreads them."""
    particles = np.tile(np.clip(state, problem.layout.lower, problem.layout.upper), (n, 1))
    return ParticleState(particles, np.full(n, 1.0 / n))
