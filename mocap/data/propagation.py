"""Random-walk propagation inside bounds."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr, ndtri

Array = NDArray[np.float64]


def truncated_gaussian_step(
    particles: Array, std: Array, lower: Array, upper: Array, *, rng: np.random.Generator
) -> Array:
    """One draw of N(particle, std^2) truncated to [lower, upper], column by column.

    particles : (N, D).  std, lower, upper : (D,), bounds may be infinite. A particle outside its bounds is moved to
    the nearest bound first. Columns with std 0 are only clipped.
    Exact sampling by the inverse distribution function, one uniform draw per number.
    Source: CF Eq. 6.3 with N* of section 6.3.4; departs from it in method: it draws again until legal,
    which costs time near a limit.
    """
    y = np.clip(particles, lower, upper)
    u = rng.random(y.shape)
    safe = np.where(std > 0, std, 1.0)
    bounded = np.isfinite(lower) | np.isfinite(upper)
    out = y.copy()
    free = ~bounded & (std > 0)
    # A uniform of exactly 0 would give -inf.
    u = np.clip(u, 1e-16, 1 - 1e-16)
    out[:, free] += safe[free] * ndtri(u[:, free])
    cut = bounded & (std > 0)
    a = ndtr((lower[cut] - y[:, cut]) / safe[cut])
    b = ndtr((upper[cut] - y[:, cut]) / safe[cut])
    out[:, cut] += safe[cut] * ndtri(a + u[:, cut] * (b - a))
    return np.clip(out, lower, upper)
