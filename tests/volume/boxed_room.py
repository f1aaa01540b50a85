"""A room of boxes as depth cameras would measure it: exact distances, and noise on them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mocap.data import Camera
from mocap.data.depth import DepthNoise
from mocap.volume.measured_room import RoomView

Array = NDArray[np.float64]
Box = tuple[tuple[float, float, float], tuple[float, float, float]]

# A cabinet, a bench and a column: no turn about the vertical takes one onto another.
FURNITURE: tuple[Box, ...] = (
    ((0.6, -0.3, 0.0), (1.0, 0.5, 1.2)),
    ((-0.9, -0.8, 0.0), (0.3, -0.4, 0.45)),
    ((-0.5, 0.6, 0.0), (-0.25, 0.85, 1.7)),
)
FLOOR: Box = ((-4.0, -4.0, -0.1), (4.0, 4.0, 0.0))


def camera_at(name: str, turn_deg: float, *, size: tuple[int, int] = (160, 120), k1: float = -0.05) -> Camera:
    """A camera 3 m from the middle and 1.8 m above the floor that looks at it."""
    a = np.radians(turn_deg)
    place = np.array([3.0 * np.cos(a), 3.0 * np.sin(a), 1.8])
    ahead = np.array([0.0, 0.0, 0.5]) - place
    ahead /= np.linalg.norm(ahead)
    right = np.cross(ahead, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    R = np.array([right, np.cross(ahead, right), ahead])
    f = 0.9 * size[0]
    K = np.array([[f, 0.0, (size[0] - 1) / 2], [0.0, f, (size[1] - 1) / 2], [0.0, 0.0, 1.0]])
    return Camera(name, size, K, np.array([k1, 0.0, 0.0, 0.0]), R, -R @ place)


def view_of(camera: Camera, boxes: Sequence[Box], *, rng: np.random.Generator | None = None) -> RoomView:
    """What the camera measures of boxes, each of a grey of its own; with an rng the noise of a fifth of a look."""
    w, h = camera.size
    uv = np.stack(np.meshgrid(np.arange(w), np.arange(h)), axis=-1).reshape(-1, 2).astype(np.float64)
    rays, origin = camera.rays(uv), camera.center
    nearest, grey = np.full(len(uv), np.inf), np.zeros(len(uv), dtype=np.uint8)
    for number, (lower, upper) in enumerate(boxes):
        with np.errstate(divide="ignore"):
            sides = np.stack([(np.array(lower) - origin) / rays, (np.array(upper) - origin) / rays])
        enters, leaves = sides.min(axis=0).max(axis=1), sides.max(axis=0).min(axis=1)
        hits = (enters < leaves) & (enters > 0) & (enters < nearest)
        nearest[hits], grey[hits] = enters[hits], 60 + 40 * number
    depth = np.where(np.isfinite(nearest), nearest * (rays @ camera.R[2]), 0.0)
    if rng is not None:
        depth += np.where(depth > 0, 0.2 * DepthNoise().std_m(depth) * rng.standard_normal(depth.shape), 0.0)
    rgb = np.repeat(grey.reshape(h, w, 1), 3, axis=2)
    return RoomView(camera, depth.reshape(h, w).astype(np.float32), rgb)
