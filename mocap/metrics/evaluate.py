"""All scores of a run against its truth, as the JSON object of `mocap eval`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mocap.data import LANDMARKS, Motion, Tracks
from mocap.metrics.angles import angle_scores
from mocap.metrics.points import (
    OFFSET_FRAMES,
    epsilon_lilliefors,
    epsilon_qq,
    lost_wrist_percent,
    offset_corrected,
    pck_percent,
    point_errors,
    point_scores,
)
from mocap.metrics.tracking import identity_scores, tracking_scores
from mocap.metrics.uncertainty import coverage_scores
from mocap.metrics.volume import VolumeScores

Array = NDArray[np.float64]

PCK_THRESHOLDS_MM = (25.0, 50.0, 75.0, 100.0, 150.0, 200.0)
_ABSENT_COST_M = 10.0  # a frame without an estimate counts like one in another room


def evaluate(
    estimate: Sequence[Motion],
    truth: Sequence[Motion],
    tracks_estimate: Tracks | None,
    tracks_truth: Tracks | None,
    volume: VolumeScores | float | None = None,
    epsilon_mm: float = 100.0,
    *,
    frames: Sequence[int] | NDArray[np.integer] | None = None,
    gate_m: float = 0.5,
) -> dict[str, Any]:
    """Every score that applies, ready for JSON: plain numbers, text, lists, dicts, and None where undefined.

    estimate, truth : motions in metres, world; persons may be numbered differently, they are associated by
    mean distance.  tracks_estimate, tracks_truth : positions, None or empty = tracking is not scored where
    the truth is missing.  volume : the hull's overlap with the true volume, or its IoU.  frames : frames that
    were processed; truth outside them is not scored; None = all frames of the truth.
    A person or a frame that the estimate lacks counts as landmarks not matched. An estimated person whom the
    truth does not know is counted in `extra_persons` (and, frame by frame, in `false_positives`).
    `unit_warning` names a mistake of units (millimetres read as metres); the scores are computed all the
    same.

    Keys besides those of `mocap eval`: mean_error_after_offset_mm turns the offset with the torso,
    mean_error_after_world_offset_mm does not; both are scored on the frames after the first 10, None when
    there are none. epsilon_qq_mm is the optimum by R^2 where epsilon_opt_mm is that by Lilliefors.
    """
    pairs = associate_persons(estimate, truth, frames=frames)
    by_person = [(t, *aligned(e, t, frames)) for e, t in pairs]
    x = stacked([p.landmarks for _, p, _ in by_person])
    y = stacked([t.landmarks for _, _, t in by_person])
    std = stacked([_or_nan(p.std) for _, p, _ in by_person])

    points = point_scores(x, y, epsilon_mm)
    errors = point_errors(x, y)
    angles = angle_scores(x, y, epsilon_mm)
    coverage = coverage_scores(x, y, std)
    tracking, identity = None, None
    if tracks_truth is not None and len(tracks_truth):
        found = _empty_tracks() if tracks_estimate is None else tracks_estimate
        tracking = tracking_scores(found, tracks_truth, gate_m=gate_m, frames=frames)
        identity = identity_scores(found, tracks_truth, gate_m=gate_m, frames=frames)
    scored_frames = [t.frames for _, _, t in by_person]
    if not scored_frames and tracks_truth is not None:
        rows = tracks_truth.frame
        scored_frames = [rows if frames is None else rows[np.isin(rows, np.asarray(frames))]]
    n_frames = len(np.unique(np.concatenate(scored_frames))) if scored_frames else 0
    n_pairs = sum(e is not None for e, _ in pairs)
    return {
        "mean_error_mm": points.mean_mm,
        "std_error_mm": points.std_mm,
        "mmtp_mm": points.mmtp_mm,
        "mmta_percent": points.mmta_percent,
        "epsilon_mm": points.epsilon_mm,
        "epsilon_opt_mm": epsilon_lilliefors(errors),
        "angle_mean_deg": angles.mean_deg,
        "angle_std_deg": angles.std_deg,
        "motp_mm": tracking.motp_mm if tracking else None,
        "mota_percent": tracking.mota_percent if tracking else None,
        "misses": tracking.misses if tracking else None,
        "false_positives": tracking.false_positives if tracking else None,
        "mismatches": tracking.mismatches if tracking else None,
        "volume_iou": volume.iou if isinstance(volume, VolumeScores) else volume,
        "coverage_90_percent": coverage.coverage_percent,
        "frames": n_frames,
        "mmtp_std_mm": points.mmtp_std_mm,
        "epsilon_qq_mm": epsilon_qq(errors),
        "mean_error_after_offset_mm": _after_offset(by_person, "torso", epsilon_mm),
        "mean_error_after_world_offset_mm": _after_offset(by_person, "world", epsilon_mm),
        "lost_wrist_percent": lost_wrist_percent(x, y),
        "motp_xyz_mm": tracking.motp_xyz_mm if tracking else None,
        "hota_percent": identity.hota_percent if identity else None,
        "deta_percent": identity.deta_percent if identity else None,
        "assa_percent": identity.assa_percent if identity else None,
        "idf1_percent": identity.idf1_percent if identity else None,
        "sharpness_90_mm": coverage.sharpness_mm,
        "landmarks_missing": points.n_missing,
        "landmarks_scored": points.n_scored,
        "persons_truth": len(truth),
        "persons_matched": n_pairs,
        "extra_persons": len(estimate) - n_pairs,
        "per_landmark_mm": _table(points.landmark_mean_mm),
        "per_landmark_mmta_percent": _table(points.landmark_mmta_percent),
        "pck_percent": {
            f"{mm:g}": _number(v)
            for mm, v in zip(PCK_THRESHOLDS_MM, pck_percent(x, y, PCK_THRESHOLDS_MM), strict=True)
        },
        "unit_warning": _unit_warning(estimate, truth),
    }


def associate_persons(
    estimate: Sequence[Motion],
    truth: Sequence[Motion],
    *,
    frames: Sequence[int] | NDArray[np.integer] | None = None,
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
            p, q = aligned(e, t, frames)
            error = point_errors(p.landmarks, q.landmarks) / 1000.0
            is_known = np.isfinite(error)
            if is_known.any():
                count = is_known.sum(axis=1)
                per_frame = np.where(is_known, error, 0.0).sum(axis=1) / np.maximum(count, 1)
                cost[i, j] = np.where(count > 0, per_frame, _ABSENT_COST_M).mean()
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


def length_unit(landmarks: Array) -> str:
    """The unit in which these landmarks have the size of a human body: "m", "cm", "mm" or "unknown".

    landmarks : (T, M, 3), NaN = unknown. The median root-mean-square distance of the landmarks from their
    centroid is 0.3-0.6 m for any usual pose; the limits leave room for infants and giants.
    """
    x = np.asarray(landmarks, dtype=np.float64)
    known = np.all(np.isfinite(x), axis=2)
    enough = known.sum(axis=1) >= 5
    if not enough.any():
        return "unknown"
    x, known = x[enough], known[enough]
    count = known.sum(axis=1)
    filled = np.where(known[:, :, None], x, 0.0)
    centroid = filled.sum(axis=1) / count[:, None]
    squares = np.where(known, ((filled - centroid[:, None]) ** 2).sum(axis=2), 0.0)
    size = float(np.median(np.sqrt(squares.sum(axis=1) / count)))
    for unit_name, metres in (("m", 1.0), ("cm", 0.01), ("mm", 0.001)):
        if 0.12 <= size * metres < 1.2:
            return unit_name
    return "unknown"


def aligned(
    estimate: Motion | None, truth: Motion, frames: Sequence[int] | NDArray[np.integer] | None
) -> tuple[Motion, Motion]:
    """Both motions on the scored frames of the truth; landmarks and std are NaN where the estimate has none."""
    keep = np.ones(len(truth), bool) if frames is None else np.isin(truth.frames, np.asarray(frames))
    scored = truth.frames[keep]
    target = Motion(truth.person, scored, truth.time_s[keep], truth.landmarks[keep])
    landmarks = np.full((len(scored), len(LANDMARKS), 3), np.nan)
    std = np.full_like(landmarks, np.nan)
    if estimate is None:
        return Motion(truth.person, scored, target.time_s, landmarks, std), target
    _, rows, source = np.intersect1d(scored, estimate.frames, return_indices=True)
    landmarks[rows] = estimate.landmarks[source]
    if estimate.std is not None:
        std[rows] = estimate.std[source]
    return Motion(estimate.person, scored, target.time_s, landmarks, std), target


def _after_offset(
    by_person: list[tuple[Motion, Motion, Motion]], reference: str, epsilon_mm: float
) -> float | None:
    """Mean error of the frames after the learning ones, offsets learnt person by person."""
    corrected, targets = [], []
    for _, p, t in by_person:
        # Learning starts with the first frame that the estimate knows, else a late entry would learn nothing.
        known = np.flatnonzero(np.isfinite(p.landmarks).any(axis=(1, 2)))
        if not len(known):
            continue
        x, y = p.landmarks[known[0] :], t.landmarks[known[0] :]
        corrected.append(offset_corrected(x, y, OFFSET_FRAMES, reference)[OFFSET_FRAMES:])
        targets.append(y[OFFSET_FRAMES:])
    return point_scores(stacked(corrected), stacked(targets), epsilon_mm).mean_mm


def _unit_warning(estimate: Sequence[Motion], truth: Sequence[Motion]) -> str | None:
    found = {
        name: {length_unit(m.landmarks) for m in motions} - {"m", "unknown"}
        for name, motions in (("estimate", estimate), ("truth", truth))
    }
    wrong = [f"the {name} looks like {'/'.join(sorted(units))}" for name, units in found.items() if units]
    if not wrong:
        return None
    units = sorted({u for found_units in found.values() for u in found_units})
    return (
        f"unit mistake: {' and '.join(wrong)} read as m; a body of that size does not exist. "
        f"Remedy: name the unit (--estimate-unit or --truth-unit {units[0]}), or write the file in metres"
    )


def stacked(arrays: Sequence[Array]) -> Array:
    """Persons one after the other, (sum of T, 15, 3); no persons give (0, 15, 3)."""
    return np.concatenate(arrays) if arrays else np.zeros((0, len(LANDMARKS), 3))


def _or_nan(std: Array | None) -> Array:
    # Motions made by aligned always carry a std; this tells the type checker.
    return np.zeros((0, len(LANDMARKS), 3)) if std is None else std


def _empty_tracks() -> Tracks:
    none = np.zeros(0, dtype=np.int64)
    return Tracks(none, none, np.zeros(0), np.zeros((0, 3)))


def _number(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def _table(values: Array) -> dict[str, float | None]:
    return {name: _number(value) for name, value in zip(LANDMARKS, values, strict=True)}
