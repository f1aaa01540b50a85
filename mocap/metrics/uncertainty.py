"""Whether the reported uncertainty is honest: how often the truth lies in the region it claims."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mocap.arrays import Array, Mask


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


@dataclass(frozen=True)
class SilentErrors:
    """Landmarks that are far off and say nothing of it: called observed, and outside their own 90 % region.

    percent : their share of the landmarks that are far off, None without any.  n_silent, n_large : both counts.
    """

    percent: float | None
    n_silent: int
    n_large: int


# Farther off than this, a landmark is on another limb or on nothing.
LARGE_ERROR_MM = 100.0
RELIABILITY_LEVELS = tuple(round(0.05 * i, 2) for i in range(1, 20))


@dataclass(frozen=True, eq=False)
class Reliability:
    """The two sides of an honest uncertainty: shares that come true, and large where the errors are large.

    level_percent, coverage_percent : (L,) what the region should hold and what it holds.
    calibration_error_percent : mean of their absolute difference.  std_factor : what all deviations must be
    multiplied by for the 90 % region to hold 90 %; above 1 = overconfident.
    claimed_mm, found_mm : (B,) root mean square of the claimed deviations and of the errors (per axis), in
    groups of equal size from the surest landmarks to the least sure.  n : landmarks compared.
    """

    level_percent: Array
    coverage_percent: Array
    calibration_error_percent: float
    std_factor: float
    claimed_mm: Array
    found_mm: Array
    n: int


def reliability(
    estimate: Array,
    truth: Array,
    std: Array,
    *,
    levels: tuple[float, ...] = RELIABILITY_LEVELS,
    n_groups: int = 10,
) -> Reliability | None:
    """The reliability diagram of reported deviations: coverage at every level, and error against claim.

    estimate, truth, std : (T, M, 3) m, as `coverage_scores`, whose number at one level this repeats at all. None with
    fewer landmarks than groups. Landmarks of one body and of consecutive frames err together, so that small differences
    from the diagonal say nothing.
    """
    from scipy.special import chdtri

    if not levels or not all(0 < level < 1 for level in levels):
        raise ValueError(f"levels must be in (0, 1), got {levels}")
    squared, sigma, difference = _claims(estimate, truth, std)
    n = len(squared)
    if n < max(n_groups, 1):
        return None
    bounds = np.array([float(chdtri(3, 1.0 - level)) for level in levels])
    level_percent = 100.0 * np.array(levels)
    coverage = 100.0 * np.searchsorted(np.sort(squared), bounds, side="right") / n
    order = np.argsort((sigma**2).sum(axis=1), kind="stable")
    groups = np.array_split(order, n_groups)
    return Reliability(
        level_percent=level_percent,
        coverage_percent=coverage,
        calibration_error_percent=float(np.abs(coverage - level_percent).mean()),
        std_factor=float(np.sqrt(np.quantile(squared, 0.9) / chdtri(3, 0.1))),
        claimed_mm=np.array([1000.0 * np.sqrt((sigma[g] ** 2).mean()) for g in groups]),
        found_mm=np.array([1000.0 * np.sqrt((difference[g] ** 2).mean()) for g in groups]),
        n=n,
    )


def coverage_scores(estimate: Array, truth: Array, std: Array, level: float = 0.9) -> CoverageScores:
    """Share of true landmarks inside the ellipsoid that should hold `level` of them.

    estimate, truth, std : (T, M, 3) m, world; std are standard deviations along the world axes. The ellipsoid
    is that of a Gaussian without correlations: chi-square with 3 degrees of freedom. Landmarks with a NaN
    anywhere are left out; a deviation of zero holds only the exact point.
    """
    from scipy.special import chdtri

    if not 0 < level < 1:
        raise ValueError(f"level must be in (0, 1), got {level}")
    squared, sigma, _ = _claims(estimate, truth, std)
    if not len(squared):
        return CoverageScores(100.0 * level, None, None, 0)
    bound = float(chdtri(3, 1.0 - level))
    inside = squared <= bound
    radius = 1000.0 * np.sqrt(bound) * np.prod(sigma, axis=1) ** (1.0 / 3.0)
    return CoverageScores(100.0 * level, 100.0 * float(inside.mean()), float(radius.mean()), len(squared))


def silent_errors(
    estimate: Array, truth: Array, std: Array, observed: Mask, *, large_mm: float = LARGE_ERROR_MM
) -> SilentErrors:
    """Errors of which a user could not have known.

    estimate, truth, std : (T, M, 3) m, as `coverage_scores`.  observed : (T, M) bool, what the estimate says that its
    data show. Landmarks with a NaN anywhere are left out, as are those of an estimate that states no deviations.
    """
    from scipy.special import chdtri

    squared, _, difference = _claims(estimate, truth, std)
    known = np.isfinite(estimate + truth + std).all(axis=2)
    is_large = 1000.0 * np.linalg.norm(difference, axis=1) > large_mm
    is_silent = is_large & observed[known] & (squared > float(chdtri(3, 0.1)))
    n_large, n_silent = int(is_large.sum()), int(is_silent.sum())
    return SilentErrors(100.0 * n_silent / n_large if n_large else None, n_silent, n_large)


def _claims(estimate: Array, truth: Array, std: Array) -> tuple[Array, Array, Array]:
    """Squared distance in deviations (n,), deviations (n, 3) m and errors (n, 3) m of the known landmarks."""
    estimate, truth, std = (np.asarray(a, dtype=np.float64) for a in (estimate, truth, std))
    if not estimate.shape == truth.shape == std.shape:
        raise ValueError(f"shapes differ: estimate {estimate.shape}, truth {truth.shape}, std {std.shape}")
    known = np.isfinite(estimate + truth + std).all(axis=2)
    difference, sigma = (estimate - truth)[known], std[known]
    with np.errstate(divide="ignore", invalid="ignore"):
        scaled = np.where(difference == 0.0, 0.0, difference / sigma)
    return (scaled**2).sum(axis=1), sigma, difference
