"""MOTP and MOTA: where the tracked persons are, and how many were missed, invented or mixed up."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mocap.data import Tracks

Array = NDArray[np.float64]


@dataclass(frozen=True)
class TrackingScores:
    """CLEAR scores; None where undefined (nobody matched, nobody in the truth).

    motp_mm : mean horizontal distance of matches.  motp_xyz_mm : of the same matches, in space.
    mota_percent : 100 (1 - (misses + false_positives + mismatches) / n_objects); may be negative.
    n_objects : persons of the truth summed over frames.
    """

    motp_mm: float | None
    motp_xyz_mm: float | None
    mota_percent: float | None
    misses: int
    false_positives: int
    mismatches: int
    n_matches: int
    n_objects: int
    n_frames: int
    gate_m: float


def tracking_scores(
    estimate: Tracks,
    truth: Tracks,
    *,
    gate_m: float = 0.5,
    frames: Sequence[int] | NDArray[np.integer] | None = None,
) -> TrackingScores:
    """MOTP and MOTA with a correspondence that is kept over time.

    A person keeps the track of the last frame while that is within the gate; the rest is assigned at the
    least total distance, as many pairs as possible. A mismatch is a person whose track differs from the last
    one it ever had. Rows with NaN positions count as absent.
    gate_m : largest horizontal distance of a match.  frames : score only these; None = all frames of either.
    Source: CF Eq. 4.22-4.23 (Bernardin, CLEAR); distances in xy as there, the spatial MOTP is an extra.
    """
    from scipy.optimize import linear_sum_assignment

    if not gate_m > 0:
        raise ValueError(f"gate_m must be positive, got {gate_m}")
    scored = np.union1d(estimate.frame, truth.frame) if frames is None else np.unique(np.asarray(frames))
    hypotheses, objects = _by_frame(estimate), _by_frame(truth)
    last: dict[int, int] = {}
    distances_xy: list[float] = []
    distances_xyz: list[float] = []
    misses = false_positives = mismatches = n_objects = 0
    nobody = (np.zeros(0, dtype=np.int64), np.zeros((0, 3)))
    for frame in scored:
        object_ids, object_xyz = objects.get(int(frame), nobody)
        track_ids, track_xyz = hypotheses.get(int(frame), nobody)
        gap = np.linalg.norm(object_xyz[:, None, :2] - track_xyz[None, :, :2], axis=2)
        pairs: list[tuple[int, int]] = []
        column_of = {int(h): j for j, h in enumerate(track_ids)}
        for i, person in enumerate(object_ids):
            j = column_of.get(last.get(int(person), -1), -1)
            if j >= 0 and gap[i, j] <= gate_m and all(j != used for _, used in pairs):
                pairs.append((i, j))
        rows = [i for i in range(len(object_ids)) if all(i != used for used, _ in pairs)]
        columns = [j for j in range(len(track_ids)) if all(j != used for _, used in pairs)]
        if rows and columns:
            rest = gap[np.ix_(rows, columns)]
            # One forbidden pair costs more than all allowed ones together: as many matches as possible.
            forbidden = gate_m * (min(rest.shape) + 1)
            for i, j in zip(*linear_sum_assignment(np.where(rest <= gate_m, rest, forbidden)), strict=True):
                if rest[i, j] <= gate_m:
                    pairs.append((rows[i], columns[j]))
        for i, j in pairs:
            person, track = int(object_ids[i]), int(track_ids[j])
            mismatches += last.get(person, track) != track
            last[person] = track
            distances_xy.append(float(gap[i, j]))
            distances_xyz.append(float(np.linalg.norm(object_xyz[i] - track_xyz[j])))
        misses += len(object_ids) - len(pairs)
        false_positives += len(track_ids) - len(pairs)
        n_objects += len(object_ids)
    n_errors = misses + false_positives + mismatches
    return TrackingScores(
        motp_mm=1000.0 * float(np.mean(distances_xy)) if distances_xy else None,
        motp_xyz_mm=1000.0 * float(np.mean(distances_xyz)) if distances_xyz else None,
        mota_percent=100.0 * (1.0 - n_errors / n_objects) if n_objects else None,
        misses=misses,
        false_positives=false_positives,
        mismatches=mismatches,
        n_matches=len(distances_xy),
        n_objects=n_objects,
        n_frames=len(scored),
        gate_m=float(gate_m),
    )


def _by_frame(tracks: Tracks) -> dict[int, tuple[NDArray[np.int64], Array]]:
    """frame -> (ids (n,), xyz (n, 3)), rows in any order, NaN positions dropped."""
    keep = np.isfinite(tracks.xyz).all(axis=1)
    order = np.flatnonzero(keep)[np.lexsort((tracks.person[keep], tracks.frame[keep]))]
    frame = tracks.frame[order]
    starts = np.flatnonzero(np.r_[True, frame[1:] != frame[:-1]]) if len(frame) else np.zeros(0, np.int64)
    return {
        int(frame[rows[0]]): (tracks.person[order[rows]], tracks.xyz[order[rows]])
        for rows in np.split(np.arange(len(frame)), starts[1:])
        if len(rows)
    }
