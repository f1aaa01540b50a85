"""Occluders: a depth map per camera of what stands still before people, behind which the camera cannot judge."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mocap.arrays import Array
from mocap.data.camera import Camera, CameraRig

DepthMap = NDArray[np.float32]
Mask = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Occluders:
    """What hides people from cameras.

    depth_m : camera name -> (h, w) float32, per cell of cell_px x cell_px picture pixels the depth (along the optical
    axis) of the nearest thing that stands there, m; inf where nothing is known to stand.
    """

    depth_m: Mapping[str, DepthMap]
    cell_px: int

    @property
    def is_empty(self) -> bool:
        """Whether nothing is known to stand anywhere."""
        return not any(np.isfinite(depth).any() for depth in self.depth_m.values())

    @property
    def shares(self) -> dict[str, float]:
        """Share of each camera's picture in which something stands."""
        return {name: float(np.isfinite(depth).mean()) for name, depth in self.depth_m.items()}

    def of(self, camera: Camera) -> DepthMap | None:
        """The map of a camera, or None when nothing is known to stand in its picture."""
        depth = self.depth_m.get(camera.name)
        return depth if depth is not None and bool(np.isfinite(depth).any()) else None

    def hides(self, camera: Camera, points_world: Array) -> NDArray[np.bool_]:
        """Whether points (N, 3) m lie behind something in this camera, (N,) bool; False outside its picture."""
        if self.of(camera) is None:
            return np.zeros(len(points_world), dtype=np.bool_)
        return self.hides_at(camera, *camera.project(points_world))

    def hides_at(self, camera: Camera, uv: Array, depth: Array) -> NDArray[np.bool_]:
        """The same for points of which it is known where they are in the picture, (N, 2) px, and how deep, (N,) m."""
        is_hidden = np.zeros(len(uv), dtype=np.bool_)
        own = self.of(camera)
        if own is None:
            return is_hidden
        inside = camera.contains(uv)
        cell = np.floor(uv[inside] + 0.5).astype(np.int64) // self.cell_px
        cell = np.clip(cell, 0, np.array(own.shape[::-1]) - 1)
        is_hidden[inside] = depth[inside] > own[cell[:, 1], cell[:, 0]]
        return is_hidden

    def hidden_pixels(self, camera: Camera, points_world: Array) -> Mask | None:
        """Pixels (H, W) bool in which somebody at points (N, 3) m is behind something; None when there are none.

        He counts as one depth, the median of his points'.
        """
        own = self.of(camera)
        if own is None or len(points_world) == 0:
            return None
        cells = own < np.median(points_world @ camera.R[2] + camera.t[2])
        if not cells.any():
            return None
        return self._on_picture(camera, cells)

    def standing_pixels(self, camera: Camera) -> Mask:
        """Pixels (H, W) bool in which something can stand in front of people, at whatever depth."""
        own = self.of(camera)
        if own is None:
            return np.zeros(camera.size[::-1], dtype=np.bool_)
        return self._on_picture(camera, np.isfinite(own))

    def _on_picture(self, camera: Camera, cells: Mask) -> Mask:
        width, height = camera.size
        rows = np.minimum(np.arange(height) // self.cell_px, cells.shape[0] - 1)
        columns = np.minimum(np.arange(width) // self.cell_px, cells.shape[1] - 1)
        return cells[np.ix_(rows, columns)]


def n_judges(rig: CameraRig, points_world: Array, occluders: Occluders | None) -> NDArray[np.int64]:
    """How many cameras have each point (N, 3) m in their picture with nothing known to stand before it, (N,)."""
    n = np.zeros(len(points_world), dtype=np.int64)
    for camera in rig:
        n += camera.contains(camera.project(points_world)[0])
        if occluders is not None:
            n -= occluders.hides(camera, points_world)
    return n
