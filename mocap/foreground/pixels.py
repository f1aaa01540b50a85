"""Samples of the silhouettes: foreground pixels on a lattice, with their colours."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mocap.arrays import Mask
from mocap.data.pixels import SilhouettePixels, lattice_step


def sample_silhouettes(
    masks: Sequence[Mask],
    pictures: Sequence[NDArray[np.uint8]] | None,
    used: Sequence[bool] | NDArray[np.bool_] | None = None,
) -> SilhouettePixels:
    """Foreground pixels on a lattice, with the mean colour of the 3 x 3 pixels around them.

    masks : (H, W) bool per camera.  pictures : (H, W, 3) uint8 RGB per camera; None gives no pixels.  used : (C,),
    cameras to take; None = all.
    """
    cameras, places, colours = [], [], []
    for c, mask in enumerate(masks):
        if pictures is None or (used is not None and not used[c]):
            continue
        step = lattice_step(mask.shape[1])
        first = max(1, step // 2)
        row, col = np.nonzero(mask[first:-1:step, first:-1:step])
        row, col = first + step * row, first + step * col
        around = [pictures[c][row + dv, col + du].astype(np.uint16) for dv in (-1, 0, 1) for du in (-1, 0, 1)]
        cameras.append(np.full(len(row), c, dtype=np.uint8))
        places.append(np.column_stack([col, row]).astype(np.int16))
        colours.append((np.sum(around, axis=0) // 9).astype(np.uint8))
    return SilhouettePixels(
        np.concatenate([*cameras, np.zeros(0, dtype=np.uint8)]),
        np.concatenate([*places, np.zeros((0, 2), dtype=np.int16)]),
        np.concatenate([*colours, np.zeros((0, 3), dtype=np.uint8)]),
    )
