"""Errors of tracked polygons as the decomposition papers count them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def corner_error(corners: Array, truth: Array) -> Array:
    """Sum over all corners of the distance to the true corner, px.

    corners, truth : (..., S, 2) px, corners of all parts in the same order. Returns (...,): one number per frame when
    the first axis counts frames. A NaN corner gives NaN.
    Source: XN 4.4.2; SW 6.2 (their tables give the mean of this sum over frames and runs).
    """
    if corners.shape[-1] != 2 or corners.shape[-2:] != truth.shape[-2:]:
        raise ValueError(
            f"corners: expected {(*truth.shape[-2:],)} as in truth, got {(*corners.shape[-2:],)}"
        )
    return np.linalg.norm(corners - truth, axis=-1).sum(axis=-1)
