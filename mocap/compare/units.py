"""Units of length told by the size of a body: metres, centimetres or millimetres, and mistakes of them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mocap.data import Motion

Array = NDArray[np.float64]


def length_unit(landmarks: Array) -> str:
    """The unit in which these landmarks have the size of a human body: "m", "cm", "mm" or "unknown".

    landmarks : (T, M, 3), NaN = unknown. The median root-mean-square distance of the landmarks from their
    centroid is 0.3-0.6 m for any usual pose; the limits leave room for infants and giants.
    """
    x = np.asarray(landmarks, dtype=np.float64)
    known = np.all(np.isfinite(x), axis=2)
    enough = known.sum(axis=1) >= 5
    if not enough.any():
        return "unknown"
    x, known = x[enough], known[enough]
    count = known.sum(axis=1)
    filled = np.where(known[:, :, None], x, 0.0)
    centroid = filled.sum(axis=1) / count[:, None]
    squares = np.where(known, ((filled - centroid[:, None]) ** 2).sum(axis=2), 0.0)
    size = float(np.median(np.sqrt(squares.sum(axis=1) / count)))
    for unit_name, metres in (("m", 1.0), ("cm", 0.01), ("mm", 0.001)):
        if 0.12 <= size * metres < 1.2:
            return unit_name
    return "unknown"


def unit_warning(estimate: Sequence[Motion], truth: Sequence[Motion]) -> str | None:
    """A warning when bodies that should be in metres have the size of bodies in another unit."""
    units_of = {
        name: {length_unit(m.landmarks) for m in motions} - {"m", "unknown"}
        for name, motions in (("estimate", estimate), ("truth", truth))
    }
    wrong = [f"the {name} looks like {'/'.join(sorted(units))}" for name, units in units_of.items() if units]
    if not wrong:
        return None
    units = sorted({u for units in units_of.values() for u in units})
    return (
        f"unit mistake: {' and '.join(wrong)} read as m; a body of that size does not exist. "
        f"Remedy: name the unit (--estimate-unit or --truth-unit {units[0]}), or write the file in metres"
    )
