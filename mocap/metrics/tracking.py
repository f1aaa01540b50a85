"""Scores of tracking: MOTP and MOTA (where, and how many missed, invented, mixed up), HOTA and IDF1 (who is who)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mocap.arrays import Array
from mocap.data import Tracks


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
        pairs = _kept_pairs(object_ids, track_ids, last, gap, gate_m)
        pairs += _new_pairs(pairs, gap, gate_m)
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


def _kept_pairs(
    object_ids: NDArray[np.int64],
    track_ids: NDArray[np.int64],
    last: Mapping[int, int],
    gap: Array,
    gate_m: float,
) -> list[tuple[int, int]]:
    """Rows and columns of `gap` (P, K) of persons who keep the track that they had last.  last : person -> track."""
    column_of = {int(track): j for j, track in enumerate(track_ids)}
    pairs: list[tuple[int, int]] = []
    for i, person in enumerate(object_ids):
        j = column_of.get(last.get(int(person), -1), -1)
        if j >= 0 and gap[i, j] <= gate_m and all(j != used for _, used in pairs):
            pairs.append((i, j))
    return pairs


def _new_pairs(kept: Sequence[tuple[int, int]], gap: Array, gate_m: float) -> list[tuple[int, int]]:
    """As many pairs within the gate as possible among those not yet kept, at the least total distance."""
    from scipy.optimize import linear_sum_assignment

    rows = sorted(set(range(gap.shape[0])) - {i for i, _ in kept})
    columns = sorted(set(range(gap.shape[1])) - {j for _, j in kept})
    if not rows or not columns:
        return []
    rest = gap[np.ix_(rows, columns)]
    # One forbidden pair costs more than all allowed ones together: as many matches as possible.
    forbidden = gate_m * (min(rest.shape) + 1)
    assigned = zip(*linear_sum_assignment(np.where(rest <= gate_m, rest, forbidden)), strict=True)
    return [(rows[i], columns[j]) for i, j in assigned if rest[i, j] <= gate_m]


@dataclass(frozen=True)
class IdentityScores:
    """Scores of who is who over the whole clip, in per cent; None where undefined (nobody at all).

    hota_percent : sqrt(DetA AssA), the mean over the 19 similarity thresholds 0.05 .. 0.95.
    deta_percent : TP / (TP + FN + FP) of single frames.  assa_percent : the same of whole tracks, a mean over matches.
    idf1_percent : F1 of frames under the best one-to-one naming of tracks by persons, within the gate.
    """

    hota_percent: float | None
    deta_percent: float | None
    assa_percent: float | None
    idf1_percent: float | None


def identity_scores(
    estimate: Tracks,
    truth: Tracks,
    *,
    gate_m: float = 0.5,
    frames: Sequence[int] | NDArray[np.integer] | None = None,
) -> IdentityScores:
    """HOTA with its parts, and IDF1.

    Similarity of two positions: 1 - distance / (2 gate), horizontally, at least 0, so that threshold 0.5 of HOTA is
    the gate of MOTA. frames : as in `tracking_scores`.
    Source: Luiten et al., HOTA, IJCV 129 (2021); Ristani et al., Performance measures and a data set for
    multi-target, multi-camera tracking (2016) for IDF1.
    """
    from scipy.optimize import linear_sum_assignment

    if not gate_m > 0:
        raise ValueError(f"gate_m must be positive, got {gate_m}")
    scored = np.union1d(estimate.frame, truth.frame) if frames is None else np.unique(np.asarray(frames))
    hypotheses, objects = _by_frame(estimate), _by_frame(truth)
    nobody = (np.zeros(0, dtype=np.int64), np.zeros((0, 3)))
    persons, tracks = np.unique(truth.person), np.unique(estimate.person)
    shape = (len(persons), len(tracks))
    n_person, n_track = np.zeros((shape[0], 1)), np.zeros((1, shape[1]))
    alike, within = np.zeros(shape), np.zeros(shape)
    scenes = []
    for frame in scored:
        object_ids, object_xyz = objects.get(int(frame), nobody)
        track_ids, track_xyz = hypotheses.get(int(frame), nobody)
        i, j = np.searchsorted(persons, object_ids), np.searchsorted(tracks, track_ids)
        gap = np.linalg.norm(object_xyz[:, None, :2] - track_xyz[None, :, :2], axis=2)
        similarity = np.maximum(0.0, 1.0 - gap / (2.0 * gate_m))
        total = similarity.sum(axis=0)[None, :] + similarity.sum(axis=1)[:, None] - similarity
        alike[np.ix_(i, j)] += np.divide(similarity, total, out=np.zeros_like(total), where=total > 1e-12)
        within[np.ix_(i, j)] += gap <= gate_m
        n_person[i, 0] += 1
        n_track[0, j] += 1
        scenes.append((i, j, similarity))
    n_all = float(n_person.sum() + n_track.sum())
    if n_all == 0:
        return IdentityScores(None, None, None, None)

    # Whoever has most in common over the clip is matched first, in every frame anew (HOTA, section 6).
    alignment = alike / np.maximum(n_person + n_track - alike, 1e-12)
    thresholds = np.arange(1, 20) * 0.05
    n_matches = np.zeros((len(thresholds), *shape))
    for i, j, similarity in scenes:
        rows, columns = linear_sum_assignment(-alignment[np.ix_(i, j)] * similarity)
        is_match = similarity[rows, columns] >= thresholds[:, None] - 1e-12
        for a, matched in enumerate(is_match):
            n_matches[a, i[rows[matched]], j[columns[matched]]] += 1
    found = n_matches.sum(axis=(1, 2))
    detection = found / (n_all - found)
    share = n_matches / np.maximum(n_person + n_track - n_matches, 1.0)
    association = (n_matches * share).sum(axis=(1, 2)) / np.maximum(found, 1.0)

    rows, columns = linear_sum_assignment(-within)
    return IdentityScores(
        hota_percent=100.0 * float(np.sqrt(detection * association).mean()),
        deta_percent=100.0 * float(detection.mean()),
        assa_percent=100.0 * float(association.mean()),
        idf1_percent=100.0 * 2.0 * float(within[rows, columns].sum()) / n_all,
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
