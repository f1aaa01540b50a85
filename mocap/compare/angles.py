"""Anatomical angles of a run against those of a synthetic truth."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mocap.data import AngleSeries
from mocap.errors import MocapError
from mocap.files import load_arrays
from mocap.geometry.rigid import wrap_angle
from mocap.metrics.anatomy import anatomical_angles, segment_frames, world_rotations

Array = NDArray[np.float64]

_ARRAYS = ("joints", "parents", "offsets_m", "rotations", "inside")
# Half width of a region that holds 90 % of a normal distribution, in standard deviations.
_WIDTH_90 = 1.6449


@dataclass(frozen=True)
class AngleError:
    """One angle over a clip: root mean square error, mean error, the first without the second, degrees; share of frames
    whose 90 % region holds the truth, and which were observed, percent."""

    angle: str
    frames: int
    rmse_deg: float
    offset_deg: float
    rmse_after_offset_deg: float
    coverage_90_percent: float
    observed_percent: float


def true_angles(truth: Path, fps: float) -> list[AngleSeries]:
    """Angles of every person of a synthetic session's truth (pose_N.npz); empty where there is none.

    Raises MocapError for a damaged file.
    """
    found = []
    for path in sorted(truth.glob("pose_*.npz")):
        arrays = load_arrays(path, "the true pose", wanted=_ARRAYS)
        if missing := [name for name in _ARRAYS if name not in arrays]:
            raise MocapError(
                f"the true pose lacks {missing[0]}", path=path, remedy="make the session again: mocap synth"
            )
        names = [str(name) for name in arrays["joints"]]
        world = world_rotations(arrays["parents"], arrays["rotations"].astype(np.float64))
        angles = anatomical_angles(segment_frames(names, arrays["offsets_m"], world))
        frames = np.flatnonzero(arrays["inside"]).astype(np.int64)
        values = np.stack(list(angles.values()), axis=1)[frames]
        found.append(
            AngleSeries(int(path.stem.partition("_")[2]), tuple(angles), frames, frames / fps, values)
        )
    return found


def angle_errors(estimate: AngleSeries, truth: AngleSeries) -> list[AngleError]:
    """Errors of every angle that both know, over the frames that both have, in the order of the estimate."""
    _, i, j = np.intersect1d(estimate.frames, truth.frames, return_indices=True)
    out = []
    for name in estimate.names:
        if name not in truth.names:
            continue
        a = estimate.names.index(name)
        error = np.rad2deg(wrap_angle(estimate.values[i, a] - truth.of(name)[j]))
        known = np.isfinite(error)
        if not known.any():
            continue
        error, rows = error[known], i[known]
        std = np.full(len(rows), np.nan) if estimate.std is None else np.rad2deg(estimate.std[rows, a])
        seen = np.ones(len(rows)) if estimate.observed is None else estimate.observed[rows, a]
        out.append(
            AngleError(
                angle=name,
                frames=len(error),
                rmse_deg=float(np.sqrt((error**2).mean())),
                offset_deg=float(error.mean()),
                rmse_after_offset_deg=float(error.std()),
                coverage_90_percent=100.0 * float((np.abs(error) <= _WIDTH_90 * std).mean()),
                observed_percent=100.0 * float(np.mean(seen)),
            )
        )
    return out
