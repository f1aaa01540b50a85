"""Rao-Blackwellised particle filter (RBPF): particles for some columns, a Kalman filter in each of them for the rest.

It needs a sub-state that is linear and Gaussian once the rest is known. No likelihood of a body here has one, so the
filter is not among `FILTERS`: a problem of your own offers it as a `ConditionallyLinearProblem`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from mocap.data.problem import StateLayout
from mocap.filters.estimate import weighted_mean
from mocap.filters.resampling import RESAMPLING
from mocap.filters.state import FilterInfo, ParticleState
from mocap.filters.weights import effective_sample_size, normalise_log_weights

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class LinearMeasurement:
    """A measurement that is linear in the linear columns x once the others r are known: z = c(r) + H(r) x + N(0, R).

    matrix : (N, M, L) H, for every particle.  residual : (N, M) z - c(r); NaN in all particles: no data.
    covariance : (M, M) R, positive definite.
    log_weight : (N,) log-likelihood of all that is seen besides and depends on r alone.
    """

    matrix: Array
    residual: Array
    covariance: Array
    log_weight: Array


@runtime_checkable
class ConditionallyLinearProblem(Protocol):
    """A problem in which some columns are linear and Gaussian given the others."""

    @property
    def layout(self) -> StateLayout: ...

    @property
    def is_linear(self) -> Mask:
        """(D,) bool: the linear columns, without bounds and not circular. They move by N(0, std^2)."""
        ...

    def propagate(self, particles: Array, std: Array, *, rng: np.random.Generator) -> Array:
        """As in `ArticulatedProblem`; gets std 0 for the linear columns and leaves them alone."""
        ...

    def linear_measurement(self, particles: Array) -> LinearMeasurement:
        """The measurement at particles (N, D), whose linear columns must not be looked at."""
        ...


@dataclass(frozen=True, eq=False)
class RbpfSettings:
    """Settings of the Rao-Blackwellised filter.

    std : (D,) noise of the random walk, of sampled and linear columns.
    """

    n_particles: int
    std: Array
    resampling: str = "systematic"

    def __post_init__(self) -> None:
        if self.n_particles < 1:
            raise ValueError(f"n_particles must be at least 1, got {self.n_particles}")
        if self.resampling not in RESAMPLING:
            raise ValueError(f"resampling {self.resampling!r} is none of {', '.join(RESAMPLING)}")


@dataclass(frozen=True, eq=False)
class MixtureState(ParticleState):
    """Particles whose linear columns hold the mean of a Gaussian.

    covariance : (N, L, L) of the linear columns, given the particle.
    """

    covariance: Array


def rbpf_step(
    problem: ConditionallyLinearProblem,
    state: ParticleState,
    settings: RbpfSettings,
    *,
    rng: np.random.Generator,
) -> tuple[MixtureState, FilterInfo]:
    """One frame: resample, propagate the sampled columns, and for the linear ones a Kalman step in every particle.

    state : of the last frame; a plain `ParticleState` means that the linear columns are known (covariance 0).
    Particles are weighted by the likelihood with the linear columns integrated out. `best_log_likelihood` is that of
    the best particle.
    Raises ValueError when the problem has no linear sub-state, or one with bounds.
    Source: XN 3.1.4.
    """
    is_linear = _linear_columns(problem)
    n, n_linear = settings.n_particles, int(is_linear.sum())
    ancestors = RESAMPLING[settings.resampling](state.weights, n, rng=rng)
    std = np.where(is_linear, 0.0, settings.std)
    particles = problem.propagate(state.particles[ancestors], std, rng=rng)
    if isinstance(state, MixtureState):
        covariance = state.covariance[ancestors]
    else:
        covariance = np.zeros((n, n_linear, n_linear))
    covariance = covariance + np.diag(settings.std[is_linear] ** 2)
    measurement = problem.linear_measurement(particles)
    mean, covariance, log_likelihood = kalman_update(particles[:, is_linear], covariance, measurement)
    particles[:, is_linear] = mean
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
    return MixtureState(particles, weights, covariance), info


def _linear_columns(problem: ConditionallyLinearProblem) -> Mask:
    """Which columns are linear, (D,), or a ValueError that says why there are none."""
    if not isinstance(problem, ConditionallyLinearProblem):
        raise ValueError(
            "the Rao-Blackwellised filter needs a problem with a linear-Gaussian sub-state (is_linear and "
            f"linear_measurement), got {type(problem).__name__}; use sir, or a filter of FILTERS"
        )
    layout, is_linear = problem.layout, problem.is_linear
    if is_linear.shape != (layout.n_columns,):
        raise ValueError(f"is_linear has shape {is_linear.shape}, expected ({layout.n_columns},)")
    is_bounded = np.isfinite(layout.lower) | np.isfinite(layout.upper) | layout.is_circular
    if np.any(is_bounded & is_linear):
        names = ", ".join(np.array(layout.names)[is_bounded & is_linear])
        raise ValueError(f"linear columns must have no bounds and not be circular, but {names} do")
    return is_linear


def kalman_update(
    mean: Array, covariance: Array, measurement: LinearMeasurement
) -> tuple[Array, Array, Array]:
    """The Kalman filter's correction, for N Gaussians at once.

    mean : (N, L).  covariance : (N, L, L). Returns both corrected, and the log-likelihood (N,) of the measurement with
    the linear columns integrated out, log_weight included. Rows without data change nothing.
    Raises ValueError when the shapes do not fit or the measurement's covariance is not positive definite.
    Source: XN 3.1.4.
    """
    n, n_linear = mean.shape
    R = measurement.covariance
    n_rows = len(R)
    for name, array, expected in (
        ("matrix", measurement.matrix, (n, n_rows, n_linear)),
        ("residual", measurement.residual, (n, n_rows)),
        ("covariance", R, (n_rows, n_rows)),
        ("log_weight", measurement.log_weight, (n,)),
    ):
        if array.shape != expected:
            raise ValueError(f"{name} of the linear measurement has shape {array.shape}, expected {expected}")
    is_missing = np.isnan(measurement.residual)
    is_seen = ~is_missing.all(axis=0)
    if is_missing[:, is_seen].any():
        raise ValueError("residual of the linear measurement is NaN in some particles and not in others")
    H, R = measurement.matrix[:, is_seen], R[np.ix_(is_seen, is_seen)]
    innovation = measurement.residual[:, is_seen] - np.einsum("nml,nl->nm", H, mean)
    HP = H @ covariance
    S = HP @ H.transpose(0, 2, 1) + R
    try:
        # P is positive semi-definite, so this holds S up as well.
        np.linalg.cholesky(R)
        L = np.linalg.cholesky(S)
    except np.linalg.LinAlgError as error:
        raise ValueError("the linear measurement's covariance is not positive definite") from error
    whitened = np.linalg.solve(L, innovation[:, :, None])[:, :, 0]
    log_det = 2.0 * np.log(np.diagonal(L, axis1=1, axis2=2)).sum(axis=1)
    log_likelihood = -0.5 * ((whitened**2).sum(axis=1) + log_det + is_seen.sum() * np.log(2.0 * np.pi))
    gain = np.linalg.solve(S, HP).transpose(0, 2, 1)
    # Joseph's form stays symmetric and positive.
    keep = np.eye(n_linear) - gain @ H
    corrected = keep @ covariance @ keep.transpose(0, 2, 1) + gain @ R @ gain.transpose(0, 2, 1)
    moved = mean + np.einsum("nlm,nm->nl", gain, innovation)
    return moved, corrected, log_likelihood + measurement.log_weight


def mixture_covariance(state: MixtureState, is_linear: Mask) -> Array:
    """Covariance (D, D) of the whole posterior: that between the particles and that inside them.

    is_linear : (D,). Circular columns are taken as numbers.
    """
    off = state.particles - state.weights @ state.particles
    covariance = (off * state.weights[:, None]).T @ off
    covariance[np.ix_(is_linear, is_linear)] += np.einsum("n,nij->ij", state.weights, state.covariance)
    return covariance
