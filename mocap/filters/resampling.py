"""Resampling schemes as plain functions `(weights (N,), n, *, rng) -> ancestors (n,)`, in a registry."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Ancestors = NDArray[np.int64]


def _invert_cumulative(weights: Array, positions: Array) -> Ancestors:
    """First index whose cumulative weight exceeds each position, never past the last positive weight."""
    w = np.asarray(weights, dtype=np.float64)
    if w.ndim != 1 or w.size == 0 or not np.all(np.isfinite(w)) or np.any(w < 0) or not w.sum() > 0:
        raise ValueError("weights must be a non-empty 1-D array of finite numbers >= 0 with a positive sum")
    cumulative = np.cumsum(w)
    ancestors = np.searchsorted(cumulative, positions * cumulative[-1], side="right")
    return np.minimum(ancestors, np.flatnonzero(w)[-1])


def systematic(weights: Array, n: int, *, rng: np.random.Generator) -> Ancestors:
    """Systematic resampling: one uniform draw, n equidistant positions.

    Each particle is taken floor(n W) or ceil(n W) times; ancestors come out sorted.
    Source: CF Alg. 2.
    """
    return _invert_cumulative(weights, (np.arange(n) + rng.random()) / n)


def stratified(weights: Array, n: int, *, rng: np.random.Generator) -> Ancestors:
    """Stratified resampling: one uniform draw in each of n equal strata.  Source: XN 2.3."""
    return _invert_cumulative(weights, (np.arange(n) + rng.random(n)) / n)


def multinomial(weights: Array, n: int, *, rng: np.random.Generator) -> Ancestors:
    """Multinomial resampling: n independent draws, returned sorted.  Source: XN 2.3."""
    return _invert_cumulative(weights, np.sort(rng.random(n)))


ResamplingScheme = Callable[..., Ancestors]

RESAMPLING: dict[str, ResamplingScheme] = {
    "systematic": systematic,
    "stratified": stratified,
    "multinomial": multinomial,
}
