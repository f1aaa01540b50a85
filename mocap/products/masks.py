"""Masks, product `segment`: foreground of every frame and camera.

Per frame `m0 .. mC-1`, (H, ceil(W / 8)) uint8, bits of the masks along rows in rig order; `share` (C,) foreground
share; `shadow` (C,) shadow share, NaN for masks taken over; `usable` (C,) bool. Attributes: `never_empty`, names of the
cameras of whose picture a part was never seen empty.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from mocap.io.session import Session
from mocap.io.store import StageStore

PRODUCT = "segment"


def mask_row(
    masks: Sequence[NDArray[np.bool_]], shadow: NDArray[np.float32], usable: NDArray[np.bool_]
) -> dict[str, NDArray[np.generic]]:
    """The arrays of one frame.  masks : one (H, W) bool per camera.  shadow, usable : (C,)."""
    packed: dict[str, NDArray[np.generic]] = {f"m{c}": np.packbits(m, axis=1) for c, m in enumerate(masks)}
    share = np.array([np.count_nonzero(m) / m.size for m in masks], dtype=np.float32)
    return {"share": share, "shadow": shadow, "usable": usable, **packed}


def masks_from_arrays(arrays: Mapping[str, NDArray[np.uint8]], session: Session) -> list[NDArray[np.bool_]]:
    """Masks of one frame, one (H, W) bool per camera in rig order."""
    return [
        np.unpackbits(arrays[f"m{c}"], axis=1, count=camera.size[0]).view(np.bool_)
        for c, camera in enumerate(session.rig)
    ]


def read_masks(store: StageStore, session: Session) -> Iterator[tuple[int, list[NDArray[np.bool_]]]]:
    """Frames and their masks, from the store."""
    for frame, arrays in store.reader(PRODUCT):
        yield frame, masks_from_arrays(arrays, session)


def never_empty(store: StageStore) -> tuple[str, ...]:
    """Cameras of whose picture a part was never seen empty, so that outlines there are guesses."""
    return tuple(store.reader(PRODUCT).attrs.get("never_empty", ()))
