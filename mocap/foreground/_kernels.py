"""Compiled loops of the foreground stage. Arrays and scalars only; each has a numpy twin in the tests."""

from __future__ import annotations

import numpy as np
from numba import njit


@njit(cache=True, nogil=True)
def robust_statistics(samples, far, mean, std, moved):
    """Robust mean and spread over samples (n, m) uint8, n <= 255; see model.learn_background.

    mean, std : (m,) float32 out.  moved : (m,) uint8 out, 1 where a sample is more than `far` from the
    median.
    """
    n, m = samples.shape
    values = np.empty(n, dtype=np.uint8)
    for i in range(m):
        for k in range(n):
            x = samples[k, i]
            j = k
            while j > 0 and values[j - 1] > x:
                values[j] = values[j - 1]
                j -= 1
            values[j] = x
        half = n // 2
        best = 0
        width = np.int32(values[half]) - np.int32(values[0])
        for k in range(1, n - half):
            w = np.int32(values[k + half]) - np.int32(values[k])
            if w < width:
                width = w
                best = k
        # The shortest half of a normal sample spans 1.349 standard deviations about the mean.
        center = (np.int32(values[best]) + np.int32(values[best + half])) // 2
        spread = np.float32(width) / np.float32(1.349)
        reach = np.float32(2.5) * spread + np.float32(3.0)
        total = np.float32(0.0)
        square = np.float32(0.0)
        count = np.float32(0.0)
        for k in range(n):
            d = np.float32(np.int32(values[k]) - center)
            if abs(d) <= reach:
                total += d
                square += d * d
                count += np.float32(1.0)
        off = total / count
        mean[i] = np.float32(center) + off
        std[i] = np.sqrt(max(square / count - off * off, np.float32(0.0)))
        moved[i] = np.uint8(np.int32(values[n - 1]) - center > far or center - np.int32(values[0]) > far)


@njit(cache=True, nogil=True)
def difference(image, background, threshold, largest, candidate):
    """largest = max over channels of |image - background|, candidate = 255 where it exceeds the threshold.

    image, background : (3 n,) uint8.  threshold, largest, candidate : (n,) uint8.
    """
    for i in range(largest.shape[0]):
        a0, b0 = image[3 * i], background[3 * i]
        a1, b1 = image[3 * i + 1], background[3 * i + 1]
        a2, b2 = image[3 * i + 2], background[3 * i + 2]
        d = max(
            max(np.uint8(max(a0, b0) - min(a0, b0)), np.uint8(max(a1, b1) - min(a1, b1))),
            np.uint8(max(a2, b2) - min(a2, b2)),
        )
        largest[i] = d
        candidate[i] = 255 if d > threshold[i] else 0


@njit(cache=True, nogil=True)
def brightness_ratios(image, background, frozen, step, ratios):
    """Ratios image / background of a raster of usable pixels; returns how many were written.

    image, background : (h, w, 3) uint8.  frozen : (h, w) uint8, 0 = background.  ratios : (3, n) float32 out.
    """
    n = 0
    for y in range(step // 2, image.shape[0], step):
        for x in range(step // 2, image.shape[1], step):
            usable = frozen[y, x] == 0
            for c in range(3):
                usable &= (background[y, x, c] > 20) & (background[y, x, c] < 250) & (image[y, x, c] < 250)
            if usable:
                for c in range(3):
                    ratios[c, n] = np.float32(image[y, x, c]) / np.float32(background[y, x, c])
                n += 1
    return n


@njit(cache=True, nogil=True)
def chroma_residual(image, background, ratio, residual):
    """Best brightness ratio r of image to background, and image - r * background in red and blue.

    image, background : (h, w, 3) uint8.  ratio : (h, w) float32 out.  residual : (h, w, 2) float32 out.
    """
    for y in range(image.shape[0]):
        for x in range(image.shape[1]):
            i0, i1, i2 = np.float32(image[y, x, 0]), np.float32(image[y, x, 1]), np.float32(image[y, x, 2])
            b0 = np.float32(background[y, x, 0])
            b1 = np.float32(background[y, x, 1])
            b2 = np.float32(background[y, x, 2])
            r = (i0 * b0 + i1 * b1 + i2 * b2) / (b0 * b0 + b1 * b1 + b2 * b2 + np.float32(1.0))
            ratio[y, x] = r
            residual[y, x, 0] = i0 - r * b0
            residual[y, x, 1] = i2 - r * b2


@njit(cache=True, nogil=True)
def split_shadow(
    candidate, ratio, residual, smooth, background, darkest, brightest, chroma, chroma_pixel, tint,
    foreground, shadow,
):  # fmt: skip
    """Foreground (1) and shadow (1) of the candidates; see segment.ForegroundSettings for the numbers.

    residual, smooth : (h, w, 2) float32, red and blue, per pixel and averaged over a window.
    """
    tiny = np.float32(1.0)
    for y in range(candidate.shape[0]):
        for x in range(candidate.shape[1]):
            foreground[y, x] = 0
            shadow[y, x] = 0
            if candidate[y, x] == 0:
                continue
            b0 = np.float32(background[y, x, 0])
            b1 = np.float32(background[y, x, 1])
            b2 = np.float32(background[y, x, 2])
            r = ratio[y, x]
            e0, e2 = residual[y, x, 0], residual[y, x, 1]
            s0, s2 = smooth[y, x, 0], smooth[y, x, 1]
            # The residual is orthogonal to the background colour: green follows from red and blue.
            e1 = -(e0 * b0 + e2 * b2) / max(b1, tiny)
            s1 = -(s0 * b0 + s2 * b2) / max(b1, tiny)
            slack = tint * abs(np.float32(1.0) - r) * max(max(b0, b1), b2)
            single = max(max(abs(e0), abs(e1)), abs(e2))
            window = max(max(abs(s0), abs(s1)), abs(s2))
            is_shadow = (
                (r > darkest) & (r < brightest) & (single < chroma_pixel + slack) & (window < chroma + slack)
            )
            if is_shadow:
                shadow[y, x] = 1
            else:
                foreground[y, x] = 1


@njit(cache=True, nogil=True)
def adapt_rows(image, mean, background, frozen, first, stride, rate):
    """Move every stride-th row of the mean towards the image where not frozen; refresh the rounded
    background.

    image, background : (h, w, 3) uint8.  mean : (h, w, 3) float32.  frozen : (h, w) uint8, 0 = may adapt.
    """
    for y in range(first, image.shape[0], stride):
        for x in range(image.shape[1]):
            step = rate if frozen[y, x] == 0 else np.float32(0.0)
            for c in range(3):
                m = mean[y, x, c]
                m += step * (np.float32(image[y, x, c]) - m)
                mean[y, x, c] = m
                background[y, x, c] = np.uint8(m + np.float32(0.5))


@njit(cache=True, nogil=True)
def count_regions(labels, flags, area, flagged):
    """Pixels, and pixels with a flag that is not 0, of each label; area, flagged : (n,) int64 zeros on entry."""
    for y in range(labels.shape[0]):
        for x in range(labels.shape[1]):
            label = labels[y, x]
            area[label] += 1
            if flags[y, x] != 0:
                flagged[label] += 1


@njit(cache=True, nogil=True)
def select_regions(labels, keep, out):
    """out = keep[labels]; labels : (h, w) int32, keep : (n,) uint8, out : (h, w) uint8."""
    for y in range(labels.shape[0]):
        for x in range(labels.shape[1]):
            out[y, x] = keep[labels[y, x]]
