"""Places in camera pictures, tinted: where something can stand in front of people."""

from __future__ import annotations

from collections.abc import Mapping

import cv2
import numpy as np
from numpy.typing import NDArray

from mocap.view.overlay import Colour, contact_sheet, draw_mask

Image = NDArray[np.uint8]
Mask = NDArray[np.bool_]

PLACE_COLOUR: Colour = (230, 120, 0)
_QUALITY = 80


def draw_places(pictures: Mapping[str, Image], places: Mapping[str, Mask]) -> bytes:
    """Pictures side by side with their places tinted, and the share of each, as one JPEG.

    pictures : camera -> (H, W, 3) uint8 RGB.  places : camera -> (H, W) bool, of the cameras to draw.
    """
    sheet = contact_sheet(
        [draw_mask(pictures[name], place, PLACE_COLOUR) for name, place in places.items()],
        [f"{name}: {place.mean():.0%} of the picture" for name, place in places.items()],
    )
    ok, data = cv2.imencode(
        ".jpg", cv2.cvtColor(sheet, cv2.COLOR_RGB2BGR), (cv2.IMWRITE_JPEG_QUALITY, _QUALITY)
    )
    assert ok
    return data.tobytes()
