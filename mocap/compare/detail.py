"""Detailed scores of a comparison: curves, alignments, held-out offsets, actions, pictures.

All of it is plain numbers, text, lists and dicts, ready for JSON, None where something does not apply.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mocap.compare.match import Pair, stacked
from mocap.compare.scores import finite_or_none
from mocap.data import LANDMARKS, CameraRig
from mocap.metrics.alignment import procrustes_aligned, root_aligned
from mocap.metrics.angles import ANGLES, AngleScores, angle_differences, angle_scores
from mocap.metrics.image import EPSILON_PX, image_scores, pixels_to_score
from mocap.metrics.points import (
    AUC_LIMIT_MM,
    PointScores,
    epsilon_search,
    landmark_offsets,
    pck_auc_percent,
    pck_percent,
    point_errors,
    point_scores,
    with_offsets,
)
from mocap.metrics.reference import fit_reference_skeleton
from mocap.metrics.smoothness import SmoothnessScores, smoothness_scores
from mocap.metrics.uncertainty import reliability

Array = NDArray[np.float64]

SWEEP_MM = tuple(float(mm) for mm in range(5, 305, 5))
PCK_PX = (2.0, 5.0, 10.0, 20.0, 40.0)
LEARN_SHARE = 0.2
_MIN_LEARNT = 2  # one frame has no mean worth the name


@dataclass(frozen=True)
class Action:
    """A stretch of frames with a name, both ends included; person None = all."""

    label: str
    first_frame: int
    last_frame: int
    person: int | None = None


def detailed_scores(
    pairs: Sequence[Pair],
    fps: float | None,
    epsilon_mm: float = 100.0,
    *,
    actions: Sequence[Action] = (),
    rig: CameraRig | None = None,
    epsilon_px: float = EPSILON_PX,
    learn_share: float = LEARN_SHARE,
) -> dict[str, Any]:
    """All scores beyond those of `evaluate`, by name; see docs/metrics.md for every key.

    pairs : from `matched_pairs`.  fps : of the frame numbers, None = accelerations are not scored.
    actions : stretches scored apart.  rig : cameras for the errors in pixels.  learn_share : share of the
    common frames, from the first on, that the offsets between two skeletons are learnt on; the rest is scored.
    Raises ValueError for epsilon_mm, epsilon_px or fps <= 0, or a share outside (0, 1).
    """
    x = stacked([p.estimate for p in pairs])
    y = stacked([p.truth for p in pairs])
    smoothness = _smoothness(pairs, fps)
    return {
        "epsilon_search": _natural_epsilon(x, y),
        "sweep": _sweep(x, y),
        "pck_auc_percent": pck_auc_percent(x, y),
        "pck_auc_limit_mm": AUC_LIMIT_MM,
        "aligned": _aligned(x, y, epsilon_mm),
        "offset_calibration": offset_calibration(pairs, epsilon_mm, learn_share),
        "angles": {
            "direct": _angles(angle_scores(x, y, epsilon_mm)),
            "inverse_kinematics": _angles(angles_on_reference_skeleton(pairs, epsilon_mm)),
        },
        "acceleration_error_m_s2": smoothness.acceleration_error_m_s2,
        "jitter_estimate_m_s3": smoothness.jitter_estimate_m_s3,
        "jitter_truth_m_s3": smoothness.jitter_truth_m_s3,
        "per_landmark": _per_landmark(x, y, epsilon_mm),
        "per_person": {str(p.person): _brief(point_scores(p.estimate, p.truth, epsilon_mm)) for p in pairs},
        "per_action": per_action(pairs, actions, epsilon_mm) if actions else None,
        "reliability": _reliability(x, y, stacked([p.std for p in pairs])),
        "image": None if rig is None else _image(x, y, rig, epsilon_px),
    }


def _natural_epsilon(x: Array, y: Array) -> dict[str, Any] | None:
    """Epsilon by the shape of the errors (CF 5.7-5.8) and the scores with it; None with too few errors."""
    search = epsilon_search(point_errors(x, y))
    if search is None:
        return None
    scores = point_scores(x, y, search.by_lilliefors_mm)
    return {
        "by_lilliefors_mm": search.by_lilliefors_mm,
        "by_r2_mm": search.by_r2_mm,
        "at_bound": search.at_bound,
        "mmtp_mm": scores.mmtp_mm,
        "mmtp_std_mm": scores.mmtp_std_mm,
        "mmta_percent": scores.mmta_percent,
    }


def _sweep(x: Array, y: Array) -> dict[str, Any]:
    """Accuracy and precision at every epsilon of SWEEP_MM."""
    scores = [point_scores(x, y, mm) for mm in SWEEP_MM]
    return {
        "epsilon_mm": list(SWEEP_MM),
        "mmta_percent": [s.mmta_percent for s in scores],
        "mmtp_mm": [s.mmtp_mm for s in scores],
        "mmtp_std_mm": [s.mmtp_std_mm for s in scores],
    }


def _aligned(x: Array, y: Array, epsilon_mm: float) -> dict[str, Any]:
    """Scores before and after each alignment, frame by frame."""
    alignments = {
        "none": x,
        "root": root_aligned(x, y),
        "rigid": procrustes_aligned(x, y, with_scale=False),
        "procrustes": procrustes_aligned(x, y),
    }
    return {
        name: _brief(point_scores(moved, y, epsilon_mm), pck_auc_percent(moved, y))
        for name, moved in alignments.items()
    }


def _reliability(x: Array, y: Array, std: Array) -> dict[str, Any] | None:
    """Whether the stated uncertainty holds at every level; None when none is stated."""
    found = reliability(x, y, std)
    if found is None:
        return None
    return {
        "level_percent": found.level_percent.round(6).tolist(),
        "coverage_percent": found.coverage_percent.tolist(),
        "calibration_error_percent": found.calibration_error_percent,
        "std_factor": found.std_factor,
        "claimed_mm": found.claimed_mm.tolist(),
        "found_mm": found.found_mm.tolist(),
        "landmarks": found.n,
    }


def angles_on_reference_skeleton(pairs: Sequence[Pair], epsilon_mm: float | None) -> AngleScores:
    """Angular error after both sides were fitted by the reference skeleton, person by person.

    Landmarks that are not matched take no part in the fit: a lost hand would pull at the trunk.

    Source: CF 5.3.2, Eq. 5.9 as in `angle_differences`.
    """
    n = len(ANGLES)
    estimated, true, matched = [np.zeros((0, n))], [np.zeros((0, n))], [np.zeros((0, len(LANDMARKS)), bool)]
    for p in pairs:
        error = point_errors(p.estimate, p.truth)
        is_matched = np.isfinite(error) if epsilon_mm is None else error <= epsilon_mm
        estimated.append(fit_reference_skeleton(np.where(is_matched[..., None], p.estimate, np.nan)).angles)
        true.append(fit_reference_skeleton(p.truth).angles)
        matched.append(is_matched)
    return angle_differences(np.concatenate(estimated), np.concatenate(true), np.concatenate(matched))


def offset_calibration(pairs: Sequence[Pair], epsilon_mm: float, learn_share: float) -> dict[str, Any] | None:
    """Scores of the held-out frames after one constant offset per landmark in the body's frame.

    The offsets are learnt, person by person, on the first `learn_share` of the frames in which estimate and truth have
    a landmark in common, and everything after the last of them is scored, with and without offsets. Neighbouring frames
    are nearly the same, so that learning on every fifth frame would hold nothing out. None when nothing is left.
    """
    if not 0 < learn_share < 1:
        raise ValueError(f"learn_share must be in (0, 1), got {learn_share}")
    before, after, targets, n_learnt = [], [], [], 0
    offsets: list[Array] = []
    for p in pairs:
        common = np.flatnonzero(np.all(np.isfinite(p.estimate + p.truth), axis=2).any(axis=1))
        n = max(int(np.ceil(learn_share * len(common))), _MIN_LEARNT)
        if len(common) <= n:
            continue
        learn, rest = common[:n], slice(int(common[n - 1]) + 1, None)
        offset = landmark_offsets(p.estimate[learn], p.truth[learn])
        offsets.append(offset)
        n_learnt += n
        before.append(p.estimate[rest])
        after.append(with_offsets(p.estimate[rest], offset))
        targets.append(p.truth[rest])
    if not targets:
        return None
    y = stacked(targets)
    known = np.array(offsets)
    count = np.isfinite(known).all(axis=2).sum(axis=0)
    with np.errstate(invalid="ignore"):
        mean = 1000.0 * np.nansum(known, axis=0) / count[:, None]
    return {
        "learn_share": learn_share,
        "frames_learnt": n_learnt,
        "frames_scored": len(y),
        "frame_of_reference": "torso",
        "before": _brief(point_scores(stacked(before), y, epsilon_mm)),
        "after": _brief(point_scores(stacked(after), y, epsilon_mm)),
        "offset_forward_left_up_mm": {
            name: [finite_or_none(v) for v in row] for name, row in zip(LANDMARKS, mean, strict=True)
        },
    }


def per_action(pairs: Sequence[Pair], actions: Sequence[Action], epsilon_mm: float) -> dict[str, Any]:
    """Scores of every action by its label; stretches of the same label are put together.

    A label none of whose frames is scored has `frames` 0 and no numbers.
    """
    table: dict[str, Any] = {}
    for label in dict.fromkeys(a.label for a in actions):
        estimates, truths, n_frames = [], [], 0
        for p in pairs:
            keep = np.zeros(len(p.frames), bool)
            for action in actions:
                if action.label == label and action.person in (None, p.person):
                    keep |= (p.frames >= action.first_frame) & (p.frames <= action.last_frame)
            estimates.append(p.estimate[keep])
            truths.append(p.truth[keep])
            n_frames += int(keep.sum())
        x, y = stacked(estimates), stacked(truths)
        angles = angle_scores(x, y, epsilon_mm)
        table[label] = {
            "frames": n_frames,
            **_brief(point_scores(x, y, epsilon_mm), pck_auc_percent(x, y)),
            "angle_mean_deg": angles.mean_deg,
        }
    return table


def _brief(scores: PointScores, auc: float | None = None) -> dict[str, float | None]:
    return {
        "mean_error_mm": scores.mean_mm,
        "std_error_mm": scores.std_mm,
        "mmtp_mm": scores.mmtp_mm,
        "mmtp_std_mm": scores.mmtp_std_mm,
        "mmta_percent": scores.mmta_percent,
        **({} if auc is None else {"pck_auc_percent": auc}),
    }


def _angles(scores: AngleScores) -> dict[str, Any]:
    return {
        "mean_deg": scores.mean_deg,
        "std_deg": scores.std_deg,
        "frames": scores.n_frames,
        "per_angle_deg": {
            name: finite_or_none(v) for name, v in zip(ANGLES, scores.per_angle_deg, strict=True)
        },
    }


def _per_landmark(x: Array, y: Array, epsilon_mm: float) -> dict[str, dict[str, float | None]]:
    """Mean, deviation, median, 90 % quantile, MMTP and MMTA of each landmark."""
    errors = point_errors(x, y)
    table = {}
    for m, name in enumerate(LANDMARKS):
        scores = point_scores(x[:, m : m + 1], y[:, m : m + 1], epsilon_mm)
        known = errors[np.isfinite(errors[:, m]), m]
        median, high = (None, None) if not len(known) else map(float, np.quantile(known, [0.5, 0.9]))
        table[name] = {
            "mean_mm": scores.mean_mm,
            "std_mm": scores.std_mm,
            "median_mm": median,
            "quantile_90_mm": high,
            "mmtp_mm": scores.mmtp_mm,
            "mmta_percent": scores.mmta_percent,
        }
    return table


def _smoothness(pairs: Sequence[Pair], fps: float | None) -> SmoothnessScores:
    """Means over persons, weighted by the number of frames."""
    if fps is None:
        return SmoothnessScores(None, None, None)
    each = [(smoothness_scores(p.estimate, p.truth, p.frames, fps), len(p.frames)) for p in pairs]
    means = []
    for name in ("acceleration_error_m_s2", "jitter_estimate_m_s3", "jitter_truth_m_s3"):
        known = [(getattr(s, name), n) for s, n in each if getattr(s, name) is not None]
        total = sum(n for _, n in known)
        means.append(sum(v * n for v, n in known) / total if total else None)
    return SmoothnessScores(*means)


def _image(x: Array, y: Array, rig: CameraRig, epsilon_px: float) -> dict[str, Any]:
    together, each = image_scores(x, y, rig, epsilon_px)
    pixels = [np.concatenate(uv) / 1000.0 for uv in pixels_to_score(x, y, rig)]
    shares = pck_percent(pixels[0], pixels[1], PCK_PX)

    def in_pixels(scores: PointScores) -> dict[str, float | None]:
        return {key.replace("_mm", "_px"): value for key, value in _brief(scores).items()}

    return {
        "epsilon_px": epsilon_px,
        **in_pixels(together),
        "pck_percent": {f"{px:g}": finite_or_none(v) for px, v in zip(PCK_PX, shares, strict=True)},
        "per_camera": {name: in_pixels(scores) for name, scores in each.items()},
    }
