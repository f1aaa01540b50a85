"""Samples of the silhouettes: foreground pixels on a lattice, with their colours."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mocap.arrays import Mask
from mocap.data.pixels import SilhouettePixels, lattice_step
from mocap.foreground import _kernels


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
        shape = (-(-mask.shape[0] // step) * -(-mask.shape[1] // step),)
        place, colour = np.empty((*shape, 2), dtype=np.int16), np.empty((*shape, 3), dtype=np.uint8)
        # Read-only arrays would make the compiler build the kernel a second time.
        own, picture = np.require(mask, np.bool_, ("C", "W")), np.require(pictures[c], np.uint8, ("C", "W"))
        n = _kernels.lattice_colours(own, picture, step, place, colour)
        cameras.append(np.full(n, c, dtype=np.uint8))
        places.append(place[:n])
        colours.append(colour[:n])
    return SilhouettePixels(
        np.concatenate([*cameras, np.zeros(0, dtype=np.uint8)]),
        np.concatenate([*places, np.zeros((0, 2), dtype=np.int16)]),
        np.concatenate([*colours, np.zeros((0, 3), dtype=np.uint8)]),
    )
