"""2D marker detections of a session: where every camera saw something that looks like a marker, and when."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from mocap.arrays import Array


@dataclass(frozen=True, eq=False)
class Detections:
    """Unlabelled detections of a rig.

    names : C camera names, in rig order.  frame : C arrays (n,) int64, ascending.  uv : C arrays (n, 2) raw px.
    """

    names: tuple[str, ...]
    frame: tuple[NDArray[np.int64], ...]
    uv: tuple[Array, ...]

    def __post_init__(self) -> None:
        if not len(self.names) == len(self.frame) == len(self.uv):
            raise ValueError(
                f"{len(self.names)} names, {len(self.frame)} frame arrays and {len(self.uv)} uv arrays"
            )
        for name, frame, uv in zip(self.names, self.frame, self.uv, strict=True):
            if uv.shape != (len(frame), 2):
                raise ValueError(f"camera {name}: uv has shape {uv.shape}, expected ({len(frame)}, 2)")
            if np.any(np.diff(frame) < 0):
                raise ValueError(f"camera {name}: frames are not ascending")

    def at(self, frame: int) -> list[Array]:
        """Detections of one frame, one (n, 2) array per camera."""
        return [
            uv[np.searchsorted(f, frame, "left") : np.searchsorted(f, frame, "right")]
            for f, uv in zip(self.frame, self.uv, strict=True)
        ]

    @cached_property
    def n_total(self) -> int:
        return sum(len(f) for f in self.frame)
