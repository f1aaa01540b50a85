"""The annealing schedule: the exponent of each layer from its survival rate, and the shrinking noise."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from mocap.filters.weights import normalise_log_weights, survival_rate

Array = NDArray[np.float64]

BETA_MAX = 1e6  # all likelihoods are equal, as far as any filter cares
_BETA_TOLERANCE = 1e-4  # relative to the survival rate: far below the sampling noise of ESS
_MAX_ITERATIONS = 100


def annealed(log_likelihood: Array, beta: float) -> Array:
    """Log-weights of w^beta, (N,): zero likelihoods (-inf, NaN) stay zero, for beta = 0 too.

    Source: CF Eq. 3.18.
    """
    is_dead = np.isnan(log_likelihood) | np.isneginf(log_likelihood)
    return np.where(is_dead, -np.inf, beta * np.where(is_dead, 0.0, log_likelihood))


def survival_at(log_likelihood: Array, beta: float) -> float:
    """Survival rate of the weights w^beta, (N,) log-likelihoods.  Source: CF Eq. 3.20-3.21."""
    weights, _ = normalise_log_weights(annealed(log_likelihood, beta))
    return survival_rate(weights)


def next_beta(log_likelihood: Array, target: float, *, beta_max: float = BETA_MAX) -> float:
    """The exponent beta for which ESS / N of w^beta equals `target`, by regula falsi (Illinois variant).

    log_likelihood : (N,).  target : in (1/N, 1). The survival rate falls monotonically with beta. Returns 0 when
    it is at or below the target already for beta = 0 (as with zero weights), and beta_max when all
    likelihoods are so equal that no exponent reaches the target.
    Source: CF Eq. 3.21 and the text after it.
    """
    ll = np.asarray(log_likelihood, dtype=np.float64)
    ll = np.where(np.isnan(ll), -np.inf, ll)
    if not 0 < target < 1:
        raise ValueError(f"target must lie in (0, 1), got {target}")
    alive = np.isfinite(ll)
    if not alive.any() or alive.mean() <= target:
        return 0.0
    ll = np.where(alive, ll - ll[alive].max(), -np.inf)

    n, all_alive = len(ll), bool(alive.all())

    def excess(beta: float) -> float:
        # log of ESS / N is close to linear in log beta near the root, and its sign is that of the excess.
        if not all_alive:
            return float(np.log(survival_at(ll, beta) / target))
        w = np.exp(beta * ll)  # what survival_at does, to the bit, without its checks: the largest is exp(0)
        w /= w.sum()
        return float(np.log(min(max(1.0 / (w * w).sum(), 1.0), n) / n / target))

    spread = max(-float(np.median(ll[alive])), 1e-12)
    low, high = 0.0, min(1.0 / spread, beta_max)
    f_low, f_high = float(np.log(alive.mean() / target)), excess(high)
    while f_high > 0:
        if high >= beta_max:
            return beta_max
        low, f_low = high, f_high
        high = min(2.0 * high, beta_max)
        f_high = excess(high)
    return _regula_falsi(excess, (low, f_low), (high, f_high))


def _regula_falsi(
    function: Callable[[float], float], below: tuple[float, float], above: tuple[float, float]
) -> float:
    """Where a falling function is 0 between two points (x, its value), the first positive (Illinois variant)."""
    (low, f_low), (high, f_high) = below, above
    side = 0
    beta = high
    for _ in range(_MAX_ITERATIONS):
        beta = (low * f_high - high * f_low) / (f_high - f_low)
        f = function(beta)
        if abs(f) < _BETA_TOLERANCE:
            break
        if f > 0:
            low, f_low = beta, f
            if side == 1:
                f_high *= 0.5
            side = 1
        else:
            high, f_high = beta, f
            if side == -1:
                f_low *= 0.5
            side = -1
    return beta


def layer_scales(n_layers: int, covariance_factor: float) -> Array:
    """Factors on the standard deviation of P_0 for layers L..1 (first to run first), (n_layers,).

    The covariance of the first layer is P_0; each later layer takes one factor more.
    Departs from CF Eq. 3.22 as printed: see reading guide 2.
    """
    return np.sqrt(covariance_factor ** np.arange(n_layers, dtype=np.float64))
