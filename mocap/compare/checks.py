"""Plausibility checks: warnings about axes, clocks and world frames that two sides seem not to share."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from mocap.compare.match import Pair
from mocap.compare.options import CompareOptions
from mocap.compare.side import Side
from mocap.data import LANDMARKS

_MAX_LAG = 15
_LAG_GAIN = 0.7  # a shift that takes off less of the error is not worth a warning
_LAG_GAIN_MM = 5.0
_FAR_MM = 500.0
_FAR_GAIN = 0.3  # a rigid fit that leaves more of the error does not speak of another world frame
_UPRIGHT = 0.8  # share of the body's long axis along one axis of the world
_LEGS = ("left_ankle", "right_ankle", "left_knee", "right_knee")
_TOP = ("head", "neck", "left_shoulder", "right_shoulder")


def order_warning(side: Side, true_side: Side) -> str | None:
    """A warning when the estimate is the truth of a session and the truth a run: scores of tracks would be wrong."""
    if side.folder != side.path / "truth" or true_side.folder is None:
        return None
    if not (true_side.folder / "run.json").exists():
        return None
    return (
        f"the estimate, {side.path}, is a session and the truth, {true_side.path}, a run: they are exchanged. "
        "Remedy: give the run first"
    )


def axis_warning(side: Side) -> str | None:
    """A warning when the body's long axis is not upright most of the time: then the axes are probably wrong."""
    legs, top = ([LANDMARKS.index(n) for n in names] for names in (_LEGS, _TOP))
    axes = []
    for m in side.motions:
        difference = m.landmarks[:, top][:, :, None] - m.landmarks[:, legs][:, None]
        known = np.all(np.isfinite(difference), axis=3)
        rows = known.sum(axis=(1, 2)) > 0
        total = np.where(known[..., None], difference, 0.0).sum(axis=(1, 2))[rows]
        axes.append(total / np.linalg.norm(total, axis=1, keepdims=True).clip(1e-12))
    if not axes or not sum(map(len, axes)):
        return None
    up = np.median(np.concatenate(axes), axis=0)
    k = int(np.argmax(np.abs(up)))
    if np.abs(up[k]) < _UPRIGHT or (k == 2 and up[2] > 0):
        return None
    where = ("x", "y", "z")[k] if up[k] > 0 else ("-x", "-y", "-z")[k]
    return (
        f"the bodies of the {side.name} stand along {where} after reading {side.reading.up} as up. "
        f"Remedy: say which axis of the file is up with --{side.name}-up"
    )


def world_warning(scores: Mapping[str, Any]) -> str | None:
    """A warning when the estimate is far away, but not after a rigid fit."""
    here, fitted = scores["mean_error_mm"], scores["aligned"]["rigid"]["mean_error_mm"]
    if here is None or fitted is None or here < _FAR_MM or fitted > _FAR_GAIN * here:
        return None
    return (
        f"the estimate lies {here:.0f} mm from the truth, but {fitted:.0f} mm after a rigid fit: the two seem to use "
        "different world frames. Remedy: bring both into one frame, or read the aligned scores only"
    )


def lag_warning(pairs: Sequence[Pair], fps: float | None, options: CompareOptions) -> str | None:
    """A warning when the estimate, shifted by some frames, lies much closer to the truth."""
    errors = _errors_at_shifts(pairs)
    if not errors:
        return None
    best = min(errors, key=lambda k: (errors[k], abs(k)))
    now = errors[0]
    if best == 0 or not np.isfinite(now) or errors[best] > min(_LAG_GAIN * now, now - _LAG_GAIN_MM):
        return None
    option = f"--frame-offset {options.frame_offset + best}"
    if options.time_offset_s and fps:
        option = f"--time-offset {options.time_offset_s + best / fps:.3f}"
    return (
        f"shifted by {best:+d} frames the estimate lies {errors[best]:.0f} mm from the truth instead of {now:.0f} mm: "
        f"it lags behind or runs ahead, or the two count frames differently. Remedy: if they do, {option}"
    )


def _errors_at_shifts(pairs: Sequence[Pair]) -> dict[int, float]:
    """Shift of the estimate in frames -> mean error, mm; at most half of the clip either way."""
    n = max((len(p.frames) for p in pairs), default=0)
    reach = min(_MAX_LAG, n // 2 - 1)
    return {k: _error_at_shift(pairs, k) for k in range(-reach, reach + 1)} if reach >= 0 else {}


def _error_at_shift(pairs: Sequence[Pair], shift: int) -> float:
    """Mean landmark error with the estimate so many frames later, mm; infinite where nothing is known."""
    distances = []
    for p in pairs:
        _, rows, source = np.intersect1d(p.frames, p.frames + shift, return_indices=True)
        distances.append(np.linalg.norm(p.estimate[source] - p.truth[rows], axis=2).ravel())
    known = np.concatenate(distances) if distances else np.zeros(0)
    known = known[np.isfinite(known)]
    return 1000.0 * float(known.mean()) if len(known) else np.inf
