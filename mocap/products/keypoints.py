"""Keypoints, product `keypoints`: the figures of every frame, with the person that each is of.

Per frame `uv` (n, K, 2) float64 raw px, NaN = not found, `confidence` (n, K), `camera` (n,) uint16, the index in the
rig, and `person` (n,) int64, 0 = nobody's; of the P persons on whom views agree `points_person` (P,) and `points`
(P, K, 3) m.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mocap.data import Tracks
from mocap.data.keypoints import N_KEYPOINTS, Figures
from mocap.io.session import Session
from mocap.io.store import StageStore

PRODUCT = "keypoints"
_GAP_S = 0.5  # people hardly move otherwise than evenly for so long


def keypoint_row(
    figures: Figures, person: NDArray[np.int64], points: Mapping[int, NDArray[np.float64]]
) -> dict[str, NDArray[Any]]:
    """The arrays of one frame.  person : (n,) of every figure.  points : person -> (K, 3) m."""
    return {
        "uv": figures.uv,
        "confidence": figures.confidence,
        "camera": figures.camera.astype(np.uint16),
        "person": person.astype(np.int64),
        "points_person": np.array(sorted(points), dtype=np.int64),
        "points": np.array([points[p] for p in sorted(points)]).reshape(-1, N_KEYPOINTS, 3),
    }


def persons_in(rows: Iterable[tuple[int, Mapping[str, NDArray[Any]]]]) -> dict[int, list[int]]:
    """Person -> frames in which two views or more agree on it, ascending."""
    found: dict[int, list[int]] = {}
    for frame, arrays in rows:
        for person in arrays["points_person"].tolist():
            found.setdefault(int(person), []).append(frame)
    return found


def stored_figure_tracks(store: StageStore, fps: float) -> Tracks:
    """The persons as they were associated, before they have poses: each from the first to the last frame in which views
    agree on it; xyz is the middle of its points, NaN where none agree."""
    frames, persons, places = [], [], []
    rows = list(store.reader(PRODUCT))
    own = {person: (seen[0], seen[-1]) for person, seen in persons_in(rows).items()}
    for frame, arrays in rows:
        middle = dict(zip(arrays["points_person"].tolist(), arrays["points"], strict=True))
        for person in sorted(p for p, (first, last) in own.items() if first <= frame <= last):
            points = middle.get(person, np.full((1, 3), np.nan))
            known = points[np.isfinite(points).all(axis=1)]
            frames.append(frame)
            persons.append(person)
            places.append(known.mean(axis=0) if len(known) else np.full(3, np.nan))
    at = np.array(frames, dtype=np.int64)
    return Tracks(at, np.array(persons, dtype=np.int64), at / fps, np.reshape(places, (-1, 3)))


def known_points(store: StageStore, fps: float) -> dict[int, NDArray[np.float64]]:
    """Frame -> the points (P, K, 3) m of the persons whom two cameras show or more, NaN = not known; what is unknown
    for up to half a second is put between what was known before and after."""
    rows = list(store.reader(PRODUCT))
    frames = np.array([frame for frame, _ in rows], dtype=np.int64)
    persons = sorted(persons_in(rows))
    points = np.full((len(persons), len(frames), N_KEYPOINTS, 3), np.nan)
    for i, (_, arrays) in enumerate(rows):
        for person, own in zip(arrays["points_person"].tolist(), arrays["points"], strict=True):
            if np.count_nonzero(arrays["person"] == person) >= 2:
                points[persons.index(person), i] = own
    for own in points.reshape(len(persons), len(frames), 3 * N_KEYPOINTS):
        for column in own.T:
            _bridge(frames, column, _GAP_S * fps)
    is_there = np.isfinite(points).any(axis=(2, 3))
    return {int(frame): points[is_there[:, i], i] for i, frame in enumerate(frames)}


def _bridge(frames: NDArray[np.int64], values: NDArray[np.float64], longest: float) -> None:
    """Put what is missing in values (T,) between its neighbours in time, in place, over up to `longest` frames."""
    known = np.flatnonzero(np.isfinite(values))
    if not 2 <= len(known) < len(values):
        return
    lost = np.flatnonzero(np.isnan(values))
    after = np.searchsorted(known, lost)
    lost, after = lost[(after > 0) & (after < len(known))], after[(after > 0) & (after < len(known))]
    is_short = frames[known[after]] - frames[known[after - 1]] <= longest
    values[lost[is_short]] = np.interp(frames[lost[is_short]], frames[known], values[known])


def keypoints_at(store: StageStore, session: Session, frame: int) -> list[NDArray[np.float64]]:
    """All keypoints of one frame, one (n, 2) array of raw px per camera, NaN where one was not found."""
    arrays = store.reader(PRODUCT).read(frame)
    return [arrays["uv"][arrays["camera"] == c].reshape(-1, 2) for c in range(len(session.rig))]
