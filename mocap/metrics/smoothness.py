"""Smoothness: error of the acceleration against the truth, and jitter of either side alone."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mocap.arrays import Array


@dataclass(frozen=True)
class SmoothnessScores:
    """Means over landmarks and frames; None where no run of consecutive frames is long enough.

    acceleration_error_m_s2 : length of the difference of the accelerations.  jitter_estimate_m_s3,
    jitter_truth_m_s3 : length of the third derivative, each on its own; the truth's is what a perfect estimate has.
    """

    acceleration_error_m_s2: float | None
    jitter_estimate_m_s3: float | None
    jitter_truth_m_s3: float | None


def smoothness_scores(
    estimate: Array, truth: Array, frames: NDArray[np.integer], fps: float
) -> SmoothnessScores:
    """Acceleration error and jitter of one person by central differences of consecutive frames.

    estimate, truth : (T, M, 3) m, world, NaN = unknown.  frames : (T,) ascending frame numbers; a gap breaks the
    run.  fps : frames per second of those numbers. Landmarks that both sides know take part, so that the two
    jitters are about the same instants. Raises ValueError for shapes that differ or fps <= 0.
    """
    estimate = np.asarray(estimate, dtype=np.float64)
    truth = np.asarray(truth, dtype=np.float64)
    frames = np.asarray(frames)
    if estimate.shape != truth.shape or truth.ndim != 3 or len(frames) != len(truth):
        raise ValueError(
            f"estimate has shape {estimate.shape}, truth {truth.shape}, {len(frames)} frames, "
            "expected the same (T, M, 3) and T frames"
        )
    if not fps > 0:
        raise ValueError(f"fps must be positive, got {fps}")
    both = np.isfinite(estimate + truth).all(axis=2, keepdims=True)
    x, y = np.where(both, estimate, np.nan), np.where(both, truth, np.nan)
    return SmoothnessScores(
        acceleration_error_m_s2=_mean_length(_derivative(x - y, frames, 2) * fps**2),
        jitter_estimate_m_s3=_mean_length(_derivative(x, frames, 3) * fps**3),
        jitter_truth_m_s3=_mean_length(_derivative(y, frames, 3) * fps**3),
    )


def _derivative(x: Array, frames: NDArray[np.integer], order: int) -> Array:
    """Differences of the given order over runs of consecutive frames, (K, M, 3)."""
    if len(x) <= order:
        return np.zeros((0, *x.shape[1:]))
    return np.diff(x, n=order, axis=0)[frames[order:] - frames[:-order] == order]


def _mean_length(vectors: Array) -> float | None:
    length = np.linalg.norm(vectors, axis=2)
    length = length[np.isfinite(length)]
    return float(length.mean()) if len(length) else None
