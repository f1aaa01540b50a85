"""Tracks, product `track`: persons over time.

Per frame `person` (P,) int64, `xyz` (P, 3) m and, where a tracker knows them, `covariance` (P, 3, 3) m^2 and `observed`
(P,) bool.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mocap.data import Tracks
from mocap.io.store import StageStore

PRODUCT = "track"


def track_row(tracks: Tracks, frame: int) -> dict[str, NDArray[np.generic]]:
    """The arrays of one frame."""
    rows = tracks.frame == frame
    arrays: dict[str, NDArray[np.generic]] = {"person": tracks.person[rows], "xyz": tracks.xyz[rows]}
    if tracks.covariance is not None:
        arrays["covariance"] = tracks.covariance[rows]
    if tracks.observed is not None:
        arrays["observed"] = tracks.observed[rows]
    return arrays


def stored_tracks(store: StageStore, fps: float) -> Tracks:
    """The table of tracks from the store; those of the marker chain have no covariance."""
    columns: dict[str, list[NDArray[np.generic]]] = {}
    frame = []
    for f, arrays in store.reader(PRODUCT):
        frame += [f] * len(arrays["person"])
        for name, values in arrays.items():
            columns.setdefault(name, []).append(values)
    frames = np.array(frame, dtype=np.int64)
    joined = {name: np.concatenate(values) for name, values in columns.items()}
    n = len(frames)
    return Tracks(
        frame=frames,
        person=joined["person"].astype(np.int64) if "person" in joined else np.zeros(0, dtype=np.int64),
        time_s=frames / fps,
        xyz=joined["xyz"].reshape(-1, 3).astype(np.float64) if "xyz" in joined else np.zeros((0, 3)),
        covariance=joined["covariance"].reshape(n, 3, 3).astype(np.float64)
        if "covariance" in joined
        else None,
        observed=joined["observed"].astype(np.bool_) if "observed" in joined else None,
    )
