"""The empty scene, product `empty`: what each camera shows while nobody is there, as it was learnt.

One row per camera, numbered in rig order: `picture` (h * w, 4) uint8 RGBA as of `foreground.empty_picture`, and its
`shape` (2,) h, w. No rows where masks were taken over.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mocap.io.store import StageStore

PRODUCT = "empty"


def empty_rows(pictures: Sequence[NDArray[np.uint8]]) -> list[tuple[int, dict[str, NDArray[np.generic]]]]:
    """Number and arrays of every row.  pictures : (h, w, 4) uint8 per camera."""
    return [
        (c, {"picture": own.reshape(-1, 4), "shape": np.array(own.shape[:2], dtype=np.int64)})
        for c, own in enumerate(pictures)
    ]


def stored_empty(store: StageStore) -> list[NDArray[np.uint8]]:
    """The pictures (h, w, 4) uint8 of all cameras from the store; none where masks were taken over."""
    return [arrays["picture"].reshape(*arrays["shape"], 4) for _, arrays in store.reader(PRODUCT)]
