"""Detections drawn over a picture."""

from __future__ import annotations

import numpy as np
import pytest
from marker_world import ring

from mocap.view.detections import DETECTION_COLOUR, draw_detections

CAMERA = ring(2)[0]
GREY = np.full((*CAMERA.size[::-1], 3), 90, dtype=np.uint8)


def test_rings_stand_around_the_detections_and_nowhere_else() -> None:
    uv = np.array([[40.0, 50.0], [200.3, 120.8], [np.nan, 3.0], [-50.0, 10.0]])
    drawn = draw_detections(GREY, CAMERA, uv)
    changed = np.argwhere((drawn != GREY).any(axis=2))[:, ::-1]
    distance = np.linalg.norm(changed[:, None] - uv[None, :2], axis=2).min(axis=1)
    assert distance.max() < 6.0
    assert distance.min() > 0.5  # the middle stays free: what was detected is still seen
    assert (drawn == DETECTION_COLOUR).all(axis=2).any()


def test_the_picture_itself_stays_as_it_is() -> None:
    before = GREY.copy()
    draw_detections(GREY, CAMERA, np.array([[40.0, 50.0]]))
    np.testing.assert_array_equal(GREY, before)
    np.testing.assert_array_equal(draw_detections(GREY, CAMERA, np.zeros((0, 2))), GREY)


def test_a_picture_of_another_size_is_refused() -> None:
    with pytest.raises(ValueError, match="the picture has shape"):
        draw_detections(GREY[:-1], CAMERA, np.zeros((0, 2)))
