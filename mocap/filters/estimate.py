"""From weighted particles to one estimate and its uncertainty."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def weighted_mean(particles: Array, weights: Array, is_circular: NDArray[np.bool_]) -> Array:
    """Weighted mean of particles (N, D), circular where a column is an angle without bounds. Returns (D,).

    Source: CF Eq. 3.19; departs from it on circular columns, where an arithmetic mean has no meaning.
    """
    mean = weights @ particles
    if is_circular.any():
        angle = particles[:, is_circular]
        mean[is_circular] = np.arctan2(weights @ np.sin(angle), weights @ np.cos(angle))
    return mean
