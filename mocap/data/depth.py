"""Depth maps: what their numbers and pixels are, and how far they are to be trusted."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mocap.arrays import Array


@dataclass(frozen=True)
class DepthUnits:
    """How depth maps are stored.

    unit_mm : millimetres along the optical axis that a number of 1 stands for.  scale : pixels of the map per pixel of
    the camera's pictures, onto which the map is registered.
    """

    unit_mm: float = 1.0
    scale: float = 1.0

    def size_of(self, size: tuple[int, int]) -> tuple[int, int]:
        """(width, height) px of the maps of a camera whose pictures have a size."""
        return round(size[0] * self.scale), round(size[1] * self.scale)


@dataclass(frozen=True)
class DepthNoise:
    """Standard deviation of a reading: base_m + growth_per_m * depth^2, as triangulating and time-of-flight cameras
    have it."""

    base_m: float = 0.003
    growth_per_m: float = 0.0015

    def std_m(self, depth_m: Array) -> Array:
        """Standard deviations (...,) m of readings (...,) m."""
        return np.asarray(self.base_m + self.growth_per_m * np.square(depth_m))
