"""Background statistics and segmentation on pictures with a known person, shadow, gain and noise."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from mocap.foreground import (
    ForegroundSettings,
    Segmenter,
    clean_mask,
    learn_background,
    median_background,
)
from mocap.foreground import _kernels as kernels

H, W = 120, 160
NOISE = 1.5
# A person 20 x 70 px has an outline of 180 px: 10 % of its area. Measured 0.95-0.99 over 20 seeds.
MIN_IOU = 0.9
SETTINGS = ForegroundSettings(min_area_px=600.0)  # 40 px at this size


def wall(rng: np.random.Generator) -> np.ndarray:
    coarse = rng.uniform(90.0, 170.0, (5, 7, 1)) + rng.uniform(-8.0, 8.0, (5, 7, 3))
    return cv2.resize(coarse, (W, H), interpolation=cv2.INTER_CUBIC)


def photograph(scene: np.ndarray, rng: np.random.Generator, gain: float = 1.0) -> np.ndarray:
    return np.clip(scene * gain + rng.normal(0.0, NOISE, scene.shape), 0, 255).astype(np.uint8)


def person_at(column: int) -> np.ndarray:
    mask = np.zeros((H, W), dtype=bool)
    mask[30:100, column : column + 20] = True
    return mask


def with_person(scene: np.ndarray, mask: np.ndarray, colour: tuple[float, float, float]) -> np.ndarray:
    out = scene.copy()
    shadow = np.roll(mask, 25, axis=1).astype(np.float64)
    out *= 1.0 - 0.25 * cv2.GaussianBlur(shadow, (0, 0), 2.0)[:, :, None] * ~mask[:, :, None]
    out[mask] = colour
    return out


def iou(a: np.ndarray, b: np.ndarray) -> float:
    return np.count_nonzero(a & b) / np.count_nonzero(a | b)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("gain", [1.0, 0.9, 1.12])
def test_person_is_found_and_the_shadow_is_not(seed, gain):
    rng = np.random.default_rng(seed)
    scene = wall(rng)
    segmenter = Segmenter(learn_background(photograph(scene, rng) for _ in range(12)), SETTINGS)
    mask = person_at(50)
    answer = segmenter.segment(photograph(with_person(scene, mask, (60.0, 80.0, 140.0)), rng, gain))
    assert iou(answer.mask, mask) > MIN_IOU
    assert not np.any(answer.mask & answer.shadow)
    shadow = np.roll(mask, 25, axis=1)
    assert np.count_nonzero(answer.shadow & shadow) > 0.8 * np.count_nonzero(shadow)
    assert answer.foreground_share == pytest.approx(np.count_nonzero(answer.mask) / (H * W))
    assert answer.is_usable


def test_grey_shirt_before_a_grey_wall_is_not_taken_for_shadow():
    """Four levels of tint, 0.8 of the brightness: each pixel could be shadow, the window says it is not."""
    rng = np.random.default_rng(2)
    scene = np.full((H, W, 3), (140.0, 138.0, 134.0))
    segmenter = Segmenter(learn_background(photograph(scene, rng) for _ in range(12)), SETTINGS)
    mask = person_at(40)
    shirt = with_person(scene, mask, (110.0, 111.0, 115.0))
    shirt[30:45, 40:60] = (40.0, 30.0, 25.0)  # the head: strong
    answer = segmenter.segment(photograph(shirt, rng))
    assert np.count_nonzero(answer.mask & mask) > 0.9 * np.count_nonzero(mask)


def test_empty_picture_gives_an_empty_mask_and_light_drift_is_followed():
    rng = np.random.default_rng(3)
    scene = wall(rng)
    segmenter = Segmenter(learn_background(photograph(scene, rng) for _ in range(12)), SETTINGS)
    for i in range(40):
        answer = segmenter.segment(photograph(scene, rng, 1.0 + 0.005 * i))
        assert answer.foreground_share == 0.0


def test_a_person_who_stands_still_is_never_absorbed_but_the_background_adapts():
    rng = np.random.default_rng(4)
    scene = wall(rng)
    settings = ForegroundSettings(min_area_px=600.0, adaptation=0.05, compensate_gain=False)
    segmenter = Segmenter(learn_background(photograph(scene, rng) for _ in range(12)), settings)
    mask = person_at(90)
    for i in range(150):
        # A corner of the picture drifts by 18 levels: far beyond the threshold if nothing adapted.
        drifted = scene.copy()
        drifted[:, :60] += 0.12 * i
        answer = segmenter.segment(photograph(with_person(drifted, mask, (60.0, 80.0, 140.0)), rng))
    assert iou(answer.mask, mask) > MIN_IOU
    fixed = Segmenter(learn_background(photograph(scene, rng) for _ in range(12)), ForegroundSettings(
        min_area_px=600.0, adaptation=0.0, compensate_gain=False, shadow_brightest=1.0))  # fmt: skip
    assert fixed.segment(photograph(drifted, rng)).foreground_share > 0.2


def test_background_statistics_are_those_of_the_scene():
    rng = np.random.default_rng(5)
    scene = np.clip(wall(rng), 0, 240)
    background = learn_background(photograph(scene, rng) for _ in range(31))
    # 31 truncated samples: mean half a level low, standard error 0.3.
    assert np.abs(background.mean + 0.5 - scene).mean() < 0.4
    assert background.std.mean() == pytest.approx(NOISE, abs=0.3)
    assert background.n_images == 31
    assert background.kind == "clip"
    assert background.warnings == ()


def test_somebody_who_crosses_the_clip_leaves_no_trace():
    rng = np.random.default_rng(6)
    scene = wall(rng)
    pictures = [
        photograph(with_person(scene, person_at(5 + 4 * i), (60.0, 80.0, 140.0)), rng) for i in range(30)
    ]
    background = median_background(pictures)
    assert background.kind == "median"
    assert background.warnings == ()
    assert np.abs(background.mean + 0.5 - scene).max() < 8.0
    assert background.std.max() < 8.0
    crossed = learn_background(pictures)
    assert "something moves" in crossed.warnings[0]


def test_a_person_who_never_moves_is_reported():
    rng = np.random.default_rng(7)
    still_scene = with_person(wall(rng), person_at(60), (60.0, 80.0, 140.0))
    background = median_background(photograph(still_scene, rng) for _ in range(9))
    assert "hardly anything moves" in background.warnings[0]


def test_long_clips_are_thinned_evenly_in_bounded_memory():
    values = []
    background = learn_background(
        np.full((4, 5, 3), i % 200, dtype=np.uint8) if values.append(i) is None else None for i in range(200)
    )
    assert len(values) == 200
    assert 16 <= background.n_images <= 31


def test_one_still_is_enough_but_not_none():
    rng = np.random.default_rng(8)
    scene = wall(rng)
    background = learn_background([photograph(scene, rng)])
    assert background.kind == "still"
    assert background.std.min() >= 1.5
    mask = person_at(70)
    answer = Segmenter(background, SETTINGS).segment(
        photograph(with_person(scene, mask, (60.0, 80.0, 140.0)), rng)
    )
    assert iou(answer.mask, mask) > MIN_IOU
    with pytest.raises(ValueError, match="at least one picture"):
        learn_background([])
    with pytest.raises(ValueError, match="expected shape"):
        learn_background([np.zeros((4, 5, 3), np.uint8), np.zeros((5, 4, 3), np.uint8)])


@pytest.mark.parametrize("method", ["mog2", "knn"])
def test_opencv_models_are_selectable(method):
    rng = np.random.default_rng(9)
    scene = wall(rng)
    settings = ForegroundSettings(method=method, min_area_px=600.0)
    segmenter = Segmenter(learn_background(photograph(scene, rng) for _ in range(12)), settings)
    mask = person_at(50)
    picture = photograph(with_person(scene, mask, (60.0, 80.0, 140.0)), rng)
    for _ in range(30):
        answer = segmenter.segment(picture)
    assert iou(answer.mask, mask) > 0.8


def test_a_picture_full_of_foreground_is_not_usable():
    rng = np.random.default_rng(10)
    scene = wall(rng)
    segmenter = Segmenter(learn_background(photograph(scene, rng) for _ in range(5)), SETTINGS)
    other = np.zeros_like(scene)
    other[:, :, 0] = 250.0 - scene[:, :, 0]
    answer = segmenter.segment(photograph(other, rng))
    assert not answer.is_usable


def test_mistakes_are_named():
    background = learn_background([np.full((6, 8, 3), 100, np.uint8)] * 3)
    with pytest.raises(ValueError, match="image: expected uint8 of shape"):
        Segmenter(background).segment(np.zeros((8, 6, 3), np.uint8))
    with pytest.raises(ValueError, match="method"):
        ForegroundSettings(method="magic")
    with pytest.raises(ValueError, match="adaptation"):
        ForegroundSettings(adaptation=1.0)


def test_clean_mask_fills_small_holes_drops_specks_and_keeps_large_holes():
    mask = np.zeros((480, 640), dtype=bool)
    mask[100:300, 200:300] = True
    mask[140:144, 240:244] = False  # a pinhole
    mask[180:220, 230:260] = False  # the view between arm and body
    mask[20:25, 20:25] = True  # a speck
    cleaned = clean_mask(mask)
    assert cleaned.dtype == np.bool_
    assert cleaned[140:144, 240:244].all()
    assert not cleaned[185:215, 235:255].any()
    assert not cleaned[:60, :60].any()
    assert iou(clean_mask(cleaned), cleaned) == 1.0
    assert not clean_mask(np.zeros((48, 64), dtype=bool)).any()


def test_kernels_equal_numpy():
    rng = np.random.default_rng(11)
    image = rng.integers(0, 256, (9, 14, 3), dtype=np.uint8)
    background = rng.integers(0, 256, (9, 14, 3), dtype=np.uint8)
    threshold = rng.integers(1, 200, (9, 14), dtype=np.uint8)
    largest = np.empty((9, 14), np.uint8)
    candidate = np.empty((9, 14), np.uint8)
    kernels.difference(
        image.reshape(-1), background.reshape(-1), threshold.reshape(-1),
        largest.reshape(-1), candidate.reshape(-1),
    )  # fmt: skip
    expected = np.abs(image.astype(int) - background).max(axis=2)
    np.testing.assert_array_equal(largest, expected)
    np.testing.assert_array_equal(candidate, np.where(expected > threshold, 255, 0))

    ratio = np.empty((9, 14), np.float32)
    residual = np.empty((9, 14, 2), np.float32)
    kernels.chroma_residual(image, background, ratio, residual)
    i, b = image.astype(float), background.astype(float)
    r = (i * b).sum(axis=2) / ((b * b).sum(axis=2) + 1)
    np.testing.assert_allclose(ratio, r, rtol=1e-5)
    np.testing.assert_allclose(residual, (i - r[:, :, None] * b)[:, :, ::2], atol=1e-2)

    labels = rng.integers(0, 7, (9, 14)).astype(np.int32)
    flags = rng.integers(0, 2, (9, 14), dtype=np.uint8)
    area, flagged = np.zeros(7, np.int64), np.zeros(7, np.int64)
    kernels.count_regions(labels, flags, area, flagged)
    np.testing.assert_array_equal(area, np.bincount(labels.ravel(), minlength=7))
    np.testing.assert_array_equal(flagged, np.bincount(labels.ravel(), weights=flags.ravel(), minlength=7))
