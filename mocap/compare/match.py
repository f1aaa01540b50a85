"""Matching: which estimated motion belongs to which true person, and both on the same frames."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mocap.data import ALL_LANDMARKS, LANDMARKS, Motion
from mocap.metrics import point_errors

Array = NDArray[np.float64]
Frames = Sequence[int] | NDArray[np.integer] | None

_ABSENT_COST_M = 10.0  # a frame without an estimate counts like one in another room


@dataclass(frozen=True, eq=False)
class Pair:
    """One true person and the estimate that belongs to them, on the scored frames.

    estimate, truth, std : (T, 15, 3) m, NaN = unknown.  observed : (T, 15) bool, true where the estimate does not say.
    further_estimate, further_truth : (T, 6, 3) m, the FURTHER_LANDMARKS, which are scored apart from the fifteen.
    has_estimate : False where nobody was matched.
    """

    person: int
    frames: NDArray[np.int64]
    estimate: Array
    truth: Array
    std: Array
    observed: NDArray[np.bool_]
    further_estimate: Array
    further_truth: Array
    has_estimate: bool = True


def matched_pairs(
    estimate: Sequence[Motion], truth: Sequence[Motion], *, frames: Frames = None
) -> list[Pair]:
    """Every true person with the estimate that belongs to them, associated by `associate_persons`."""
    pairs = []
    for e, t in associate_persons(estimate, truth, frames=frames):
        own, target = on_frames_of_truth(e, t, frames)
        std = np.full_like(own.landmarks, np.nan) if own.std is None else own.std
        observed = np.ones(std.shape[:2], dtype=np.bool_) if own.observed is None else own.observed
        scored, further = slice(None, len(LANDMARKS)), slice(len(LANDMARKS), None)
        pairs.append(
            Pair(
                person=t.person,
                frames=target.frames,
                estimate=own.landmarks[:, scored],
                truth=target.landmarks[:, scored],
                std=std[:, scored],
                observed=observed[:, scored],
                further_estimate=own.landmarks[:, further],
                further_truth=target.landmarks[:, further],
                has_estimate=e is not None,
            )
        )
    return pairs


def associate_persons(
    estimate: Sequence[Motion], truth: Sequence[Motion], *, frames: Frames = None
) -> list[tuple[Motion | None, Motion]]:
    """The estimated motion of every true person, None for one without; each estimate is used at most once.

    Assigned at the least total cost, which is the mean landmark distance over the truth's frames, a frame
    without an estimate counting 10 m. Two motions without a common frame are never a pair. The order of the
    result is that of `truth`.
    """
    from scipy.optimize import linear_sum_assignment

    cost = np.full((len(truth), len(estimate)), np.inf)
    for i, t in enumerate(truth):
        for j, e in enumerate(estimate):
            cost[i, j] = _distance(e, t, frames)
    finite = cost[np.isfinite(cost)]
    if not len(finite):
        return [(None, t) for t in truth]
    impossible = (finite.max() + 1.0) * (min(cost.shape) + 1)
    assigned = dict(zip(*linear_sum_assignment(np.where(np.isfinite(cost), cost, impossible)), strict=True))
    result: list[tuple[Motion | None, Motion]] = []
    for i, t in enumerate(truth):
        match = assigned.get(i)
        if match is None or not np.isfinite(cost[i, match]):
            result.append((None, t))
        else:
            result.append((estimate[match], t))
    return result


def _distance(estimate: Motion, truth: Motion, frames: Frames) -> float:
    """Mean landmark distance over the frames of the truth, m; infinite without a common frame."""
    own, target = on_frames_of_truth(estimate, truth, frames)
    scored = slice(None, len(LANDMARKS))
    error = point_errors(own.landmarks[:, scored], target.landmarks[:, scored]) / 1000.0
    is_known = np.isfinite(error)
    if not is_known.any():
        return np.inf
    count = is_known.sum(axis=1)
    per_frame = np.where(is_known, error, 0.0).sum(axis=1) / np.maximum(count, 1)
    return float(np.where(count > 0, per_frame, _ABSENT_COST_M).mean())


def on_frames_of_truth(estimate: Motion | None, truth: Motion, frames: Frames) -> tuple[Motion, Motion]:
    """Both motions on the scored frames of the truth, with all landmarks; they and std are NaN where there are none."""
    keep = np.ones(len(truth), bool) if frames is None else np.isin(truth.frames, np.asarray(frames))
    scored = truth.frames[keep]
    landmarks = np.full((len(scored), len(ALL_LANDMARKS), 3), np.nan)
    of_truth = landmarks.copy()
    of_truth[:, : truth.landmarks.shape[1]] = truth.landmarks[keep]
    target = Motion(truth.person, scored, truth.time_s[keep], of_truth)
    std = np.full_like(landmarks, np.nan)
    if estimate is None:
        return Motion(truth.person, scored, target.time_s, landmarks, std), target
    _, rows, source = np.intersect1d(scored, estimate.frames, return_indices=True)
    own = slice(None, estimate.landmarks.shape[1])
    landmarks[rows, own] = estimate.landmarks[source]
    if estimate.std is not None:
        std[rows, own] = estimate.std[source]
    observed = None
    if estimate.observed is not None:
        observed = np.zeros(landmarks.shape[:2], dtype=np.bool_)
        observed[rows, own] = estimate.observed[source]
    return Motion(estimate.person, scored, target.time_s, landmarks, std, observed), target


def stacked(arrays: Sequence[Array]) -> Array:
    """Persons one after the other, (sum of T, 15, 3); no persons give (0, 15, 3)."""
    return np.concatenate(arrays) if arrays else np.zeros((0, len(LANDMARKS), 3))
