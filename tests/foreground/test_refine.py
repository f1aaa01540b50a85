"""GrabCut from a guess: a known outline is found again; edge cases come back unchanged."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from mocap.foreground import grey_outline, refine_mask

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


def test_a_grey_shirt_before_a_wall_as_bright_is_found_by_its_edges() -> None:
    """It is as bright as the wall within eight levels, and a band of it and its rim were missed."""
    rng = np.random.default_rng(7)
    truth = np.kron(scene(0)[1], np.ones((5, 5))).astype(bool)  # 640 x 480
    empty = np.full(truth.shape, 120.0)
    shirt, trousers, band = truth.copy(), truth.copy(), truth.copy()
    shirt[250:], trousers[:250] = False, False
    band[:150], band[172:] = False, False
    shown = np.where(trousers, 60.0, np.where(shirt, 128.0, empty)) + rng.normal(0, 1.5, truth.shape)
    found = grown(truth, -3) & ~band
    again = grey_outline(shown.clip(0, 255).astype(np.uint8), empty.astype(np.uint8), found)
    assert np.count_nonzero(again & band) > 0.9 * np.count_nonzero(band)
    assert iou(again, truth) > 0.99 > iou(found, truth) + 0.1
    assert not np.any(again & ~grown(truth, 1))


def test_far_from_a_grey_mask_nothing_is_added() -> None:
    """Shade as dark as he is, half a metre beside him."""
    truth = np.kron(scene(0)[1], np.ones((5, 5))).astype(bool)
    shade = np.roll(truth, 200, axis=1)
    shown = np.where(truth | shade, 80, 120).astype(np.uint8)
    again = grey_outline(shown, np.full_like(shown, 120), truth)
    assert np.array_equal(again, truth)


def test_who_is_in_no_mask_is_nobody_without_colours_either() -> None:
    image, truth = scene(1)
    grey = np.ascontiguousarray(image[..., 1])
    nobody = np.zeros_like(truth)
    assert not grey_outline(grey, grey, nobody).any()
