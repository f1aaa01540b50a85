"""Colour marker detector on drawn pictures: yellow discs before a brownish room."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from mocap.foreground.marker_detector import (
    MarkerColour,
    MarkerDetectorSettings,
    detect_markers,
    learn_marker_colour,
)

H, W = 96, 132
YELLOW, SKIN, BLUE = (214, 190, 20), (190, 140, 120), (30, 60, 190)
CENTERS = np.array([[20.0, 15.0], [61.4, 30.7], [100.0, 44.0], [33.0, 70.2], [90.5, 80.0], [118.0, 20.0]])
# A patch is made of whole pixels, and discs are drawn to a quarter of one: its centroid is within half a pixel.
CENTER_TOLERANCE_PX = 0.5


def picture(
    centers: np.ndarray = CENTERS, radius: float = 3.0, *, brightness: float = 1.0, seed: int = 0
) -> np.ndarray:
    """Discs over skin and a blue patch, with noise; drawn at four times the size."""
    canvas = np.full((4 * H, 4 * W, 3), (120, 100, 90), dtype=np.float32)
    canvas[200:330, 200:380] = SKIN
    canvas[20:110, 300:340] = BLUE
    for u, v in centers:
        cv2.circle(canvas, (round(4 * u + 1.5), round(4 * v + 1.5)), round(4 * radius), YELLOW, -1)
    small = cv2.resize(canvas, (W, H), interpolation=cv2.INTER_AREA) * brightness
    noise = np.random.default_rng(seed).normal(0.0, 2.0, small.shape)
    return np.clip(small + noise, 0, 255).astype(np.uint8)


def learnt() -> MarkerColour:
    return learn_marker_colour([picture()], [CENTERS])


def test_all_discs_are_found_where_they_are_and_nothing_else() -> None:
    found = detect_markers(picture(seed=1), learnt(), MarkerDetectorSettings())
    assert len(found) == len(CENTERS)
    distance = np.linalg.norm(CENTERS[:, None] - found[None], axis=2).min(axis=1)
    assert distance.max() < CENTER_TOLERANCE_PX


def test_a_little_less_light_is_borne() -> None:
    """Chroma shrinks with the light, by 4 units here; noise alone makes up some 2."""
    found = detect_markers(picture(brightness=0.95, seed=2), learnt(), MarkerDetectorSettings())
    assert len(found) == len(CENTERS)


def test_labels_beside_a_few_markers_do_no_harm() -> None:
    labels = CENTERS.copy()
    labels[0] += [12.0, 3.0]
    colour = learn_marker_colour([picture()], [labels])
    assert np.linalg.norm(colour.mean - learnt().mean) < 5.0


def test_gaussian_is_the_mean_and_covariance_of_uniform_patches() -> None:
    """Large patches: the closed form is the colour itself."""
    image = picture(radius=8.0)
    colour = learn_marker_colour([image], [CENTERS[:3]])
    expected = cv2.cvtColor(np.array([[YELLOW]], dtype=np.uint8), cv2.COLOR_RGB2YCrCb)[0, 0, 1:]
    np.testing.assert_allclose(colour.mean, expected, atol=1.5)
    at = tuple(np.round(colour.mean).astype(int))
    assert colour.distances[at] < 0.5
    assert colour.distances.shape == (256, 256)


def test_area_limits() -> None:
    centers = np.array([[30.0, 20.0], [90.0, 70.0]])
    both = picture(centers[1:], 7.0)
    both[:50] = picture(centers[:1], 2.0)[:50]
    small = detect_markers(both, learnt(), MarkerDetectorSettings(max_area_px=60))
    large = detect_markers(both, learnt(), MarkerDetectorSettings(min_area_px=60))
    assert len(small) == len(large) == 1
    assert np.linalg.norm(small[0] - centers[0]) < 1.0
    assert np.linalg.norm(large[0] - centers[1]) < 1.0


def test_a_picture_without_markers_gives_none() -> None:
    found = detect_markers(picture(np.zeros((0, 2))), learnt(), MarkerDetectorSettings())
    assert found.shape == (0, 2)


def test_wrong_input_is_named() -> None:
    with pytest.raises(ValueError, match="0 labelled pixels"):
        learn_marker_colour([picture()], [np.zeros((0, 2))])
    with pytest.raises(ValueError, match="labelled pixels"):
        learn_marker_colour([picture()], [CENTERS[:1]], radius_px=1.0)
    with pytest.raises(ValueError, match="min_area_px <= max_area_px"):
        MarkerDetectorSettings(min_area_px=9, max_area_px=4)
