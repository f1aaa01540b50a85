"""Colour models of persons: YCbCr histograms, and how alike two of them are."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mocap.tracking import _kernels

Array = NDArray[np.floating]

BINS_PER_CHANNEL = 21
N_BINS = BINS_PER_CHANNEL**3
# Legs, trunk, head: shares of the height of the person at which one band ends and the next begins.
BANDS = (0.5, 0.82)
N_BANDS = len(BANDS) + 1


def colour_bins(rgb: NDArray[np.uint8], has_colour: NDArray[np.bool_]) -> NDArray[np.int32]:
    """Bin of each colour in the joint YCbCr histogram, 21 bins per channel; -1 without a colour.

    rgb : (N, 3) uint8.  has_colour : (N,) bool.  Returns (N,) int32 in -1 .. 9260.  Source: CF 4.3.2.
    """
    out = np.empty(len(rgb), dtype=np.int32)
    _kernels.colour_bins(rgb, has_colour, BINS_PER_CHANNEL, out)
    return out


def banded_histogram(
    bins: NDArray[np.int32], centers: Array, rows: NDArray[np.int64], top_m: float | None = None
) -> tuple[Array, int]:
    """Histogram of some voxels by height band and colour, (3, 9261), sum 1, and the number of coloured voxels.

    bins : (N,) as of colour_bins.  centers : (N, 3) m.  rows : (n,) indices of the voxels.
    Bands are shares of the height of the highest of them, top_m if that is known.  No coloured voxel gives zeros and 0.
    """
    histogram = np.zeros((N_BANDS, N_BINS), dtype=np.float32)
    if not len(rows):
        return histogram, 0
    rows = np.asarray(rows, dtype=np.int64)
    edges = np.array(BANDS) * (float(centers[rows, 2].max()) if top_m is None else top_m)
    n = _kernels.add_histogram(bins, centers, rows, edges, histogram)
    if n:
        histogram /= n
    return histogram, int(n)


def bhattacharyya(p: Array, q: Array) -> float:
    """Bhattacharyya coefficient of two histograms of one shape: 1 = equal, 0 = nothing in common.

    Source: CF Eq. 4.10, where it is called a distance; as a likelihood it must be large where colours agree.
    """
    return float(np.sqrt(p * q).sum())


def adapt(reference: Array, observed: Array, adaptation: float) -> Array:
    """The reference histogram after a frame: adaptation * reference + (1 - adaptation) * observed. CF Eq. 4.11."""
    out = np.empty_like(reference)
    _kernels.mix(reference.ravel(), observed.ravel(), adaptation, out.ravel())
    return out


def similar_colours(reference: Array, share: float = 0.8) -> NDArray[np.bool_]:
    """Colours that make up `share` of a histogram (n_bins,), the most frequent first; (n_bins,) bool.

    An empty histogram holds no colour.  Source: CF 4.3.3, the variable threshold of Eq. 4.21.
    """
    return np.asarray(reference >= similar_threshold(reference, share))


def similar_threshold(reference: Array, share: float = 0.8) -> float:
    """Value of a histogram from which on a colour is one of similar_colours; infinite of an empty one."""
    total = float(reference.sum())
    if total <= 0.0:
        return np.inf
    values = -np.sort(-reference[reference > 0])
    cumulative = np.cumsum(values, dtype=np.float64)
    # The last colour that is needed to reach the share still counts; so do its equals.
    last = min(int(np.searchsorted(cumulative, share * total - 1e-9)), len(values) - 1)
    return float(values[last])
