"""Whether the reported uncertainty is honest: how often the truth lies in the region it claims."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class CoverageScores:
    """coverage_percent : share of landmarks whose truth lies in the region, None without any.

    level_percent : what it should be.  sharpness_mm : mean radius of the regions (geometric mean of the
    axes).
    n : landmarks compared.
    """

    level_percent: float
    coverage_percent: float | None
    sharpness_mm: float | None
    n: int


def coverage_scores(estimate: Array, truth: Array, std: Array, level: float = 0.9) -> CoverageScores:
    """Share of true landmarks inside the ellipsoid that should hold `level` of them.

    estimate, truth, std : (T, M, 3) m, world; std are standard deviations along the world axes. The ellipsoid
    is that of a Gaussian without correlations: chi-square with 3 degrees of freedom. Landmarks with a NaN
    anywhere are left out; a deviation of zero holds only the exact point.
    """
    from scipy.special import chdtri

    if not 0 < level < 1:
        raise ValueError(f"level must be in (0, 1), got {level}")
    estimate, truth, std = (np.asarray(a, dtype=np.float64) for a in (estimate, truth, std))
    if not estimate.shape == truth.shape == std.shape:
        raise ValueError(f"shapes differ: estimate {estimate.shape}, truth {truth.shape}, std {std.shape}")
    known = np.isfinite(estimate + truth + std).all(axis=2)
    if not known.any():
        return CoverageScores(100.0 * level, None, None, 0)
    difference, sigma = (estimate - truth)[known], std[known]
    with np.errstate(divide="ignore", invalid="ignore"):
        scaled = np.where(difference == 0.0, 0.0, difference / sigma)
    bound = float(chdtri(3, 1.0 - level))
    inside = (scaled**2).sum(axis=1) <= bound
    radius = 1000.0 * np.sqrt(bound) * np.prod(sigma, axis=1) ** (1.0 / 3.0)
    return CoverageScores(100.0 * level, 100.0 * float(inside.mean()), float(radius.mean()), int(known.sum()))
