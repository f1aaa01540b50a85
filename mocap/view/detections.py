"""Marker detections drawn over a picture."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from mocap.data.camera import Camera

Array = NDArray[np.float64]
Image = NDArray[np.uint8]

DETECTION_COLOUR = (255, 214, 0)
_OUTLINE = (20, 20, 20)


def draw_detections(image: Image, camera: Camera, uv: Array) -> Image:
    """A ring around every detection.

    image : (H, W, 3) uint8 RGB, a copy is returned.  uv : (n, 2) raw px; those that are NaN or outside are left out.
    Raises ValueError when the picture is not of the camera's size.
    """
    if image.shape[:2] != camera.size[::-1]:
        raise ValueError(f"the picture has shape {image.shape[:2]}, camera {camera.name} {camera.size[::-1]}")
    out = np.ascontiguousarray(image).copy()
    radius = max(2, round(camera.size[1] / 160))
    for u, v in uv[camera.contains(uv)]:
        center = (round(float(u)), round(float(v)))
        cv2.circle(out, center, radius + 1, _OUTLINE, 1, cv2.LINE_AA)
        cv2.circle(out, center, radius, DETECTION_COLOUR, 1, cv2.LINE_AA)
    return out
