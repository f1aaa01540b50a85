"""Detections, product `detect`: marker detections of every frame.

Per frame `uv` (n, 2) float64 raw px and `camera` (n,) uint16, the index in the rig.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mocap.io.session import Session
from mocap.io.store import StageStore

PRODUCT = "detect"
Array = NDArray[np.float64]


def detection_row(detections: Sequence[Array]) -> dict[str, NDArray[np.generic]]:
    """The arrays of one frame.  detections : one (n, 2) per camera in rig order."""
    camera = np.repeat(np.arange(len(detections)), [len(uv) for uv in detections])
    return {"uv": np.concatenate(detections).reshape(-1, 2), "camera": camera.astype(np.uint16)}


def detections_from_arrays(arrays: dict[str, NDArray[np.generic]], n_cameras: int) -> list[Array]:
    """Detections of one frame, one (n, 2) array of raw pixels per camera."""
    camera, uv = arrays["camera"], arrays["uv"].astype(np.float64, copy=False)
    return [uv[camera == c] for c in range(n_cameras)]


def detections_at(store: StageStore, session: Session, frame: int) -> list[Array]:
    """Detections of one frame from the store."""
    return detections_from_arrays(store.reader(PRODUCT).read(frame), len(session.rig))
