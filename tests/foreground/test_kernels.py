"""Each compiled loop against a plain numpy (or OpenCV, scipy) twin, on random pictures with unequal sides."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from scipy import ndimage

from mocap.foreground import _kernels as kernels

H, W = 41, 56  # neither a multiple of the cell; W of 8
# Residuals are rounded to 1/16 level and ratios to 1/1024: a pixel may sit on the other side of a limit.
MAX_ROUNDED = 0.004


def pictures(seed: int, exposure: float = 1.0) -> tuple[np.ndarray, np.ndarray, np.random.Generator]:
    """A smooth background and a picture with noise, a shadow and an object."""
    rng = np.random.default_rng(seed)
    coarse = exposure * rng.uniform(60.0, 200.0, (4, 5, 3))
    background = cv2.resize(coarse, (W, H), interpolation=cv2.INTER_CUBIC)
    image = background.copy()
    image[8:34, 6:30] *= rng.uniform(0.6, 0.9)
    image[5:25, 24:44] = rng.uniform(0, 255, 3)
    image += rng.normal(0.0, 2.0, image.shape)
    return image.clip(0, 255).astype(np.uint8), background.clip(0, 255).astype(np.uint8), rng


def far(image: np.ndarray, background: np.ndarray) -> np.ndarray:
    return np.abs(image.astype(int) - background).max(axis=2)


@pytest.mark.parametrize("seed", range(3))
def test_difference_and_search_count(seed: int) -> None:
    image, background, rng = pictures(seed)
    threshold = rng.integers(1, 60, (H, W), dtype=np.uint8)
    y0, x0, h, w = 16, 16, 20, 32
    largest, candidate = np.zeros((h, 40), np.uint8), np.zeros((h, 40), np.uint8)
    kernels.difference(
        image.reshape(H, -1), background.reshape(H, -1), threshold, y0, x0, w, largest, candidate
    )
    expected = far(image, background)
    np.testing.assert_array_equal(largest[:, :w], expected[y0 : y0 + h, x0 : x0 + w])
    np.testing.assert_array_equal(
        candidate[:, :w], (expected > threshold)[y0 : y0 + h, x0 : x0 + w].astype(np.uint8)
    )
    assert not largest[:, w:].any()
    assert not candidate[:, w:].any()

    cell, stride, first = kernels.CELL, 3, 1
    counts = np.zeros((-(-H // cell), -(-W // cell)), np.int32)
    kernels.count_differences(
        image.reshape(H, -1), background.reshape(H, -1), threshold, first, stride, counts
    )
    searched = np.zeros((H, W), bool)
    searched[first::stride] = (expected > threshold)[first::stride]
    for cy in range(counts.shape[0]):
        for cx in range(counts.shape[1]):
            block = searched[cell * cy : cell * (cy + 1), cell * cx : cell * (cx + 1)]
            assert counts[cy, cx] == np.count_nonzero(block)


def test_sampled_ratios() -> None:
    image, background, _ = pictures(0)
    rng = np.random.default_rng(5)
    limit = rng.uniform(5, 20, (H, W)).astype(np.float32)
    excluded = (rng.random((H, W)) < 0.3).astype(np.uint8)
    ratios = np.full(H * W, np.nan, dtype=np.float32)
    n = kernels.sampled_ratios(image.reshape(H, -1), background.reshape(H, -1), limit, excluded, 3, ratios)
    raster = (slice(1, None, 3), slice(1, None, 3))
    expected = (far(image, background) / limit)[raster][excluded[raster] == 0]
    np.testing.assert_allclose(ratios[:n], expected, rtol=1e-6)
    assert np.isnan(ratios[n:]).all()


def test_median_gain_and_scaling() -> None:
    rng = np.random.default_rng(4)
    background = rng.integers(40, 160, (H, W, 3), dtype=np.uint8)
    gain = np.array([0.8, 1.1, 1.3])
    image = np.round(background * gain).clip(0, 255).astype(np.uint8)
    excluded = (rng.random((H, W)) < 0.3).astype(np.uint8)
    image[excluded != 0] = 7
    found = np.empty(3)
    n = kernels.median_gain(image.reshape(H, -1), background.reshape(H, -1), excluded, 2, found)
    raster = excluded[1::2, 1::2] == 0
    assert n == np.count_nonzero(raster & (image[1::2, 1::2] < 250).all(axis=2))
    ratios = (image[1::2, 1::2] / background[1::2, 1::2].astype(float))[raster]
    # The bins are 1/1024 wide.
    np.testing.assert_allclose(found, np.median(ratios, axis=0), atol=2 / 1024)
    assert (
        kernels.median_gain(image.reshape(H, -1), background.reshape(H, -1), np.ones_like(excluded), 2, found)
        == 0
    )
    np.testing.assert_array_equal(found, 1.0)

    factor = np.round(65536 / gain).astype(np.uint32)
    out = np.empty((H, 3 * W), np.uint8)
    image[:3] = 255
    image[3:, 5], image[3:, 6], background[3:, 5:7] = kernels._SATURATED, kernels._SATURATED - 1, 254
    kernels.scale_rows(image.reshape(H, -1), background.reshape(H, -1), factor, out)
    expected = np.minimum((image.reshape(H, -1).astype(np.int64) * np.tile(factor, W) + 32768) >> 16, 255)
    is_full = image.reshape(H, -1) >= kernels._SATURATED
    assert is_full[:3].all()
    expected[is_full] = np.maximum(expected, background.reshape(H, -1))[is_full]
    np.testing.assert_array_equal(out, expected)


def box(plane: np.ndarray, half: int) -> np.ndarray:
    side = 2 * half + 1
    return cv2.boxFilter(
        plane.astype(np.float64), -1, (side, side), normalize=False, borderType=cv2.BORDER_CONSTANT
    )


@pytest.mark.parametrize("half", [1, 2, 4])
@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("exposure", [1.0, 1.6])  # well, and over
def test_shadow_test(exposure: float, seed: int, half: int) -> None:
    image, background, _ = pictures(seed, exposure)
    candidate = (far(image, background) > 6).astype(np.uint8)
    darkest, brightest, chroma_pixel, chroma, least, edge, noise = 0.5, 1.03, 8.0, 0.03, 2.0, 0.07, 2.5
    foreground, shadow = np.zeros((H, W), np.uint8), np.zeros((H, W), np.uint8)
    rule = kernels.ShadowRule(half, darkest, brightest, chroma_pixel, chroma, least, edge, noise)
    rows, back = image.reshape(H, -1), background.reshape(H, -1)
    kernels.shadow_test(rows, back, (0, 0, W), candidate, rule, foreground, shadow)
    i, b = image.astype(float), background.astype(float)
    square = (b * b).sum(axis=2) + 1
    whole = b < 250
    assert whole.all(axis=2).all() == (exposure == 1.0)
    whole |= ~whole.any(axis=2, keepdims=True)
    ratio = (whole * i * b).sum(axis=2) / ((whole * b * b).sum(axis=2) + 1)
    residual = i - ratio[:, :, None] * b
    residual -= np.clip(residual, 0, np.where(whole, 0, 40 * ratio[:, :, None]))
    level = np.sqrt(square / 3)
    may = (ratio > darkest) & (ratio < brightest) & (np.abs(residual).max(axis=2) < chroma_pixel)
    number = box(may, half)
    worst = np.max([np.abs(box(residual[:, :, c] * may, half)) for c in range(3)], axis=0)
    neutral = worst < np.maximum(chroma * ratio * level, least) * number
    sobel = {"ksize": 3, "scale": 1 / 8, "borderType": cv2.BORDER_REPLICATE}
    slope = np.hypot(cv2.Sobel(ratio, cv2.CV_64F, 1, 0, **sobel), cv2.Sobel(ratio, cv2.CV_64F, 0, 1, **sobel))
    alone = may & neutral & ((slope < edge) | (slope * level < noise))
    votes = box(np.where(candidate > 0, np.where(alone, -1, 1), 0), half)
    expected = (candidate > 0) & (votes >= 0)
    np.testing.assert_array_equal(foreground + (shadow == kernels.SHADOW), candidate)
    assert 0.05 < expected.mean() < 0.6
    assert (shadow == kernels.SHADOW).any()
    doubtful = shadow == kernels.DOUBTFUL
    assert doubtful.any()
    assert np.count_nonzero(doubtful != (expected & may)) <= MAX_ROUNDED * H * W
    assert np.count_nonzero(foreground.astype(bool) != expected) <= MAX_ROUNDED * H * W


def test_shadow_test_does_not_depend_on_where_the_window_lies() -> None:
    image, background, _ = pictures(7)
    whole = np.zeros((2, H, W), np.uint8)
    candidate = (far(image, background) > 6).astype(np.uint8)
    candidate[:, :12] = 0
    candidate[:, 48:] = 0
    rule = kernels.ShadowRule(2, 0.5, 1.03, 8.0, 0.03, 2.0, 0.07, 2.5)
    rows, back = image.reshape(H, -1), background.reshape(H, -1)
    kernels.shadow_test(rows, back, (0, 0, W), candidate, rule, *whole)
    part = np.zeros((2, H, 48), np.uint8)
    window = np.ascontiguousarray(candidate[:, 8:])
    kernels.shadow_test(rows, back, (0, 8, 48), window, rule, *part)
    np.testing.assert_array_equal(part, whole[:, :, 8:])


@pytest.mark.parametrize("half", [1, 3])
def test_trim_outline(half: int) -> None:
    rng = np.random.default_rng(9)
    foreground = np.zeros((H, W), np.uint8)
    cv2.ellipse(foreground, (27, 20), (17, 14), 20, 0, 360, 1, -1)
    foreground[0:9, 0:12] = 1  # touches the border
    square = np.ones((3, 3), np.uint8)
    # The object is smaller than the foreground: a halo of two pixels.
    object_ = cv2.erode(foreground, square, iterations=2)
    largest = (object_ * 90.0 + rng.uniform(0, 12, (H, W))).astype(np.uint8)
    core, beside = cv2.erode(foreground, square), cv2.dilate(foreground, square) ^ 1
    deep = cv2.erode(foreground, np.ones((7, 7), np.uint8))
    trimmed = foreground.copy()
    kernels.trim_outline(trimmed, core, beside, deep, core * largest, beside * largest, largest, half, 0.4)
    inside = box(core * largest, half) / np.maximum(box(core, half), 1)
    outside = box(beside * largest, half) / np.maximum(box(beside, half), 1)
    goes = (inside > outside) & (largest < outside + 0.4 * (inside - outside)) & (deep == 0)
    np.testing.assert_array_equal(trimmed, foreground & ~goes)
    assert 0 < np.count_nonzero(trimmed) < np.count_nonzero(foreground)


@pytest.mark.parametrize("value", [0, 1])
@pytest.mark.parametrize("density", [0.05, 0.5, 0.9])
def test_label_regions(value: int, density: float) -> None:
    rng = np.random.default_rng(int(100 * density) + value)
    mask = (rng.random((H, W)) < density).astype(np.uint8)
    mask[3:12, 8:40] = 1  # whole words of eight pixels
    flags = (rng.random((H, W)) < 0.4).astype(np.uint8)
    most = H * (W // 2 + 1)
    runs = np.empty((most, 4), np.int32)
    area, flagged = np.empty(most, np.int64), np.empty(most, np.int64)
    n_runs, n = kernels.label_regions(mask, flags, value, value, runs, area, flagged)
    structure = np.ones((3, 3)) if value else ndimage.generate_binary_structure(2, 1)
    labels, expected = ndimage.label(mask == value, structure)
    assert n == expected
    found = np.full((H, W), -1)
    for y, start, stop, region in runs[:n_runs]:
        assert np.all(mask[y, start:stop] == value)
        assert np.all(found[y, start:stop] == -1)
        found[y, start:stop] = region
    np.testing.assert_array_equal(found >= 0, mask == value)
    pairs = {(int(a), int(b)) for a, b in zip(found[found >= 0], labels[found >= 0], strict=True)}
    assert len(pairs) == n
    np.testing.assert_array_equal(area[:n], np.bincount(found[found >= 0], minlength=n))
    np.testing.assert_array_equal(
        flagged[:n], np.bincount(found[found >= 0], flags[found >= 0], minlength=n).astype(np.int64)
    )
    chosen = np.arange(n) % 2 == 0
    painted = mask.copy()
    kernels.paint_regions(painted, runs, n_runs, chosen, 1 - value)
    np.testing.assert_array_equal(
        painted, np.where((found >= 0) & chosen[np.maximum(found, 0)], 1 - value, mask)
    )


def test_spans_of() -> None:
    mask = np.zeros((4, 24), np.uint8)
    mask[1, 5] = mask[1, 17] = mask[3, 23] = 1
    low, high = np.empty(4, np.int64), np.empty(4, np.int64)
    kernels.spans_of(mask, low, high)
    assert (low[1], high[1]) == (5, 18)
    assert (low[3], high[3]) == (23, 24)
    assert np.all(low[[0, 2]] >= high[[0, 2]])


@pytest.mark.parametrize("patience", [-1, 2])
@pytest.mark.parametrize("is_protected", [False, True])
def test_adapt_rows(patience: int, is_protected: bool) -> None:
    image, background, rng = pictures(11)
    mean = (background + rng.uniform(-0.4, 0.4, background.shape)).astype(np.float32)
    threshold = np.full((H, W), 6, np.uint8)
    near = (rng.random((H, W)) < 0.2).astype(np.uint8)
    protect = (rng.random((H, W)) < 0.5).astype(np.uint8) if is_protected else np.zeros((0, 0), np.uint8)
    age = rng.integers(0, 4, (H, W)).astype(np.uint16)
    first, stride, rate = 2, 5, np.float32(0.25)
    free = (far(image, background) <= 6) & (near == 0)
    shielded = protect.astype(bool) if is_protected else np.zeros((H, W), bool)
    absorbed = ~free & ~shielded & (age >= patience) if patience >= 0 else np.zeros((H, W), bool)
    step = np.where(absorbed, 1.0, np.where(free, rate, 0.0))[:, :, None]
    expected = mean + step * (image - mean)
    older = np.where(free | shielded | absorbed, 0, age + 1) if patience >= 0 else age
    out, old_mean, old_age, old_back = mean.reshape(H, -1).copy(), mean, age.copy(), background.copy()
    kernels.adapt_rows(
        image.reshape(H, -1), background.reshape(H, -1), out, threshold, near, protect, age,
        first, stride, rate, patience,
    )  # fmt: skip
    visited = np.zeros(H, bool)
    visited[first::stride] = True
    np.testing.assert_allclose(out.reshape(H, W, 3)[visited], expected[visited], atol=1e-4)
    np.testing.assert_array_equal(out.reshape(H, W, 3)[~visited], old_mean[~visited])
    np.testing.assert_array_equal(age[visited], older[visited])
    np.testing.assert_array_equal(age[~visited], old_age[~visited])
    np.testing.assert_array_equal(background[~visited], old_back[~visited])
    # Halves may round either way.
    assert np.abs(background[visited] - expected[visited]).max() <= 0.5 + 1e-3


@pytest.mark.parametrize("density", [0.3, 0.6])
def test_majority_is_the_median(density: float) -> None:
    mask = (np.random.default_rng(5).random((H, W)) < density).astype(np.uint8)
    out = np.empty_like(mask)
    kernels.majority(mask, out)
    np.testing.assert_array_equal(out, cv2.medianBlur(mask, 3))


def test_bounds_of() -> None:
    mask = np.zeros((H, W), np.uint8)
    mask[4:9, 10:21] = mask[20:33, 30:40] = 1
    runs = np.empty((H * (W // 2 + 1), 4), np.int32)
    area, flagged = np.empty(len(runs), np.int64), np.empty(len(runs), np.int64)
    n_runs, n = kernels.label_regions(mask, mask, 1, 1, runs, area, flagged)
    assert n == 2
    assert kernels.bounds_of(runs, n_runs, np.array([True, True])) == (4, 33, 10, 40)
    assert kernels.bounds_of(runs, n_runs, np.array([False, True])) == (20, 33, 30, 40)
    assert kernels.bounds_of(runs, n_runs, np.array([False, False])) == (0, 0, 0, 0)


def test_statistics_of_what_no_person_covers() -> None:
    rng = np.random.default_rng(9)
    n, m, far_px = 17, 157, 20
    samples = rng.integers(60, 90, (n, m, 3), dtype=np.uint8)
    samples[:, : m // 2] = rng.integers(70, 75, (n, m // 2, 3))  # quiet, where the spread tells what is near
    samples[4:6] += 90  # somebody
    samples[6:9] += 12  # his shadow
    cover = np.zeros((n, m), np.uint8)
    cover[::2] = rng.integers(1, 4, (9, m))
    n_told = 0
    mean, std = np.empty((m, 3), np.float32), np.empty((m, 3), np.float32)
    n_free = np.empty(m, np.uint8)
    kernels.free_statistics(samples, cover, far_px, mean, std, n_free)
    for i in range(m):
        chosen = cover[:, i] == kernels.CLEAR
        if not chosen.any():
            chosen = cover[:, i] == kernels.RIM
        assert n_free[i] == np.count_nonzero(chosen)
        if not chosen.any():
            assert not mean[i].any()
            continue
        own = samples[:, i].astype(float)
        middle = np.sort(own[chosen], axis=0)[np.count_nonzero(chosen) // 2]
        spread = np.sort(np.abs(own[chosen] - middle), axis=0)[np.count_nonzero(chosen) // 2].max()
        reach = 2.5 * 1.4826 * spread + 3.0
        is_told = np.count_nonzero(chosen) >= 5 and reach <= far_px
        n_told += is_told
        near = own[np.abs(own - middle).max(axis=1) <= (reach if is_told else far_px)]
        if len(near):
            np.testing.assert_allclose(mean[i], near.mean(axis=0), atol=1e-3)
            np.testing.assert_allclose(std[i], near.std(axis=0), atol=1e-3)
    assert 5 < n_told < m - 5


def test_gains_of_cells() -> None:
    image, background, rng = pictures(6)
    excluded = (rng.random((H, W)) < 0.3).astype(np.uint8)
    excluded[:16, :20] = 1
    cell_width, cell_height, step = 20, 16, 2
    gains = np.empty((-(-H // cell_height), -(-W // cell_width)), np.float32)
    kernels.cell_gains(
        image.reshape(H, -1), background.reshape(H, -1), excluded, step, cell_width, cell_height, gains
    )
    usable = (excluded == 0) & ((background > 20) & (background < 250) & (image < 250)).all(axis=2)
    ratio = image.sum(axis=2) / background.sum(axis=2)
    for (cy, cx), gain in np.ndenumerate(gains):
        cell = np.s_[
            cy * cell_height + 1 : (cy + 1) * cell_height : step,
            cx * cell_width + 1 : (cx + 1) * cell_width : step,
        ]
        chosen = ratio[cell][usable[cell]]
        expected = np.median(chosen) if 4 * len(chosen) >= usable[cell].size else 0.0
        assert gain == pytest.approx(expected, rel=1e-5)
    assert gains[0, 0] == 0.0


@pytest.mark.parametrize("shape", [(1, 1), (1, 6), (15, 8)])
def test_uneven_light_is_no_jump_from_cell_to_cell(shape: tuple[int, int]) -> None:
    rng = np.random.default_rng(0)
    gain, least, most = np.float32(1.1), np.float32(0.04), np.float32(0.1)
    for _ in range(20):
        gains = rng.normal(gain, 0.06, shape).astype(np.float32)
        gains[rng.random(shape) < 0.2] = 0
        shown = np.where(gains > 0, gains, gain)
        jumps = [
            np.pad(np.abs(np.diff(shown, axis=a)) > most, [(int(a == b),) * 2 for b in (0, 1)])
            for a in (0, 1)
        ]
        is_even = ~(jumps[0][1:] | jumps[0][:-1] | jumps[1][:, 1:] | jumps[1][:, :-1])
        expected = (gains > 0) & is_even & (np.abs(shown - gain) > least)
        assert kernels.count_uneven(gains, gain, least, most) == np.count_nonzero(expected)


@pytest.mark.parametrize(("n", "m"), [(1, 5), (2, 256), (3, 255), (24, 600), (31, 257)])
def test_robust_statistics_of_columns(n: int, m: int) -> None:
    rng = np.random.default_rng(n)
    usual = rng.integers(0, 256, m)
    samples = usual + rng.normal(0, 3, (n, m)) + (rng.random((n, m)) < 0.15) * rng.integers(-120, 120, (n, m))
    samples = np.clip(samples, 0, 255).astype(np.uint8)
    mean, std = np.empty((2, m), dtype=np.float32)
    moved = np.empty(m, dtype=np.uint8)
    kernels.robust_statistics(samples, 20, mean, std, moved)
    ordered, half, columns = np.sort(samples, axis=0).astype(np.int64), n // 2, np.arange(m)
    best = (ordered[half:] - ordered[: n - half]).argmin(axis=0)
    low, high = ordered[best, columns], ordered[best + half, columns]
    center, spread = (low + high) // 2, (high - low) / 1.349
    is_near = np.abs(ordered - center) <= 2.5 * spread + 3
    off = np.where(is_near, ordered - center, 0).sum(axis=0) / is_near.sum(axis=0)
    square = np.where(is_near, (ordered - center) ** 2, 0).sum(axis=0) / is_near.sum(axis=0)
    np.testing.assert_allclose(mean, center + off, atol=1e-4)
    np.testing.assert_allclose(std, np.sqrt(np.maximum(square - off**2, 0)), atol=2e-2)
    np.testing.assert_array_equal(moved, np.abs(ordered - center).max(axis=0) > 20)


@pytest.mark.parametrize(("n", "m"), [(1, 3), (8, 256), (9, 700)])
def test_medians_of_columns(n: int, m: int) -> None:
    samples = np.random.default_rng(n).normal(size=(n, m)).astype(np.float32)
    out = np.empty(m, dtype=np.float32)
    kernels.medians(samples, out)
    np.testing.assert_allclose(out, np.median(samples, axis=0), atol=1e-6)


def test_tell_apart_shadow_and_doubt() -> None:
    rng = np.random.default_rng(5)
    mask = rng.integers(0, 2, (H, W), dtype=np.uint8)
    dark = rng.integers(0, 3, (H, W), dtype=np.uint8)
    found, doubtful = dark.copy(), np.zeros((H, W), np.uint8)
    window = slice(3, 30), slice(5, 41)
    n_mask, n_shadow = kernels.tell_apart(mask[window], found[window], doubtful[window])
    inside = np.zeros((H, W), bool)
    inside[window] = True
    np.testing.assert_array_equal(found[window], ((dark == kernels.SHADOW) & (mask == 0))[window])
    np.testing.assert_array_equal(found[~inside], dark[~inside])
    np.testing.assert_array_equal(doubtful, inside & (dark > 0) & (mask != 0))
    assert n_mask == np.count_nonzero(mask[window])
    assert n_shadow == np.count_nonzero(found[window])


@pytest.mark.parametrize("step", [1, 2, 3])
def test_lattice_colours_are_means_of_nine_pixels(step: int) -> None:
    rng = np.random.default_rng(step)
    mask, picture = rng.random((H, W)) < 0.5, rng.integers(0, 256, (H, W, 3), dtype=np.uint8)
    places, colours = np.empty((H * W, 2), np.int16), np.empty((H * W, 3), np.uint8)
    n = kernels.lattice_colours(mask, picture, step, places, colours)
    first = max(1, step // 2)
    v, u = np.nonzero(mask[first:-1:step, first:-1:step])
    v, u = first + step * v, first + step * u
    np.testing.assert_array_equal(places[:n], np.column_stack([u, v]))
    around = [picture[v + dv, u + du].astype(int) for dv in (-1, 0, 1) for du in (-1, 0, 1)]
    np.testing.assert_array_equal(colours[:n], np.sum(around, axis=0) // 9)
