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

from mocap.data.keypoints import N_KEYPOINTS, Figures
from mocap.io.session import Session
from mocap.io.store import StageStore

PRODUCT = "keypoints"


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


def keypoints_at(store: StageStore, session: Session, frame: int) -> list[NDArray[np.float64]]:
    """All keypoints of one frame, one (n, 2) array of raw px per camera, NaN where one was not found."""
    arrays = store.reader(PRODUCT).read(frame)
    return [arrays["uv"][arrays["camera"] == c].reshape(-1, 2) for c in range(len(session.rig))]
