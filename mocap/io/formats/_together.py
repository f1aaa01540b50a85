"""Several persons of one recording on one axis of time, as formats want it that hold them all."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mocap.data import Motion
from mocap.io.formats._writing import Array


@dataclass(frozen=True, eq=False)
class Together:
    """Persons over the frames from the first to the last that anybody was followed in.

    frames : (T,).  time_s : (T,), from the recording's beginning.  names : the M landmarks.
    places, std : (P, T, M, 3) m, world; NaN where a person was not followed or nothing is known.
    observed : (P, T, M), 1 or 0; NaN where a person was not followed.
    """

    frames: NDArray[np.int64]
    time_s: Array
    names: tuple[str, ...]
    places: Array
    std: Array
    observed: Array


def together(motions: Sequence[Motion], fps: float) -> Together:
    """Bring the motions (at least one) of a run onto one axis of time.  Bodies without feet lack those landmarks."""
    names = max((m.names for m in motions), key=len)
    frames = np.arange(min(m.frames.min() for m in motions), max(m.frames.max() for m in motions) + 1)
    shape = (len(motions), len(frames), len(names), 3)
    places, std, observed = np.full(shape, np.nan), np.full(shape, np.nan), np.full(shape[:3], np.nan)
    for p, motion in enumerate(motions):
        rows, known = motion.frames - frames[0], slice(0, len(motion.names))
        places[p, rows, known] = motion.landmarks
        if motion.std is not None:
            std[p, rows, known] = motion.std
        if motion.observed is not None:
            observed[p, rows, known] = motion.observed
    return Together(frames, frames / fps, names, places, std, observed)
