"""Weights of particles: log-weights in float64, normalised weights, effective sample size."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def normalise_log_weights(log_weights: Array) -> tuple[Array, float]:
    """Normalised weights and the log of the mean unnormalised weight.

    log_weights : (N,), -inf and NaN count as zero weight. Returns W (N,), summing to 1, and log mean weight.
    When every weight is zero, W is uniform and the log mean is -inf: an expected outcome, not an error.
    Raises ValueError for an empty array.
    """
    lw = np.where(np.isnan(log_weights), -np.inf, np.asarray(log_weights, dtype=np.float64))
    if lw.size == 0:
        raise ValueError("log_weights is empty")
    top = lw.max()
    if not np.isfinite(top):
        if top == np.inf:
            raise ValueError("log_weights holds +inf")
        return np.full(lw.size, 1.0 / lw.size), -np.inf
    w = np.exp(lw - top)
    total = w.sum()
    return w / total, float(top + np.log(total / lw.size))


def effective_sample_size(weights: Array) -> float:
    """ESS of normalised weights (N,): 1 when one particle has all the weight, N when all are equal.

    Source: CF Eq. 3.10.
    """
    w = np.asarray(weights)
    return float(np.clip(1.0 / np.sum(w * w), 1.0, w.size))


def survival_rate(weights: Array) -> float:
    """ESS / N, in (0, 1].  Source: CF Eq. 3.11."""
    return effective_sample_size(weights) / len(weights)
