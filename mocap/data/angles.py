"""Anatomical angles over time: what clinicians read, out of a run or of a truth."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mocap.arrays import Array


@dataclass(frozen=True, eq=False)
class AngleSeries:
    """Anatomical angles of one person over time (`mocap.metrics.anatomy` defines them).

    names : A angles.  frames : (T,) int64, ascending.  time_s : (T,).  values : (T, A) rad, in (-pi, pi], NaN =
    unknown. std : (T, A) rad, or None.  observed : (T, A) bool, whether the frame's data show it, or None.
    """

    person: int
    names: tuple[str, ...]
    frames: NDArray[np.int64]
    time_s: Array
    values: Array
    std: Array | None = None
    observed: NDArray[np.bool_] | None = None

    def __post_init__(self) -> None:
        expected = (len(self.frames), len(self.names))
        if self.values.shape != expected:
            raise ValueError(f"values has shape {self.values.shape}, expected {expected}")

    def __len__(self) -> int:
        return len(self.frames)

    def of(self, name: str) -> Array:
        """The values of one angle, (T,) rad."""
        return self.values[:, self.names.index(name)]
