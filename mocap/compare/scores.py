"""Scores of every run: points, angles, tracks, volume and uncertainty at once, ready for JSON."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mocap.compare.match import Pair, matched_pairs, stacked
from mocap.compare.units import unit_warning
from mocap.data import FURTHER_LANDMARKS, LANDMARKS, Motion, Tracks
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
from mocap.metrics.uncertainty import coverage_scores, silent_errors
from mocap.metrics.volume import VolumeScores

Array = NDArray[np.float64]

PCK_THRESHOLDS_MM = (25.0, 50.0, 75.0, 100.0, 150.0, 200.0)
# Keys of `evaluate` in the order of its object: first what is looked at first.
KEYS = (
    "mean_error_mm",
    "std_error_mm",
    "mmtp_mm",
    "mmta_percent",
    "epsilon_mm",
    "epsilon_opt_mm",
    "angle_mean_deg",
    "angle_std_deg",
    "motp_mm",
    "mota_percent",
    "misses",
    "false_positives",
    "mismatches",
    "volume_iou",
    "coverage_90_percent",
    "frames",
    "mmtp_std_mm",
    "epsilon_qq_mm",
    "mean_error_after_offset_mm",
    "mean_error_after_world_offset_mm",
    "lost_wrist_percent",
    "motp_xyz_mm",
    "hota_percent",
    "deta_percent",
    "assa_percent",
    "idf1_percent",
    "sharpness_90_mm",
    "silent_error_percent",
    "silent_errors",
    "landmarks_missing",
    "landmarks_scored",
    "persons_truth",
    "persons_matched",
    "extra_persons",
    "per_landmark_mm",
    "per_landmark_mmta_percent",
    "per_further_landmark_mm",
    "pck_percent",
    "unit_warning",
)
_TRACKING_KEYS = ("motp_mm", "mota_percent", "misses", "false_positives", "mismatches", "motp_xyz_mm")
_IDENTITY_KEYS = ("hota_percent", "deta_percent", "assa_percent", "idf1_percent")


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
    pairs = matched_pairs(estimate, truth, frames=frames)
    n_matched = sum(p.has_estimate for p in pairs)
    found = {
        **_pose_scores(pairs, epsilon_mm),
        **_track_scores(tracks_estimate, tracks_truth, gate_m, frames),
        "volume_iou": volume.iou if isinstance(volume, VolumeScores) else volume,
        "frames": _n_frames(pairs, tracks_truth, frames),
        "persons_truth": len(truth),
        "persons_matched": n_matched,
        "extra_persons": len(estimate) - n_matched,
        "unit_warning": unit_warning(estimate, truth),
    }
    return {key: found[key] for key in KEYS}


def _pose_scores(pairs: Sequence[Pair], epsilon_mm: float) -> dict[str, Any]:
    """Scores of the landmarks: points, angles, and whether the stated uncertainty holds."""
    x = stacked([p.estimate for p in pairs])
    y = stacked([p.truth for p in pairs])
    points = point_scores(x, y, epsilon_mm)
    errors = point_errors(x, y)
    angles = angle_scores(x, y, epsilon_mm)
    std = stacked([p.std for p in pairs])
    coverage = coverage_scores(x, y, std)
    observed = np.concatenate([p.observed for p in pairs]) if pairs else np.ones((0, len(LANDMARKS)), bool)
    silent = silent_errors(x, y, std, observed)
    return {
        "mean_error_mm": points.mean_mm,
        "std_error_mm": points.std_mm,
        "mmtp_mm": points.mmtp_mm,
        "mmtp_std_mm": points.mmtp_std_mm,
        "mmta_percent": points.mmta_percent,
        "epsilon_mm": points.epsilon_mm,
        "epsilon_opt_mm": epsilon_lilliefors(errors),
        "epsilon_qq_mm": epsilon_qq(errors),
        "mean_error_after_offset_mm": _error_after_offset(pairs, "torso", epsilon_mm),
        "mean_error_after_world_offset_mm": _error_after_offset(pairs, "world", epsilon_mm),
        "lost_wrist_percent": lost_wrist_percent(x, y),
        "landmarks_missing": points.n_missing,
        "landmarks_scored": points.n_scored,
        "per_landmark_mm": _by_landmark(points.landmark_mean_mm),
        "per_landmark_mmta_percent": _by_landmark(points.landmark_mmta_percent),
        "per_further_landmark_mm": _further_mm(pairs),
        "pck_percent": {
            f"{mm:g}": finite_or_none(v)
            for mm, v in zip(PCK_THRESHOLDS_MM, pck_percent(x, y, PCK_THRESHOLDS_MM), strict=True)
        },
        "angle_mean_deg": angles.mean_deg,
        "angle_std_deg": angles.std_deg,
        "coverage_90_percent": coverage.coverage_percent,
        "sharpness_90_mm": coverage.sharpness_mm,
        "silent_error_percent": silent.percent,
        "silent_errors": silent.n_silent,
    }


def _track_scores(
    estimate: Tracks | None,
    truth: Tracks | None,
    gate_m: float,
    frames: Sequence[int] | NDArray[np.integer] | None,
) -> dict[str, Any]:
    """Scores of who was where; all None without a truth."""
    if truth is None or not len(truth):
        return dict.fromkeys((*_TRACKING_KEYS, *_IDENTITY_KEYS))
    tracks = _no_tracks() if estimate is None else estimate
    tracking = tracking_scores(tracks, truth, gate_m=gate_m, frames=frames)
    identity = identity_scores(tracks, truth, gate_m=gate_m, frames=frames)
    return {
        **{key: getattr(tracking, key) for key in _TRACKING_KEYS},
        **{key: getattr(identity, key) for key in _IDENTITY_KEYS},
    }


def _n_frames(
    pairs: Sequence[Pair], tracks_truth: Tracks | None, frames: Sequence[int] | NDArray[np.integer] | None
) -> int:
    """Number of frames that are scored: of the true poses, or of the true tracks where there are no poses."""
    scored = [p.frames for p in pairs]
    if not scored and tracks_truth is not None:
        rows = tracks_truth.frame
        scored = [rows if frames is None else rows[np.isin(rows, np.asarray(frames))]]
    return len(np.unique(np.concatenate(scored))) if scored else 0


def _error_after_offset(pairs: Sequence[Pair], reference: str, epsilon_mm: float) -> float | None:
    """Mean error of the frames after the learning ones, offsets learnt person by person."""
    corrected, targets = [], []
    for p in pairs:
        # Learning starts with the first frame that the estimate knows, else a late entry would learn nothing.
        known = np.flatnonzero(np.isfinite(p.estimate).any(axis=(1, 2)))
        if not len(known):
            continue
        x, y = p.estimate[known[0] :], p.truth[known[0] :]
        corrected.append(offset_corrected(x, y, OFFSET_FRAMES, reference)[OFFSET_FRAMES:])
        targets.append(y[OFFSET_FRAMES:])
    return point_scores(stacked(corrected), stacked(targets), epsilon_mm).mean_mm


def finite_or_none(value: float) -> float | None:
    """A number for JSON, which has no NaN."""
    return float(value) if np.isfinite(value) else None


def _by_landmark(values: Array) -> dict[str, float | None]:
    return {name: finite_or_none(value) for name, value in zip(LANDMARKS, values, strict=True)}


def _further_mm(pairs: Sequence[Pair]) -> dict[str, float] | None:
    """Mean error of every landmark of feet and hands that both sides know somewhere; None without one."""
    errors = [point_errors(p.further_estimate, p.further_truth) for p in pairs]
    known = (
        {
            name: own[np.isfinite(own)]
            for name, own in zip(FURTHER_LANDMARKS, np.concatenate(errors).T, strict=True)
        }
        if errors
        else {}
    )
    return {name: float(own.mean()) for name, own in known.items() if len(own)} or None


def _no_tracks() -> Tracks:
    none = np.zeros(0, dtype=np.int64)
    return Tracks(none, none, np.zeros(0), np.zeros((0, 3)))
