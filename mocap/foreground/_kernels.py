"""Compiled loops of the foreground stage. Arrays and scalars only; each has a numpy twin in the tests.

Pictures come as rows, (H, 3 W) uint8: red, green, blue of pixel x at 3 x. A window is the part of a picture that
is looked at closely; its planes are (h, w) and contiguous. Sums over squares of 2 k + 1 pixels are made of sums
over columns, which are carried on from row to row; pixels beyond the window count nothing. Division by zero gives
infinity instead of an exception, whose test would keep the compiler from working on many pixels at once.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

# Columns that are worked on side by side: sorting them touches 8 kB of 31 samples, and fills whole instructions.
_COLUMNS = 256


@njit(cache=True, nogil=True)
def robust_statistics(samples, far, mean, std, moved):
    """Robust mean and spread over samples (n, m) uint8, n <= 255; see model.learn_background.

    mean, std : (m,) float32 out.  moved : (m,) uint8 out, 1 where a sample is more than `far` from the
    median.
    """
    n, m = samples.shape
    half = n // 2
    block = np.empty((n, _COLUMNS), dtype=np.uint8)
    width, best = np.empty(_COLUMNS, dtype=np.uint8), np.empty(_COLUMNS, dtype=np.uint8)
    center, reach = np.empty(_COLUMNS, dtype=np.float32), np.empty(_COLUMNS, dtype=np.float32)
    total, square = np.empty(_COLUMNS, dtype=np.float32), np.empty(_COLUMNS, dtype=np.float32)
    count = np.empty(_COLUMNS, dtype=np.float32)
    for first in range(0, m, _COLUMNS):
        size = min(_COLUMNS, m - first)
        _sort_columns(samples, first, size, block)
        width[:] = 255
        best[:] = 0
        for k in range(n - half):
            low, high = block[k], block[k + half]
            for i in range(_COLUMNS):
                w = np.uint8(high[i] - low[i])
                is_less = w < width[i]
                width[i] = w if is_less else width[i]
                best[i] = np.uint8(k) if is_less else best[i]
        for i in range(size):
            # The shortest half of a normal sample spans 1.349 standard deviations about the mean.
            center[i] = np.float32((np.int32(block[best[i], i]) + np.int32(block[best[i] + half, i])) // 2)
            reach[i] = np.float32(2.5) * (np.float32(width[i]) / np.float32(1.349)) + np.float32(3.0)
        total[:] = 0.0
        square[:] = 0.0
        count[:] = 0.0
        for k in range(n):
            row = block[k]
            for i in range(_COLUMNS):
                d = np.float32(row[i]) - center[i]
                is_near = abs(d) <= reach[i]
                total[i] += d if is_near else np.float32(0.0)
                square[i] += d * d if is_near else np.float32(0.0)
                count[i] += np.float32(1.0) if is_near else np.float32(0.0)
        for i in range(size):
            off = total[i] / count[i]
            mean[first + i] = center[i] + off
            std[first + i] = np.sqrt(max(square[i] / count[i] - off * off, np.float32(0.0)))
            highest, lowest = np.float32(block[n - 1, i]), np.float32(block[0, i])
            moved[first + i] = np.uint8(highest - center[i] > far or center[i] - lowest > far)


@njit(cache=True, nogil=True)
def _sort_columns(samples, first, size, block):
    """The columns [first, first + size) of samples (n, m) in order, into the first of block (n, _COLUMNS); n is small.

    Neighbouring rows are exchanged, all columns at once: many more exchanges than one column needs, 30 in one go.
    """
    n = len(samples)
    for k in range(n):
        for i in range(_COLUMNS):
            block[k, i] = samples[k, first + i if i < size else first]
    for turn in range(n):
        for k in range(turn % 2, n - 1, 2):
            low, high = block[k], block[k + 1]
            for i in range(_COLUMNS):
                a, b = low[i], high[i]
                low[i] = b if b < a else a
                high[i] = a if b < a else b


@njit(cache=True, nogil=True)
def medians(samples, out):
    """Medians (m,) float32, out, of samples (n, m) float32."""
    n, m = samples.shape
    block = np.empty((n, _COLUMNS), dtype=np.float32)
    for first in range(0, m, _COLUMNS):
        size = min(_COLUMNS, m - first)
        _sort_columns(samples, first, size, block)
        for i in range(size):
            out[first + i] = (block[(n - 1) // 2, i] + block[n // 2, i]) / np.float32(2)


@njit(cache=True, nogil=True)
def _middle_of(values, n):
    """The middle one of the first n of some numbers, which it puts in order; n is small."""
    for i in range(1, n):
        value, k = values[i], i
        while k > 0 and values[k - 1] > value:
            values[k] = values[k - 1]
            k -= 1
        values[k] = value
    return values[n // 2]


CLEAR, RIM, PERSON = 1, 2, 3  # of a pixel of a key picture; 0 = no key picture


@njit(cache=True, nogil=True)
def free_statistics(samples, cover, far, mean, std, n_free):
    """Mean and spread per pixel of what key pictures show where no person covers them; see recording.py.

    samples : (n, m, 3) uint8, n <= 255.  cover : (n, m) uint8, 0, CLEAR, RIM or PERSON.  mean, std : (m, 3) float32
    out, of all samples near the middle of the CLEAR ones (of the RIM ones where none is CLEAR): within 2.5 times their
    spread and 3 levels as in `robust_statistics`, because cloth and shadow may be less than `far` off; within `far`
    where fewer than five tell the spread.
    n_free : (m,) uint8 out, how many gave that middle; 0 leaves mean and std 0.
    """
    n, m = cover.shape
    values = np.empty((3, n), dtype=np.int32)
    middle = np.empty(3, dtype=np.int32)
    for i in range(m):
        mean[i], std[i] = np.float32(0.0), np.float32(0.0)
        count = 0
        for wanted in (CLEAR, RIM):
            for k in range(n):
                if cover[k, i] == wanted:
                    for c in range(3):
                        values[c, count] = samples[k, i, c]
                    count += 1
            if count > 0:
                break
        n_free[i] = np.uint8(count)
        if count == 0:
            continue
        reach = np.float32(3.0)
        for c in range(3):
            own = values[c]
            middle[c] = _middle_of(own, count)
            for k in range(count):
                own[k] = abs(own[k] - middle[c])
            spread = _middle_of(own, count)
            reach = max(reach, np.float32(2.5 * 1.4826) * np.float32(spread) + np.float32(3.0))
        if count < 5 or reach > far:
            reach = np.float32(far)
        n_near = np.float32(0.0)
        for k in range(n):
            off = 0
            for c in range(3):
                off = max(off, abs(np.int32(samples[k, i, c]) - middle[c]))
            if off <= reach:
                n_near += np.float32(1.0)
                for c in range(3):
                    d = np.float32(np.int32(samples[k, i, c]) - middle[c])
                    mean[i, c] += d
                    std[i, c] += d * d
        for c in range(3):
            d = mean[i, c] / max(n_near, np.float32(1.0))
            std[i, c] = np.sqrt(max(std[i, c] / max(n_near, np.float32(1.0)) - d * d, np.float32(0.0)))
            mean[i, c] = np.float32(middle[c]) + d


CELL = 16  # side of the square cells that are searched for differences, px
SHADOW = np.uint8(1)
DOUBTFUL = np.uint8(2)  # foreground that has a shadow's own darkness and colour
_LEVELS = 16  # fixed point of colour residuals: 1/16 grey level at best
_RATIO = 1024  # fixed point of brightness ratios
_SATURATED = 250  # grey level from which on a value may stand for a brighter one
_MOST_LOST = 40  # grey levels by which a value that is full may stand for a brighter one
_BLOCK = 32  # 16-bit numbers that one instruction handles at most
_SPARE = 2 * _BLOCK
_RATIO_BINS = 2048  # of the histogram over ratios 0 .. 2


@njit(cache=True, nogil=True, inline="always")
def _far(a, b, i):
    """Largest difference over the channels of pixel i of two rows."""
    a0, b0 = a[3 * i], b[3 * i]
    a1, b1 = a[3 * i + 1], b[3 * i + 1]
    a2, b2 = a[3 * i + 2], b[3 * i + 2]
    return max(
        max(np.uint8(max(a0, b0) - min(a0, b0)), np.uint8(max(a1, b1) - min(a1, b1))),
        np.uint8(max(a2, b2) - min(a2, b2)),
    )


@njit(cache=True, nogil=True, error_model="numpy")
def count_differences(rows, background, threshold, first, stride, counts):
    """Pixels of which a channel differs by more than the threshold, counted per cell in every stride-th row.

    rows, background : (H, 3 W) uint8.  threshold : (H, W) uint8.  counts : (ceil(H / 16), ceil(W / 16)) int32, zeros
    on entry.
    """
    width = threshold.shape[1]
    differs = np.zeros(counts.shape[1] * CELL, dtype=np.uint8)
    words = differs.view(np.uint64)
    for y in range(first, rows.shape[0], stride):
        a, b, t = rows[y], background[y], threshold[y]
        for i in range(width):
            differs[i] = np.uint8(_far(a, b, i) > t[i])
        cells = counts[y // CELL]
        for cx in range(cells.shape[0]):
            # The highest byte of the product is the sum of all eight.
            both = words[2 * cx] + words[2 * cx + 1]
            cells[cx] += np.int32((both * np.uint64(0x0101010101010101)) >> np.uint64(56))


@njit(cache=True, nogil=True, error_model="numpy")
def difference(rows, background, threshold, y0, x0, w, largest, candidate):
    """largest = max over channels of |picture - background|, candidate = 1 where it exceeds the threshold.

    rows, background : (H, 3 W) uint8.  threshold : (H, W) uint8.  largest, candidate : (h, at least w) uint8, the
    window whose corner is (y0, x0); columns from w on stay as they are.
    """
    for y in range(largest.shape[0]):
        a = rows[y0 + y, 3 * x0 : 3 * (x0 + w)]
        b = background[y0 + y, 3 * x0 : 3 * (x0 + w)]
        t = threshold[y0 + y, x0 : x0 + w]
        far, found = largest[y], candidate[y]
        for i in range(w):
            d = _far(a, b, i)
            far[i] = d
            found[i] = np.uint8(d > t[i])


@njit(cache=True, nogil=True, error_model="numpy")
def sampled_ratios(rows, background, limit, excluded, step, ratios):
    """Largest difference over the channels as a share of a pixel's limit, over a raster of usable pixels; their number.

    rows, background : (H, 3 W) uint8.  limit : (H, W) float32.  excluded : (H, W) uint8, 0 = may be used.  ratios : (at
    least ceil(H / step) ceil(W / step),) float32 out.
    """
    n = 0
    for y in range(step // 2, excluded.shape[0], step):
        for x in range(step // 2, excluded.shape[1], step):
            if excluded[y, x] == 0:
                ratios[n] = np.float32(_far(rows[y], background[y], x)) / limit[y, x]
                n += 1
    return n


@njit(cache=True, nogil=True, error_model="numpy")
def median_gain(rows, background, excluded, step, gain):
    """Median ratio picture / background of each channel over a raster of usable pixels; their number.

    rows, background : (H, 3 W) uint8.  excluded : (H, W) uint8, 0 = may be used.  gain : (3,) float64 out, 1 when
    there is no pixel. The median is read from a histogram; ratios of 2 and more count as 2.
    """
    bins = np.zeros((3, _RATIO_BINS), dtype=np.int32)
    n = 0
    for y in range(step // 2, excluded.shape[0], step):
        for x in range(step // 2, excluded.shape[1], step):
            usable = excluded[y, x] == 0
            for c in range(3):
                b, a = background[y, 3 * x + c], rows[y, 3 * x + c]
                usable &= (b > 20) & (b < 250) & (a < 250)
            if usable:
                n += 1
                for c in range(3):
                    ratio = np.float64(rows[y, 3 * x + c]) / np.float64(background[y, 3 * x + c])
                    bins[c, min(int(ratio * (_RATIO_BINS // 2)), _RATIO_BINS - 1)] += 1
    for c in range(3):
        gain[c] = 1.0
        below = 0
        for k in range(_RATIO_BINS):
            if n > 0 and 2 * (below + bins[c, k]) >= n:
                # Ratios spread evenly inside the bin that holds the median.
                gain[c] = (k + (0.5 * n - below) / bins[c, k]) / (_RATIO_BINS // 2)
                break
            below += bins[c, k]
    return n


@njit(cache=True, nogil=True, error_model="numpy")
def cell_gains(rows, background, excluded, step, cell_width, cell_height, gains):
    """Median ratio of the brightness of picture and background in every cell; 0 where fewer than a quarter is usable.

    rows, background : (H, 3 W) uint8.  excluded : (H, W) uint8, 0 = may be used.  step : px between samples.
    gains : (ny, nx) float32 out. The last row and column of cells may be cut off by the picture's border.
    """
    height, width = excluded.shape
    values = np.empty((cell_height // step + 1) * (cell_width // step + 1), dtype=np.float32)
    for cy in range(gains.shape[0]):
        for cx in range(gains.shape[1]):
            n, n_all = 0, 0
            for y in range(cy * cell_height + step // 2, min((cy + 1) * cell_height, height), step):
                for x in range(cx * cell_width + step // 2, min((cx + 1) * cell_width, width), step):
                    n_all += 1
                    a, b = np.float32(0.0), np.float32(0.0)
                    usable = excluded[y, x] == 0
                    for i in range(3 * x, 3 * x + 3):
                        usable &= (background[y, i] > 20) & (background[y, i] < 250) & (rows[y, i] < 250)
                        a += np.float32(rows[y, i])
                        b += np.float32(background[y, i])
                    if usable:
                        k = n
                        while k > 0 and values[k - 1] > a / b:
                            values[k] = values[k - 1]
                            k -= 1
                        values[k] = a / b
                        n += 1
            known = (n > 0) & (4 * n >= n_all)
            middle = np.float32(0.5) * (values[max(n - 1, 0) // 2] + values[n // 2])
            gains[cy, cx] = middle if known else np.float32(0.0)


@njit(cache=True, nogil=True)
def count_uneven(gains, gain, least, most):
    """Cells whose gain differs from that of the picture by more than `least`, and from none beside, above or below by
    more than `most`.

    gains : (ny, nx) float32, 0 = not known, which counts as the picture's for its neighbours.  gain, least, most :
    float32.
    """
    height, width = gains.shape
    n = 0
    for y in range(height):
        for x in range(width):
            own = gains[y, x]
            if own <= 0 or abs(own - gain) <= least:
                continue
            is_even = True
            for j, i in ((y - 1, x), (y + 1, x), (y, x - 1), (y, x + 1)):
                if j >= 0 and j < height and i >= 0 and i < width:
                    other = gains[j, i] if gains[j, i] > 0 else gain
                    is_even &= abs(own - other) <= most
            n += is_even
    return n


@njit(cache=True, nogil=True, error_model="numpy")
def scale_rows(rows, background, factor, out):
    """out = rows * factor / 65536, rounded, at most 255; saturated values may be brighter, as far as the background is.

    rows, background, out : (H, 3 W) uint8.  factor : (3,) uint32 of red, green and blue, below 2^24. A lamp that is 255
    in both pictures must not differ because the rest has become brighter.
    """
    factors = np.empty(rows.shape[1], dtype=np.uint32)
    for i in range(factors.shape[0]):
        factors[i] = factor[i % 3]
    for y in range(rows.shape[0]):
        a, b, o = rows[y], background[y], out[y]
        # Cast back after every step: products of 64 bits would take twice as long.
        for i in range(a.shape[0]):
            product = np.uint32(np.uint32(a[i]) * factors[i])
            scaled = np.uint32(np.uint32(product + np.uint32(32768)) >> np.uint32(16))
            o[i] = np.uint8(min(scaled, np.uint32(255)))
        # A choice between two values would be made pixel by pixel, ten times as slowly.
        for i in range(np.uint64(0), np.uint64(a.shape[0])):
            is_full = np.uint8(np.uint8(0) - np.uint8(a[i] >= np.uint8(_SATURATED)))
            o[i] = max(o[i], np.uint8(b[i] & is_full))


@njit(cache=True, nogil=True)
def majority(mask, out):
    """out = 1 where at least five of the 3 x 3 pixels about one are, the median; edges are repeated beyond the border.

    mask, out : (h, w) uint8 of 0 and 1, h and w at least 2.
    """
    h, w = mask.shape
    column = np.empty(w + 2, dtype=np.uint8)
    for y in range(h):
        above, here, below = mask[max(y - 1, 0)], mask[y], mask[min(y + 1, h - 1)]
        inner = column[1 : w + 1]
        for i in range(w):
            inner[i] = above[i] + here[i] + below[i]
        column[0], column[w + 1] = column[1], column[w]
        right, o = column[2:], out[y]
        for i in range(w):
            o[i] = np.uint8(np.uint8(column[i] + inner[i] + right[i]) >= np.uint8(5))


@njit(cache=True, nogil=True)
def spans_of(mask, low, high):
    """First column that is not 0 and the one after the last, per row; (w, 0) for a row of zeros.

    mask : (h, w) uint8, w a multiple of 8.  low, high : (h,) int64 out.
    """
    h, w = mask.shape
    words = mask.view(np.uint64)
    for y in range(h):
        word = words[y]
        first, last = w // 8, -1
        for k in range(w // 8):
            if word[k] != 0:
                first = min(first, k)
                last = k
        low[y], high[y] = 8 * first, 8 * (last + 1)
        while low[y] < high[y] and mask[y, low[y]] == 0:
            low[y] += 1
        while high[y] > low[y] and mask[y, high[y] - 1] == 0:
            high[y] -= 1


@njit(cache=True, nogil=True, inline="always")
def _whole_blocks(n):
    return (n + np.uint64(_BLOCK - 1)) // np.uint64(_BLOCK) * np.uint64(_BLOCK)


class ShadowRule(NamedTuple):
    """What makes a candidate a shadow.

    (a) its brightness ratio to the background lies in (darkest, brightest) and its own colour residual is below
    chroma_pixel levels in every channel; (b) the mean residual of the pixels of (a) in the square of 2 half + 1 about
    it stays below max(chroma * brightness of the shadowed background, least_chroma); (c) the ratio changes by less
    than `edge` per pixel, or by less than `noise` levels. Then the majority of the candidates in the same square
    decides.
    """

    half: int
    darkest: float
    brightest: float
    chroma_pixel: float
    chroma: float
    least_chroma: float
    edge: float
    noise: float


@njit(cache=True, nogil=True, inline="always")
def _beyond(residual, lost):
    """What is left of a residual when the background may have been brighter than recorded, by `lost` at most."""
    return residual - min(max(residual, np.float32(0.0)), lost)


@njit(cache=True, nogil=True, error_model="numpy")
def shadow_test(rows, background, place, candidate, rule, foreground, shadow):
    """Splits candidates by a ShadowRule: foreground = 1 or shadow = SHADOW; shadow = DOUBTFUL where (a) alone holds.

    rows, background : (H, 3 W) uint8; values of the background from _SATURATED on may stand for brighter ones.
    place : (y0, x0, w), corner and width of the window.  candidate : (h, at least w) uint8, 0 or 1, columns a multiple
    of 8: the window, candidates only in its first w columns.  foreground, shadow : like candidate, 0 on entry.
    """
    y0, x0, w = place
    half, darkest, brightest, chroma_pixel, chroma, least_chroma, edge, noise = rule
    h = candidate.shape[0]
    low, high = np.empty(h, np.int64), np.empty(h, np.int64)
    spans_of(candidate, low, high)
    # Fixed point: the sum over a square must fit 16 bits.
    scale = np.float32(min(float(_LEVELS), 32000.0 / (chroma_pixel * (2 * half + 1) ** 2)))
    # Loops run over unsigned indices: signed ones are tested for wrap-around, and then done pixel by pixel. Each
    # loop has few arrays, because the compiler tests every pair of them for overlap and else gives up, too.
    zero, one, two, three = np.uint64(0), np.uint64(1), np.uint64(2), np.uint64(3)
    side, wide = np.uint64(half), np.uint64(2 * half + 1)
    # Planes have `half` columns of zeros on both sides, and spare ones: sums are made of whole blocks of pixels,
    # because the remainders of short rows would take longer than the blocks.
    pad = w + 2 * half + _SPARE
    red, green = np.empty((h, pad), np.int16), np.empty((h, pad), np.int16)
    blue, may = np.empty((h, pad), np.int16), np.empty((h, pad), np.int16)
    for plane in (red, green, blue, may):
        plane[:, :half] = 0
        plane[:, half + w : 2 * half + w] = 0
    ratio = np.empty((h, w + 2), dtype=np.int16)
    level = np.empty((h, w), dtype=np.uint8)
    real = np.empty((6, w), dtype=np.float32)
    lowest, highest, limit = np.float32(darkest), np.float32(brightest), np.float32(chroma_pixel)
    full, over = np.float32(_SATURATED), np.float32(_MOST_LOST)
    for row in range(h):
        # What the squares and slopes of the candidates near this row will ask for.
        begin, end = w, 0
        for k in range(max(row - half - 1, 0), min(row + half + 2, h)):
            begin, end = min(begin, low[k]), max(end, high[k])
        if begin >= end:
            continue
        begin, end = max(begin - half - 1, 0), min(end + half + 1, w)
        y, x, n = np.uint64(row), np.uint64(begin), np.uint64(end - begin)
        source, at = np.uint64(y0 + row), np.uint64(3 * (x0 + begin))
        for i in range(zero, n):
            j = at + three * i
            a0, b0 = np.float32(rows[source, j]), np.float32(background[source, j])
            a1, b1 = np.float32(rows[source, j + one]), np.float32(background[source, j + one])
            a2, b2 = np.float32(rows[source, j + two]), np.float32(background[source, j + two])
            # What light is left is told by the values that were recorded whole, if there are any.
            w0, w1, w2 = np.float32(b0 < full), np.float32(b1 < full), np.float32(b2 < full)
            none = np.float32(1.0) - max(max(w0, w1), w2)
            w0, w1, w2 = w0 + none, w1 + none, w2 + none
            told = w0 * b0 * b0 + w1 * b1 * b1 + w2 * b2 * b2 + np.float32(1.0)
            r = (w0 * a0 * b0 + w1 * a1 * b1 + w2 * a2 * b2) / told
            real[0, i], real[1, i] = r, b0 * b0 + b1 * b1 + b2 * b2 + np.float32(1.0)
            beyond = r * over
            real[2, i] = _beyond(a0 - r * b0, (np.float32(1.0) - w0) * beyond)
            real[3, i] = _beyond(a1 - r * b1, (np.float32(1.0) - w1) * beyond)
            real[4, i] = _beyond(a2 - r * b2, (np.float32(1.0) - w2) * beyond)
        for i in range(zero, n):
            own = max(max(abs(real[2, i]), abs(real[3, i])), abs(real[4, i]))
            r = real[0, i]
            real[5, i] = scale if (r > lowest) & (r < highest) & (own < limit) else np.float32(0.0)
        for i in range(zero, n):
            ratio[y, x + i + one] = np.int16(min(real[0, i], np.float32(8.0)) * np.float32(_RATIO))
            level[y, x + i] = np.uint8(min(np.sqrt(real[1, i] * np.float32(1.0 / 3.0)), np.float32(255.0)))
        for i in range(zero, n):
            red[y, x + side + i] = np.int16(real[2, i] * real[5, i])
            green[y, x + side + i] = np.int16(real[3, i] * real[5, i])
        for i in range(zero, n):
            blue[y, x + side + i] = np.int16(real[4, i] * real[5, i])
            may[y, x + side + i] = np.int16(real[5, i] > 0)
        ratio[row, begin] = ratio[row, begin + 1]
        ratio[row, end + 1] = ratio[row, end]
    # A Sobel difference is eight times the change per pixel.
    steep, loud = np.float32((8.0 * _RATIO * edge) ** 2), np.float32((8.0 * _RATIO * noise) ** 2)
    share, least = np.float32(chroma * scale / _RATIO), np.float32(least_chroma * scale)
    vote = np.zeros((h, pad), dtype=np.int16)
    sums = np.empty((4, pad), dtype=np.int16)
    total = np.empty((4, w + _SPARE), dtype=np.int16)
    for row in range(h):
        if low[row] >= high[row]:
            continue
        y, x, n = np.uint64(row), np.uint64(low[row]), np.uint64(high[row] - low[row])
        m = _whole_blocks(n)
        _column_sums(red, row, half, x, n, sums, zero)
        _column_sums(green, row, half, x, n, sums, one)
        _column_sums(blue, row, half, x, n, sums, two)
        _column_sums(may, row, half, x, n, sums, three)
        for p in range(zero, np.uint64(4)):
            for i in range(zero, m):
                total[p, i] = sums[p, i]
            for d in range(one, wide):
                for i in range(zero, m):
                    total[p, i] += sums[p, i + d]
        above, below = np.uint64(max(row - 1, 0)), np.uint64(min(row + 1, h - 1))
        for i in range(zero, n):
            j = x + i
            left = np.int32(ratio[above, j]) + np.int32(2) * np.int32(ratio[y, j]) + np.int32(ratio[below, j])
            right = (
                np.int32(ratio[above, j + two])
                + np.int32(2) * np.int32(ratio[y, j + two])
                + np.int32(ratio[below, j + two])
            )
            upper = (
                np.int32(ratio[above, j])
                + np.int32(2) * np.int32(ratio[above, j + one])
                + np.int32(ratio[above, j + two])
            )
            lower = (
                np.int32(ratio[below, j])
                + np.int32(2) * np.int32(ratio[below, j + one])
                + np.int32(ratio[below, j + two])
            )
            gx, gy = np.float32(right - left), np.float32(lower - upper)
            real[0, i] = gx * gx + gy * gy
        for i in range(zero, n):
            bright = np.float32(level[y, x + i])
            smooth = (real[0, i] < steep) | (real[0, i] * bright * bright < loud)
            allowed = max(share * np.float32(ratio[y, x + i + one]) * bright, least) * np.float32(total[3, i])
            real[1, i] = allowed if smooth else np.float32(0.0)
        for i in range(zero, n):
            worst = max(max(abs(total[0, i]), abs(total[1, i])), abs(total[2, i]))
            is_shadow = np.int16(np.float32(worst) < real[1, i]) * may[y, x + side + i]
            vote[y, x + side + i] = np.int16(candidate[y, x + i]) * (np.int16(1) - np.int16(2) * is_shadow)
    for row in range(h):
        if low[row] >= high[row]:
            continue
        y, x, n = np.uint64(row), np.uint64(low[row]), np.uint64(high[row] - low[row])
        m = _whole_blocks(n)
        _column_sums(vote, row, half, x, n, sums, zero)
        for i in range(zero, m):
            total[0, i] = sums[0, i]
        for d in range(one, wide):
            for i in range(zero, m):
                total[0, i] += sums[0, i + d]
        for i in range(zero, n):
            yes = np.uint8(total[0, i] >= 0)
            foreground[y, x + i] = candidate[y, x + i] * yes
            doubtful = yes * DOUBTFUL * np.uint8(may[y, x + side + i])
            shadow[y, x + i] = candidate[y, x + i] * ((np.uint8(1) - yes) * SHADOW + doubtful)


@njit(cache=True, nogil=True, error_model="numpy")
def _column_sums(plane, row, half, x, n, sums, p):
    """sums[p, i] = sum of column x + i over the rows within `half` of one, for the n + 2 half columns from x on.

    Rounded up to whole blocks: what the spare columns hold is never used.
    """
    zero, end = np.uint64(0), _whole_blocks(n + np.uint64(2 * half))
    first = np.uint64(max(row - half, 0))
    for i in range(zero, end):
        sums[p, i] = plane[first, x + i]
    for k in range(first + np.uint64(1), np.uint64(min(row + half + 1, plane.shape[0]))):
        for i in range(zero, end):
            sums[p, i] += plane[k, x + i]


@njit(cache=True, nogil=True)
def tell_apart(mask, dark, doubtful):
    """Leave of what is dark the shadow beside the mask; doubtful = 1 where it is in it; pixels of mask and shadow.

    All (h, w) uint8.  mask : 0 or 1.  dark : 0, SHADOW, or DOUBTFUL, which beside the mask is nothing; 0 or 1 out.
    """
    n_mask, n_shadow = 0, 0
    for y in range(mask.shape[0]):
        m, d, o = mask[y], dark[y], doubtful[y]
        for i in range(m.shape[0]):
            o[i] = np.uint8((d[i] > 0) & (m[i] != 0))
        for i in range(m.shape[0]):
            d[i] = np.uint8((d[i] == SHADOW) & (m[i] == 0))
        for i in range(m.shape[0]):
            n_mask += m[i]
        for i in range(m.shape[0]):
            n_shadow += d[i]
    return n_mask, n_shadow


@njit(cache=True, nogil=True, error_model="numpy")
def trim_outline(foreground, core, beside, deep, core_far, beside_far, largest, half, share):
    """Take out of the foreground the pixels of its rim that lie nearer to their surroundings than to the inside.

    Inside and surroundings are the mean difference from the background over `core` and `beside` in the square of
    2 half + 1 pixels; a pixel outside `deep` goes when its own is below beside + share * (core - beside).
    core_far, beside_far : largest where core, beside, else 0.  All (h, w) uint8, w a multiple of 8; the first four 0
    or 1. The foreground is changed.
    """
    h, w = foreground.shape
    low, high = np.empty(h, np.int64), np.empty(h, np.int64)
    spans_of(foreground, low, high)
    # Sums over the rows within `half`, carried on from row to row; columns beyond the window count nothing.
    sums = np.zeros((4, w + 2 * half), dtype=np.uint16)
    for row in range(-half, h):
        if row + half < h:
            _add_row(core_far[row + half], half, sums[0])
            _add_row(core[row + half], half, sums[1])
            _add_row(beside_far[row + half], half, sums[2])
            _add_row(beside[row + half], half, sums[3])
        if row > half:
            _subtract_row(core_far[row - half - 1], half, sums[0])
            _subtract_row(core[row - half - 1], half, sums[1])
            _subtract_row(beside_far[row - half - 1], half, sums[2])
            _subtract_row(beside[row - half - 1], half, sums[3])
        if row < 0:
            continue
        for x in range(low[row], high[row]):
            if foreground[row, x] == 0 or deep[row, x] != 0:
                continue
            t0, t1, t2, t3 = 0, 0, 0, 0
            for i in range(x, x + 2 * half + 1):
                t0 += sums[0, i]
                t1 += sums[1, i]
                t2 += sums[2, i]
                t3 += sums[3, i]
            inside = t0 / max(t1, 1)
            outside = t2 / max(t3, 1)
            if inside > outside and largest[row, x] < outside + share * (inside - outside):
                foreground[row, x] = 0


@njit(cache=True, nogil=True)
def _add_row(values, first, sums):
    """sums[first + i] += values[i], of bytes into 16 bits."""
    own = sums[first : first + values.shape[0]]
    for i in range(values.shape[0]):
        own[i] += values[i]


@njit(cache=True, nogil=True)
def _subtract_row(values, first, sums):
    """sums[first + i] -= values[i]."""
    own = sums[first : first + values.shape[0]]
    for i in range(values.shape[0]):
        own[i] -= values[i]


@njit(cache=True, nogil=True, error_model="numpy")
def label_regions(mask, flags, value, reach, runs, area, flagged):
    """Connected regions of the pixels that equal `value`, as runs along rows; returns (runs, regions).

    mask, flags : (h, w) uint8 of 0 and 1, w a multiple of 8.  reach : 1 joins corners (8 neighbours), 0 only sides.
    runs : (h (w / 2 + 1), 4) int32 out, row, first column, column after the last, region.
    area, flagged : as many int64 out, pixels and pixels with a flag of each region.
    """
    h, w = mask.shape
    words = mask.view(np.uint64)
    same = np.uint64(0x0101010101010101) * np.uint64(value)
    other = np.uint64(0x0101010101010101) * np.uint64(1 - value)
    n = 0
    before, here = 0, 0  # first runs of the row above and of this row
    for y in range(h):
        row, word = mask[y], words[y]
        start = -1
        for k in range(w // 8):
            if word[k] == same:
                if start < 0:
                    start = 8 * k
            elif word[k] == other:
                if start >= 0:
                    runs[n, 0], runs[n, 1], runs[n, 2], runs[n, 3] = y, start, 8 * k, n
                    n += 1
                    start = -1
            else:
                for x in range(8 * k, 8 * k + 8):
                    if row[x] == value:
                        if start < 0:
                            start = x
                    elif start >= 0:
                        runs[n, 0], runs[n, 1], runs[n, 2], runs[n, 3] = y, start, x, n
                        n += 1
                        start = -1
        if start >= 0:
            runs[n, 0], runs[n, 1], runs[n, 2], runs[n, 3] = y, start, w, n
            n += 1
        # Two runs of neighbouring rows touch when neither ends before the other begins.
        i = before
        for j in range(here, n):
            while i < here and runs[i, 2] + reach <= runs[j, 1]:
                i += 1
            k = i
            while k < here and runs[k, 1] < runs[j, 2] + reach:
                a, b = _root(runs, k), _root(runs, j)
                if a < b:
                    runs[b, 3] = a
                elif b < a:
                    runs[a, 3] = b
                k += 1
        before, here = here, n
    regions = 0
    for i in range(n):
        if runs[i, 3] == i:
            region = regions  # the root comes before all other runs of its region
            area[region], flagged[region] = 0, 0
            regions += 1
        else:
            region = -1 - runs[runs[i, 3], 3]
        runs[i, 3] = -1 - region
        count = 0
        f = flags[runs[i, 0], runs[i, 1] : runs[i, 2]]
        for x in range(f.shape[0]):
            count += f[x]
        area[region] += runs[i, 2] - runs[i, 1]
        flagged[region] += count
    for i in range(n):
        runs[i, 3] = -1 - runs[i, 3]
    return n, regions


@njit(cache=True, nogil=True, inline="always")
def _root(runs, i):
    while runs[i, 3] != i:
        runs[i, 3] = runs[runs[i, 3], 3]
        i = runs[i, 3]
    return i


@njit(cache=True, nogil=True)
def bounds_of(runs, n_runs, chosen):
    """First row, row after the last, first column, column after the last of the chosen regions; zeros for none."""
    y0, y1, x0, x1 = np.int32(1 << 30), np.int32(0), np.int32(1 << 30), np.int32(0)
    for i in range(n_runs):
        if chosen[runs[i, 3]]:
            y0, y1 = min(y0, runs[i, 0]), max(y1, runs[i, 0] + 1)
            x0, x1 = min(x0, runs[i, 1]), max(x1, runs[i, 2])
    return (y0, y1, x0, x1) if y1 > 0 else (0, 0, 0, 0)


@njit(cache=True, nogil=True)
def paint_regions(mask, runs, n_runs, chosen, value):
    """Set the pixels of the chosen regions to a value.  runs : of label_regions.  chosen : (regions,) bool."""
    for i in range(n_runs):
        if chosen[runs[i, 3]]:
            mask[runs[i, 0], runs[i, 1] : runs[i, 2]] = value


@njit(cache=True, nogil=True, error_model="numpy")
def adapt_rows(rows, background, mean, threshold, near, protect, age, first, stride, rate, patience):
    """Move every stride-th row of the mean towards the picture where that is background; refresh the background.

    rows, background : (H, 3 W) uint8.  threshold : (H, W) uint8.  mean : (H, 3 W) float32.  near : (H, W) uint8, 0 = no
    foreground here or close by.  A pixel adapts where near is 0 and no channel differs by more than its threshold.
    protect : (H, W) uint8, or (0, 0) for none.  age : (H, W) uint16, visits in a row at which the pixel did not adapt
    and was not protected; above `patience` it takes over the picture at once. patience < 0 = never.
    """
    has_protection = protect.shape[0] > 0
    width = near.shape[1]
    free = np.empty(3 * width, dtype=np.float32)
    is_free = np.empty(width, dtype=np.uint8)
    for y in range(first, rows.shape[0], stride):
        a, b, t, m = rows[y], background[y], threshold[y], mean[y]
        close = near[y]
        for x in range(width):
            is_free[x] = np.uint8((_far(a, b, x) <= t[x]) & (close[x] == 0))
        for x in range(width):
            step = rate if is_free[x] != 0 else np.float32(0.0)
            free[3 * x] = step
            free[3 * x + 1] = step
            free[3 * x + 2] = step
        if patience >= 0:
            older, limit = age[y], np.uint16(patience)
            if has_protection:
                for x in range(width):
                    is_free[x] |= np.uint8(protect[y, x] != 0)
            worn = np.uint8(0)
            for x in range(width):
                worn |= np.uint8((is_free[x] == 0) & (older[x] >= limit))
            if worn != 0:
                for x in range(width):
                    if is_free[x] == 0 and older[x] >= limit:
                        is_free[x] = 1  # it begins anew
                        for c in range(3):
                            free[3 * x + c] = np.float32(1.0)
            for x in range(width):
                older[x] = np.uint16(older[x] + np.uint16(1)) if is_free[x] == 0 else np.uint16(0)
        for i in range(3 * width):
            v = m[i] + free[i] * (np.float32(a[i]) - m[i])
            m[i] = v
            b[i] = np.uint8(v + np.float32(0.5))


@njit(cache=True, nogil=True)
def lattice_colours(mask, picture, step, places, colours):
    """Foreground pixels on a lattice inside the picture, row by row, with the mean of 3 x 3 pixels; their number.

    mask : (H, W) bool.  picture : (H, W, 3) uint8.  places : (N, 2) int16 out, column and row.  colours : (N, 3) uint8
    out, rounded down.
    """
    height, width = mask.shape
    first = max(1, step // 2)
    n = 0
    for v in range(first, height - 1, step):
        for u in range(first, width - 1, step):
            if not mask[v, u]:
                continue
            places[n, 0], places[n, 1] = u, v
            for c in range(3):
                total = np.uint16(0)
                for y in range(v - 1, v + 2):
                    for x in range(u - 1, u + 2):
                        total += np.uint16(picture[y, x, c])
                colours[n, c] = total // np.uint16(9)
            n += 1
    return n
