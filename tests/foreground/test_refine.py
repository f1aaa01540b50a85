"""GrabCut near a prior: a known outline is found again; edge cases come back unchanged."""

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
def test_a_hull_that_is_too_large_shrinks_to_the_person(seed: int) -> None:
    image, truth = scene(seed)
    prior = grown(truth, 3)
    refined = refine_mask(image, prior)
    assert iou(prior, truth) < 0.85
    assert iou(refined, truth) > 0.97
    np.testing.assert_array_equal(refined, refine_mask(image, prior))


def test_a_mask_with_a_gap_is_completed_inside_the_prior_only() -> None:
    image, truth = scene(5)
    mask = truth.copy()
    mask[50:64] = False
    prior = grown(truth, 3)
    prior[:25] = False
    refined = refine_mask(image, prior, mask)
    assert np.count_nonzero(refined[50:64] & truth[50:64]) > 0.9 * np.count_nonzero(truth[50:64])
    assert not np.any(refined & ~prior)


def test_what_cannot_be_refined_comes_back() -> None:
    image, truth = scene(6)
    nothing = np.zeros((H, W), dtype=bool)
    assert not refine_mask(image, nothing).any()
    thin = nothing.copy()
    thin[40, 20:60] = True
    np.testing.assert_array_equal(refine_mask(image, thin), thin)
    np.testing.assert_array_equal(refine_mask(image, nothing, truth), truth)
    np.testing.assert_array_equal(refine_mask(image, ~nothing), ~nothing)


def test_mistakes_are_named() -> None:
    image, truth = scene(7)
    with pytest.raises(ValueError, match="prior: expected bool of shape"):
        refine_mask(image, truth[:-1])
    with pytest.raises(ValueError, match="mask: expected bool"):
        refine_mask(image, truth, truth.astype(np.uint8))
    with pytest.raises(ValueError, match="image: expected"):
        refine_mask(image[:, :, 0], truth)
