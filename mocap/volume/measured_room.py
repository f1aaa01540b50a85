"""What depth cameras measure of a room: clouds of points, and the room as it stands still behind the people."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from mocap.data import Camera
from mocap.data.depth import DepthNoise
from mocap.data.mesh import ColouredCloud

DepthMap = NDArray[np.float32]
Image = NDArray[np.uint8]

# A reading whose neighbours lie further apart than this, and so many deviations, is of an edge: it may mix what lies
# before with what lies behind. A floor 4 m away steps by 1 to 2 cm from pixel to pixel.
_EDGE_M, _EDGE_STDS = 0.05, 4.0
_LEAST_SHARE = 0.5  # of the looks in which a pixel must have a reading


@dataclass(frozen=True, eq=False)
class RoomView:
    """What one camera has measured.  depth_m : (H, W) float32 m along the optical axis, 0 = no reading.
    rgb : (H, W, 3) uint8, its picture."""

    camera: Camera
    depth_m: DepthMap
    rgb: Image


def still_reading(maps: Sequence[DepthMap]) -> DepthMap:
    """The middle reading (H, W) m of each pixel over looks at (H, W) m; 0 where fewer than half have a reading.

    People who walk are in few of the looks at a pixel, and vanish; who stays for half of them does not. Noise goes down
    with the number of looks. Raises ValueError for no look.
    """
    if not maps:
        raise ValueError("maps must hold at least one look, got none")
    stack = np.sort(np.where(np.asarray(maps) > 0, maps, np.float32(np.inf)), axis=0)
    n = np.isfinite(stack).sum(axis=0)
    middle = np.take_along_axis(stack, np.maximum(n - 1, 0)[None] // 2, axis=0)[0]
    return np.where(n >= _LEAST_SHARE * len(maps), middle, np.float32(0)).astype(np.float32)


def without_edges(depth_m: DepthMap, noise: DepthNoise) -> DepthMap:
    """The map (H, W) m without readings at edges, which may lie where nothing is."""
    kernel = np.ones((3, 3), np.uint8)
    farthest = cv2.dilate(depth_m, kernel)
    nearest = cv2.erode(np.where(depth_m > 0, depth_m, np.float32(np.inf)), kernel)
    with np.errstate(invalid="ignore"):
        is_edge = farthest - nearest > _EDGE_M + _EDGE_STDS * noise.std_m(depth_m.astype(np.float64))
    return np.where(is_edge, np.float32(0), depth_m)


def cloud_of(view: RoomView) -> ColouredCloud:
    """One point for every reading of a view, in the world; a view without readings gives none."""
    v, u = np.nonzero(view.depth_m > 0)
    uv = np.column_stack([u, v]).astype(np.float64)
    points = view.camera.unproject(uv, view.depth_m[v, u].astype(np.float64))
    return ColouredCloud(points, view.rgb[v, u])


def together(clouds: Sequence[ColouredCloud]) -> ColouredCloud:
    """All points of some clouds."""
    none = ColouredCloud(np.zeros((0, 3)), np.zeros((0, 3), dtype=np.uint8))
    every = (none, *clouds)
    return ColouredCloud(np.concatenate([c.points for c in every]), np.concatenate([c.rgb for c in every]))
