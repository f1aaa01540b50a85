"""GrabCut from a guess: a known outline is found again; edge cases come back unchanged."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from mocap.foreground import refine_mask

H, W = 96, 128


def scene(seed: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    truth = np.zeros((H, W), np.uint8)
    cv2.ellipse(truth, (60, 50), (16, 32), 10, 0, 360, 1, -1)
    image = np.where(truth[:, :, None] > 0, (150.0, 60.0, 50.0), (110.0, 115.0, 100.0))
    return np.clip(image + rng.normal(0, 6, image.shape), 0, 255).astype(np.uint8), truth.astype(bool)


def grown(mask: np.ndarray, px: int) -> np.ndarray:
    square = np.ones((2 * abs(px) + 1,) * 2, np.uint8)
    change = cv2.dilate if px > 0 else cv2.erode
    return change(mask.astype(np.uint8), square).astype(bool)


def iou(a: np.ndarray, b: np.ndarray) -> float:
    return np.count_nonzero(a & b) / np.count_nonzero(a | b)


@pytest.mark.parametrize("seed", range(3))
def test_a_guess_that_is_too_large_shrinks_to_the_person(seed: int) -> None:
    image, truth = scene(seed)
    allowed = grown(truth, 6)
    guess = grown(truth, 3)
    refined = refine_mask(image, allowed, guess)
    assert iou(guess, truth) < 0.85
    assert iou(refined, truth) > 0.97
    np.testing.assert_array_equal(refined, refine_mask(image, allowed, guess))


def test_a_guess_with_a_gap_is_completed_inside_what_is_allowed_only() -> None:
    image, truth = scene(5)
    guess = truth.copy()
    guess[50:64] = False
    allowed = grown(truth, 3)
    allowed[:25] = False
    refined = refine_mask(image, allowed, guess)
    assert np.count_nonzero(refined[50:64] & truth[50:64]) > 0.9 * np.count_nonzero(truth[50:64])
    assert not np.any(refined & ~allowed)


def test_what_is_sure_stays_whatever_its_colour() -> None:
    """Trousers of the floor's colour: colours and edges give them away, what others know does not."""
    image, truth = scene(6)
    alike = truth.copy()
    alike[:54] = False
    image[54:][alike[54:]] = image[:10].reshape(-1, 3)[: np.count_nonzero(alike)]
    allowed, sure = grown(truth, 6), grown(truth, -5)
    lost = refine_mask(image, allowed, truth)
    kept = refine_mask(image, allowed, truth, sure)
    assert not lost[alike & sure].any()
    assert kept[sure].all()
    assert not refine_mask(image, allowed & ~alike, truth, sure)[alike].any()


def test_what_cannot_be_refined_comes_back() -> None:
    image, truth = scene(6)
    nothing = np.zeros((H, W), dtype=bool)
    assert not refine_mask(image, nothing, truth).any()
    assert not refine_mask(image, truth, nothing).any()
    np.testing.assert_array_equal(refine_mask(image, ~nothing, ~nothing), ~nothing)


def test_shapes_are_checked() -> None:
    image, truth = scene(6)
    with pytest.raises(ValueError, match="allowed"):
        refine_mask(image, truth[:-1], truth)
    with pytest.raises(ValueError, match="likely"):
        refine_mask(image, truth, truth.astype(np.uint8))
    with pytest.raises(ValueError, match="sure"):
        refine_mask(image, truth, truth, truth[:, 1:])
    with pytest.raises(ValueError, match="image"):
        refine_mask(image[:, :, 0], truth, truth)
