"""Random-walk propagation inside bounds."""

from __future__ import annotations

import numpy as np
from scipy.special import ndtr, ndtri

from mocap.arrays import Array

_SURE = 8.5  # deviations: the distribution function is 1 to the last digit


def truncated_gaussian_step(
    particles: Array, std: Array, lower: Array, upper: Array, *, rng: np.random.Generator
) -> Array:
    """One draw of N(particle, std^2) truncated to [lower, upper], column by column.

    particles : (N, D).  std, lower, upper : (D,), bounds may be infinite. A particle outside its bounds is moved to
    the nearest bound first. Columns with std 0 are only clipped, without a draw.
    Exact sampling by the inverse distribution function, one uniform draw per number.
    Source: CF Eq. 6.3 with N* of section 6.3.4; departs from it in method: it draws again until legal,
    which costs time near a limit.
    """
    out = np.clip(particles, lower, upper)
    moving = np.flatnonzero(std > 0)
    if not len(moving):
        return out
    y, sigma, low, high = out[:, moving], std[moving], lower[moving], upper[moving]
    # A uniform of exactly 0 would give -inf.
    u = np.clip(rng.random(y.shape), 1e-16, 1 - 1e-16)
    cut = np.isfinite(low) | np.isfinite(high)
    a = ndtr((low[cut] - y[:, cut]) / sigma[cut])
    above = (high[cut] - y[:, cut]) / sigma[cut]
    b = np.ones_like(above)
    near = above.min(axis=0, initial=np.inf) < _SURE
    b[:, near] = ndtr(above[:, near])
    u[:, cut] = a + u[:, cut] * (b - a)
    out[:, moving] = np.clip(y + sigma * ndtri(u), low, high)
    return out
