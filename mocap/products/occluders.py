"""Occluders, product `occluders`: where something can stand in front of people, camera by camera.

One row per camera that has any, numbered in rig order: `depth_m` (h * w,) float32, the map of `Occluders`, and its
`shape` (2,) h, w; the cell's side in the attributes.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mocap.data import CameraRig, Occluders
from mocap.io.store import StageStore

PRODUCT = "occluders"


def occluder_rows(occluders: Occluders, rig: CameraRig) -> list[tuple[int, dict[str, NDArray[np.generic]]]]:
    """Number and arrays of every row."""
    maps = [(c, occluders.of(camera)) for c, camera in enumerate(rig)]
    return [
        (c, {"depth_m": depth.ravel(), "shape": np.array(depth.shape, dtype=np.int64)})
        for c, depth in maps
        if depth is not None
    ]


def occluder_attrs(occluders: Occluders) -> dict[str, object]:
    """The attributes of the product."""
    return {"cell_px": occluders.cell_px}


def stored_occluders(store: StageStore, rig: CameraRig) -> Occluders:
    """The occluders from the store."""
    reader = store.reader(PRODUCT)
    maps = {
        rig[c].name: arrays["depth_m"].astype(np.float32, copy=False).reshape(arrays["shape"])
        for c, arrays in reader
    }
    return Occluders(maps, int(reader.attrs["cell_px"]))
