"""Point metrics: mean error, MMTP and MMTA, a parameter-free epsilon, PCK, lost wrists, constant offsets.

Everywhere: landmarks are (T, M, 3) m in the world frame. A landmark that the truth does not know (NaN) is not
scored. A landmark that the estimate does not know (NaN) counts as not matched, and has no error to be
averaged.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mocap.arrays import Array
from mocap.data import LANDMARKS

MIN_FRACTION = 0.5  # epsilon is searched where at least this share of the errors lies below it
MAX_CANDIDATES = 256  # evenly spaced ranks; enough that the optimum moves by less than 0.2 % of the data
MIN_ERRORS = 20  # fewer errors say nothing about their distribution
OFFSET_FRAMES = 10
AUC_LIMIT_MM = 150.0  # the curve of correct keypoints is averaged from 0 to here, as MPI-INF-3DHP does


@dataclass(frozen=True, eq=False)
class PointScores:
    """Errors of landmarks in mm; None where no landmark could be compared.

    mean_mm, std_mm : over frames of the mean over landmarks (CF 5.2, 5.3).  mmtp_mm, mmtp_std_mm : over
    landmarks matched within epsilon_mm (CF 5.5).  mmta_percent : matched share of all scored landmarks.
    n_scored : landmarks that the truth knows.  n_missing : of those, unknown to the estimate.
    landmark_mean_mm, landmark_mmta_percent : (M,), NaN where nothing could be compared.
    """

    mean_mm: float | None
    std_mm: float | None
    mmtp_mm: float | None
    mmtp_std_mm: float | None
    mmta_percent: float | None
    epsilon_mm: float
    n_frames: int
    n_scored: int
    n_matched: int
    n_missing: int
    landmark_mean_mm: Array
    landmark_mmta_percent: Array


@dataclass(frozen=True, eq=False)
class EpsilonSearch:
    """The parameter-free epsilon and the curves it was read from.

    epsilon_mm : (K,) candidates, ascending.  lilliefors, r2 : (K,) test functions of the errors up to each.
    by_lilliefors_mm : where the first is least.  by_r2_mm : where the second is largest.
    """

    epsilon_mm: Array
    lilliefors: Array
    r2: Array
    by_lilliefors_mm: float
    by_r2_mm: float

    @property
    def at_bound(self) -> bool:
        """Whether the smallest candidate won: the errors then have no Gaussian part apart from outliers."""
        return bool(self.by_lilliefors_mm == self.epsilon_mm[0])


@dataclass(frozen=True, eq=False)
class QuantileLine:
    """Quantiles (n,) of a unit Gaussian, ordered errors (n,) mm, and errors = intercept + slope * quantiles."""

    quantiles: Array
    errors_mm: Array
    slope_mm: float
    intercept_mm: float
    r2: float


def point_errors(estimate: Array, truth: Array) -> Array:
    """Distance of every landmark from the truth, (T, M) mm; NaN where either is unknown.

    estimate, truth : (T, M, 3) m, world (or (T, M, 2), any unit times 1000).
    """
    estimate = np.asarray(estimate, dtype=np.float64)
    truth = np.asarray(truth, dtype=np.float64)
    if estimate.shape != truth.shape or truth.ndim != 3:
        raise ValueError(
            f"estimate has shape {estimate.shape}, truth {truth.shape}, expected the same (T, M, 3)"
        )
    return 1000.0 * np.linalg.norm(estimate - truth, axis=2)


def point_scores(estimate: Array, truth: Array, epsilon_mm: float = 100.0) -> PointScores:
    """Mean error, its deviation, MMTP and MMTA.

    estimate, truth : (T, M, 3) m, world, NaN = unknown (see the head of this module).
    T = 0, or nothing to compare, gives None where a mean is undefined.
    Source: CF Eq. 5.1-5.6. Departs from CF Eq. 5.6: MMTA is matched / (M T), as the tables use it (reading
    guide 5).
    """
    if not epsilon_mm > 0:
        raise ValueError(f"epsilon_mm must be positive, got {epsilon_mm}")
    error = point_errors(estimate, truth)
    is_scored = np.isfinite(np.asarray(truth)).all(axis=2)
    is_known = np.isfinite(error)
    is_matched = is_known & (error <= epsilon_mm)
    known = np.where(is_known, error, 0.0)
    frame_count, landmark_count = is_known.sum(axis=1), is_known.sum(axis=0)
    per_frame = known.sum(axis=1)[frame_count > 0] / frame_count[frame_count > 0]
    matched = error[is_matched]
    n_scored = int(is_scored.sum())
    with np.errstate(invalid="ignore"):
        landmark_mean = known.sum(axis=0) / landmark_count
        landmark_mmta = 100.0 * is_matched.sum(axis=0) / is_scored.sum(axis=0)
    return PointScores(
        mean_mm=_mean(per_frame),
        std_mm=float(per_frame.std()) if len(per_frame) else None,
        mmtp_mm=_mean(matched),
        mmtp_std_mm=float(matched.std()) if len(matched) else None,
        mmta_percent=100.0 * len(matched) / n_scored if n_scored else None,
        epsilon_mm=float(epsilon_mm),
        n_frames=len(error),
        n_scored=n_scored,
        n_matched=len(matched),
        n_missing=int((is_scored & ~is_known).sum()),
        landmark_mean_mm=landmark_mean,
        landmark_mmta_percent=landmark_mmta,
    )


def pck_percent(estimate: Array, truth: Array, thresholds_mm: Sequence[float] | Array) -> Array:
    """Percentage of correct keypoints: share of scored landmarks within each threshold, (K,) percent.

    NaN when nothing is scored. The same number as MMTA at that epsilon.
    """
    error = point_errors(estimate, truth)
    n_scored = int(np.isfinite(np.asarray(truth)).all(axis=2).sum())
    thresholds = np.asarray(thresholds_mm, dtype=np.float64)
    if n_scored == 0:
        return np.full(len(thresholds), np.nan)
    ordered = np.sort(error[np.isfinite(error)])
    return 100.0 * np.searchsorted(ordered, thresholds, side="right") / n_scored


def pck_auc_percent(estimate: Array, truth: Array, limit_mm: float = AUC_LIMIT_MM) -> float | None:
    """Area under the curve of correct keypoints from 0 to limit_mm, as a share of the best possible, percent.

    The exact area, not a sum over thresholds: a landmark at distance d counts max(0, 1 - d / limit_mm), an
    unknown one nothing. None when nothing is scored.
    """
    if not limit_mm > 0:
        raise ValueError(f"limit_mm must be positive, got {limit_mm}")
    error = point_errors(estimate, truth)
    n_scored = int(np.isfinite(np.asarray(truth)).all(axis=2).sum())
    if n_scored == 0:
        return None
    known = error[np.isfinite(error)]
    return 100.0 * float(np.clip(1.0 - known / limit_mm, 0.0, 1.0).sum()) / n_scored


def lost_wrist_percent(estimate: Array, truth: Array, limit_mm: float = 150.0) -> float | None:
    """Share of frames in which a wrist is unknown or farther than limit_mm from the truth, percent.

    estimate, truth : (T, 15, 3) m, world, order LANDMARKS. None when the truth knows no wrist.
    """
    columns = [LANDMARKS.index("left_wrist"), LANDMARKS.index("right_wrist")]
    error = point_errors(estimate, truth)[:, columns]
    is_scored = np.all(np.isfinite(np.asarray(truth)[:, columns]), axis=2)
    rows = np.any(is_scored, axis=1)
    if not rows.any():
        return None
    is_lost = is_scored & ~(error <= limit_mm)
    return 100.0 * float(is_lost.any(axis=1)[rows].mean())


def offset_corrected(
    estimate: Array, truth: Array, n_frames: int = OFFSET_FRAMES, frame_of_reference: str = "torso"
) -> Array:
    """The estimate after one constant offset per landmark, learnt on the first frames; same shape.

    Skeletons place neck, head and hips by different definitions, 30-60 mm apart; the offset takes that out
    and nothing else: no rotation, no scale, no fit to later frames.
    estimate, truth : (T, M, 3) m, world.  frame_of_reference : "world", or "torso" = the offset turns with
    the estimate's torso (pelvis, neck, hips; needs order LANDMARKS), as a different definition does on the
    body. The offset is the mean over the first n_frames; a landmark without a common frame among them stays
    as it is, and so do, for "torso", frames in which the torso is unknown.
    """
    offset = landmark_offsets(estimate[:n_frames], truth[:n_frames], frame_of_reference)
    return with_offsets(estimate, np.nan_to_num(offset), frame_of_reference)


def landmark_offsets(estimate: Array, truth: Array, frame_of_reference: str = "torso") -> Array:
    """Mean of truth minus estimate for every landmark, (M, 3) m; NaN for one without a common frame.

    estimate, truth : (T, M, 3) m, world.  frame_of_reference : as in `offset_corrected`; "torso" gives
    components forward, left, up.
    """
    estimate = np.asarray(estimate, dtype=np.float64)
    R = _reference_frames(estimate, frame_of_reference)
    difference = np.einsum("tji,tmj->tmi", R, np.asarray(truth, dtype=np.float64) - estimate)
    is_known = np.isfinite(difference).all(axis=2, keepdims=True)
    with np.errstate(invalid="ignore"):
        return np.where(is_known, difference, 0.0).sum(axis=0) / is_known.sum(axis=0)


def with_offsets(estimate: Array, offset: Array, frame_of_reference: str = "torso") -> Array:
    """The estimate (T, M, 3) m, world, with its offset (M, 3) m added to every landmark; same shape.

    What has no offset (NaN), or no torso to turn it with, stays as it is.
    """
    estimate = np.asarray(estimate, dtype=np.float64)
    shift = np.einsum("tij,mj->tmi", _reference_frames(estimate, frame_of_reference), offset)
    return estimate + np.where(np.isfinite(shift), shift, 0.0)


def _reference_frames(estimate: Array, frame_of_reference: str) -> Array:
    if frame_of_reference == "world":
        return np.broadcast_to(np.eye(3), (len(estimate), 3, 3))
    if frame_of_reference == "torso":
        return torso_rotation(estimate, "hip")
    raise ValueError(f"frame_of_reference must be 'world' or 'torso', got {frame_of_reference!r}")


def torso_rotation(landmarks: Array, side: str) -> Array:
    """Orientation of the trunk, (T, 3, 3): columns forward, left, up in the world frame.

    landmarks : (T, 15, 3) m, order LANDMARKS.  side : "hip" or "shoulder", whose line gives the left axis.
    Up is pelvis to neck; forward is perpendicular to both; left is re-made perpendicular to up.  NaN where
    the landmarks are unknown or on one line.
    """
    at = LANDMARKS.index
    up = landmarks[:, at("neck")] - landmarks[:, at("pelvis")]
    left = landmarks[:, at(f"left_{side}")] - landmarks[:, at(f"right_{side}")]
    up = unit(up)
    forward = unit(np.cross(left, up))
    return np.stack([forward, np.cross(up, forward), up], axis=2)


def unit(vectors: Array) -> Array:
    """Unit vectors of (..., 3); NaN for a zero vector."""
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return vectors / np.where(length > 1e-12, length, np.nan)


def epsilon_lilliefors(errors_mm: Array, min_fraction: float = MIN_FRACTION) -> float | None:
    """The epsilon below which the errors look most Gaussian by the Lilliefors statistic, mm.

    errors_mm : any shape; NaN are left out. Searched over the observed errors (at most 256, evenly spaced in
    rank) above the smallest `min_fraction` of the data, because on tiny subsets the statistic degenerates.
    None with fewer than 20 errors or when they are all equal.
    Source: CF Eq. 5.7-5.8. Departs from CF Eq. 5.8 in the least share of the data (reading guide 6).
    """
    return _best_epsilon(errors_mm, min_fraction, _lilliefors_statistic)


def epsilon_qq(errors_mm: Array, min_fraction: float = MIN_FRACTION) -> float | None:
    """The epsilon below which the quantile-quantile line against a Gaussian has the largest R^2, mm.

    Arguments and empty cases as `epsilon_lilliefors`. Source: CF Eq. 5.7-5.8 (second test function).
    """
    return _best_epsilon(errors_mm, min_fraction, lambda subset: -_qq_r2(subset))


def epsilon_search(errors_mm: Array, min_fraction: float = MIN_FRACTION) -> EpsilonSearch | None:
    """Both test functions over all candidates, and where each is best; what the picture of the choice shows.

    Arguments and empty cases as `epsilon_lilliefors`. Source: CF Eq. 5.7-5.8, Figure 5.6.
    """
    errors, sizes = _candidates(errors_mm, min_fraction)
    if not len(sizes):
        return None
    lilliefors = np.array([_lilliefors_statistic(errors[:k]) for k in sizes])
    r2 = np.array([_qq_r2(errors[:k]) for k in sizes])
    candidates = errors[sizes - 1]
    return EpsilonSearch(
        epsilon_mm=candidates,
        lilliefors=lilliefors,
        r2=r2,
        by_lilliefors_mm=float(candidates[_last_argmin(lilliefors)]),
        by_r2_mm=float(candidates[_last_argmin(-r2)]),
    )


def quantile_line(errors_mm: Array) -> QuantileLine | None:
    """Quantile-quantile points of errors against a unit Gaussian, and the regression line through them.

    errors_mm : any shape; NaN are left out. None with fewer than 3 errors or when they are all equal.
    Source: CF 5.2.2.
    """
    from scipy.special import ndtri

    errors = np.asarray(errors_mm, dtype=np.float64).ravel()
    errors = np.sort(errors[np.isfinite(errors)])
    n = len(errors)
    if n < 3 or errors[0] == errors[-1]:
        return None
    quantiles = ndtri((np.arange(n) + 0.5) / n)
    # The quantiles are symmetric about zero, so the line passes through the mean.
    slope = float(quantiles @ errors / (quantiles @ quantiles))
    return QuantileLine(quantiles, errors, slope, float(errors.mean()), _qq_r2(errors))


def _best_epsilon(errors_mm: Array, min_fraction: float, cost: Callable[[Array], float]) -> float | None:
    errors, sizes = _candidates(errors_mm, min_fraction)
    if not len(sizes):
        return None
    return float(errors[sizes[_last_argmin(np.array([cost(errors[:k]) for k in sizes]))] - 1])


def _candidates(errors_mm: Array, min_fraction: float) -> tuple[Array, NDArray[np.int64]]:
    """The known errors in order, and how many of them each candidate holds; no candidates for too few."""
    if not 0 < min_fraction <= 1:
        raise ValueError(f"min_fraction must be in (0, 1], got {min_fraction}")
    errors = np.asarray(errors_mm, dtype=np.float64).ravel()
    errors = np.sort(errors[np.isfinite(errors)])
    n = len(errors)
    if n < MIN_ERRORS or errors[0] == errors[-1]:
        return errors, np.zeros(0, dtype=np.int64)
    first = max(int(np.ceil(min_fraction * n)), 3)
    ranks = np.unique(np.linspace(first, n, min(MAX_CANDIDATES, n - first + 1)).round().astype(int))
    # W(epsilon) holds everything up to epsilon, so ties enter together.
    sizes = np.unique(np.searchsorted(errors, errors[ranks - 1], side="right"))
    return errors, sizes[errors[sizes - 1] > errors[0]]


def _last_argmin(costs: Array) -> int:
    """Of equally good values the last, which is the largest epsilon: it calls the fewest landmarks lost."""
    return len(costs) - 1 - int(np.argmin(costs[::-1]))


def _lilliefors_statistic(ordered: Array) -> float:
    """Largest gap between the empirical CDF and the Gaussian with the sample's mean and deviation."""
    from scipy.special import ndtr

    n = len(ordered)
    cdf = ndtr((ordered - ordered.mean()) / ordered.std(ddof=1))
    steps = np.arange(n + 1) / n
    return float(max(np.max(steps[1:] - cdf), np.max(cdf - steps[:-1])))


def _qq_r2(ordered: Array) -> float:
    """R^2 of the regression line of the ordered errors on the Gaussian quantiles."""
    from scipy.special import ndtri

    n = len(ordered)
    quantiles = ndtri((np.arange(n) + 0.5) / n)
    return float(np.corrcoef(quantiles, ordered)[0, 1] ** 2)


def _mean(values: Array) -> float | None:
    return float(values.mean()) if len(values) else None
