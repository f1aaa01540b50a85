"""Resampling schemes as plain functions `(weights (N,), n, *, rng) -> ancestors (n,)`, in a registry.

All particles drawn by a scheme of the registry have equal weights.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Ancestors = NDArray[np.int64]

_SHARPNESS = 20.0


def _checked(weights: Array) -> Array:
    w = np.asarray(weights, dtype=np.float64)
    if w.ndim != 1 or w.size == 0 or not np.all(np.isfinite(w)) or np.any(w < 0) or not w.sum() > 0:
        raise ValueError("weights must be a non-empty 1-D array of finite numbers >= 0 with a positive sum")
    return w


def _invert_cumulative(weights: Array, positions: Array) -> Ancestors:
    """First index whose cumulative weight exceeds each position, never past the last positive weight."""
    w = _checked(weights)
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
    """Stratified resampling: one uniform draw in each of n equal strata.  Source: XN 2.2.5.1."""
    return _invert_cumulative(weights, (np.arange(n) + rng.random(n)) / n)


def multinomial(weights: Array, n: int, *, rng: np.random.Generator) -> Ancestors:
    """Multinomial resampling: n independent draws, returned sorted.  Source: XN 2.2.5.1."""
    return _invert_cumulative(weights, np.sort(rng.random(n)))


def residual(weights: Array, n: int, *, rng: np.random.Generator) -> Ancestors:
    """Residual resampling: floor(n W) copies of each particle, the rest drawn from what is left of n W.

    Ancestors come out sorted.  Source: XN 2.2.5.1.
    """
    w = _checked(weights)
    expected = n * w / w.sum()
    # Rounding can leave a product just below a whole number; it is then drawn from a remainder of almost one.
    copies = np.floor(expected).astype(np.int64)
    kept = np.repeat(np.arange(len(w)), copies)
    n_drawn = n - len(kept)
    if n_drawn <= 0:
        return kept[:n]
    remainder = expected - copies
    return np.sort(np.concatenate([kept, multinomial(remainder, n_drawn, rng=rng)]))


def adaptive_systematic(weights: Array, n: int, *, rng: np.random.Generator) -> Ancestors:
    """Systematic resampling to another number of particles, ordered from the heaviest to the lightest.

    Position in the result thus stays a rank after the weights are gone, which is what crossing needs.
    Source: CF Alg. 4 with the sorting before it.
    """
    order = np.argsort(-_checked(weights), kind="stable")
    return order[systematic(np.asarray(weights)[order], n, rng=rng)]


def weighted(
    weights: Array, n: int, *, rng: np.random.Generator, sharpness: float = _SHARPNESS
) -> tuple[Ancestors, Array]:
    """Weighted resampling: independent draws by g(W) = exp(sharpness W) instead of by the weights W themselves.

    Returns sorted ancestors (n,) and the weights (n,) that correct for it, W / g, normalised. Particles of weight
    zero can be drawn; they keep weight zero. In the rare case that only such were drawn, the heaviest particle
    takes the first place.
    Source: XN Definition 3-4 with g of XN 5.2.1.
    """
    w = _checked(weights)
    w = w / w.sum()
    g = np.exp(sharpness * (w - w.max()))
    ancestors = multinomial(g, n, rng=rng)
    corrected = w[ancestors] / g[ancestors]
    if not corrected.sum() > 0:
        ancestors[0] = int(np.argmax(w))
        corrected[0] = 1.0
    return ancestors, corrected / corrected.sum()


def weighted_then_equal(weights: Array, n: int, *, rng: np.random.Generator) -> Ancestors:
    """Weighted resampling and one systematic draw more, which makes the weights equal.

    Ancestors come out sorted.  Source: XN 5.2.1.2.
    """
    ancestors, corrected = weighted(weights, n, rng=rng)
    return ancestors[systematic(corrected, n, rng=rng)]


ResamplingScheme = Callable[..., Ancestors]

RESAMPLING: dict[str, ResamplingScheme] = {
    "systematic": systematic,
    "stratified": stratified,
    "multinomial": multinomial,
    "residual": residual,
    "weighted": weighted_then_equal,
}
