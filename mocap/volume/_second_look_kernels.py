"""Compiled loops of the second look. Arrays and scalars only; their numpy twin is in the tests.

What is known of each pixel of a camera is one byte, of bits. The pictures of all cameras lie end to end, each behind
one more pixel, which -1 reads and which holds MASK: who does not see a place speaks against nothing.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from mocap.volume._carve_kernels import n_bits

MASK, SHADOW, DOUBTFUL = np.uint8(1), np.uint8(2), np.uint8(4)
# What is drawn: the volume of a person, the part of it that no camera speaks against, the floor, shadows on it.
VOLUME, SURE, FLOOR, LYING = np.uint8(8), np.uint8(16), np.uint8(32), np.uint8(64)
CHOSEN = np.uint8(128)  # of what is being decided
_CHUNK = 32  # pixels that are looked at together


@njit(cache=True, nogil=True)
def enter_masks(mask, shadow, doubtful, box, picture, either, shadows, doubts):
    """Add the bits MASK, SHADOW and DOUBTFUL to a picture (H, W) uint8, and set `either` (H, W) bool, inside a box.

    mask, shadow, doubtful : (H, W) bool.  box : u0, u1, v0, v1, inclusive.  shadows, doubts : (H W,) int32, get
    the flat pixels with the second and the third bit; returns their numbers.
    """
    u0, u1 = box[0], box[1] + 1
    n, m = 0, 0
    for v in range(box[2], box[3] + 1):
        a, b, c = mask[v, u0:u1], shadow[v, u0:u1], doubtful[v, u0:u1]
        out, some = picture[v, u0:u1], either[v, u0:u1]
        for i in range(a.shape[0]):
            out[i] |= np.uint8(a[i]) | (np.uint8(b[i]) << np.uint8(1)) | (np.uint8(c[i]) << np.uint8(2))
        for i in range(a.shape[0]):
            some[i] = a[i] | b[i]
        for first in range(0, a.shape[0], _CHUNK):
            # Most chunks hold neither, and one look at all of their pixels is quick.
            any_of = np.uint8(0)
            for what in out[first : first + _CHUNK]:
                any_of |= what
            if any_of & (SHADOW | DOUBTFUL) == 0:
                continue
            for i in range(first, min(first + _CHUNK, a.shape[0])):
                if out[i] & SHADOW:
                    shadows[n] = v * picture.shape[1] + u0 + i
                    n += 1
                if out[i] & DOUBTFUL:
                    doubts[m] = v * picture.shape[1] + u0 + i
                    m += 1
    return n, m


@njit(cache=True, nogil=True)
def forget(box, picture, either):
    """Leave only the bit FLOOR of a picture (H, W), and nothing of `either`, inside a box."""
    for v in range(box[2], box[3] + 1):
        out = picture[v, box[0] : box[1] + 1]
        for i in range(out.shape[0]):
            out[i] &= FLOOR
        either[v, box[0] : box[1] + 1] = False


@njit(cache=True, nogil=True)
def count_against(pixels, pictures, start, bits, out):
    """Cameras that see each place and have none of the bits there, into out (N,).

    pixels : (C, N) int32, -1 = not seen.  pictures : of all cameras end to end.  start : (C,) of each.
    """
    out[:] = 0
    for c in range(pixels.shape[0]):
        for i in range(pixels.shape[1]):
            out[i] += (pictures[np.uint64(start[c] + pixels[c, i])] & bits) == 0


@njit(cache=True, nogil=True)
def draw_cubes(pixels, points, axis, half_at_1m, bit, picture, box):
    """Squares about the pixels (n,), -1 = none, of cubes at points (n, 3) m, as `residuals.squares` draws them.

    axis : (4,) the depth of a point.  half_at_1m : half the side of a square, px, at a depth of 1 m.  picture : (H, W)
    uint8, gets the bit.  box : u0, u1, v0, v1, is widened.
    """
    height, width = picture.shape
    for i in range(pixels.shape[0]):
        if pixels[i] < 0:
            continue
        depth = points[i, 0] * axis[0] + points[i, 1] * axis[1] + points[i, 2] * axis[2] + axis[3]
        v = pixels[i] // width
        u = pixels[i] - v * width
        half = half_at_1m / max(depth, 1e-3)
        u0, u1 = max(math.floor(u - half + 0.5), 0), min(math.floor(u + half + 0.5), width - 1)
        v0, v1 = max(math.floor(v - half + 0.5), 0), min(math.floor(v + half + 0.5), height - 1)
        box[0], box[1] = min(box[0], u0), max(box[1], u1)
        box[2], box[3] = min(box[2], v0), max(box[3], v1)
        for y in range(v0, v1 + 1):
            row = picture[y, u0 : u1 + 1]
            for x in range(row.shape[0]):
                row[x] |= bit


@njit(cache=True, nogil=True)
def mark_shadows(pixels, picture, bit, cameras):
    """Add the bit of a camera to `cameras` (N,) int64 where it sees a shadow.

    pixels : (N,) int32, -1 = not seen.  picture : of the camera, flat, behind the pixel that -1 reads.
    """
    for i in range(pixels.shape[0]):
        is_dark = picture[np.uint64(1 + np.int64(pixels[i]))] & SHADOW != 0
        cameras[i] |= bit if is_dark else np.int64(0)


@njit(cache=True, nogil=True)
def lying_shadows(pixels, pictures, start, dark, places, lying):
    """Places of the floor that lie in shadow for a camera, as the others see them: as many dark as bare, and one.

    pixels : (C, N) int32, -1 = not seen.  dark : (N,) cameras that see a shadow, of `mark_shadows`.  The numbers
    of places go into places (N,) int64, and into lying (C, N) int32 their pixels in those cameras, -1 in others.
    Returns how many there are.
    """
    n = 0
    for i in range(pixels.shape[1]):
        if dark[i] == 0:
            continue
        bare = np.int64(0)
        for c in range(pixels.shape[0]):
            bare |= np.int64((pictures[np.uint64(start[c] + pixels[c, i])] & (MASK | SHADOW)) == 0) << c
        n_dark, n_bare = n_bits(dark[i]), n_bits(bare)
        places[n] = i
        for c in range(pixels.shape[0]):
            n_others = n_dark - (dark[i] >> c & 1)
            lies = (n_others >= 1) & (n_others >= n_bare - (bare >> c & 1))
            lying[c, n] = pixels[c, i] if lies else np.int32(-1)
        n += 1
    return n


@njit(cache=True, nogil=True)
def _is_inside(picture, v, u, bit):
    """Whether a pixel and its four neighbours in the picture have a bit."""
    height, width = picture.shape
    both = picture[v, u]
    if v > 0:
        both &= picture[v - 1, u]
    if v < height - 1:
        both &= picture[v + 1, u]
    if u > 0:
        both &= picture[v, u - 1]
    if u < width - 1:
        both &= picture[v, u + 1]
    return (both & bit) != 0


@njit(cache=True, nogil=True)
def _is_person(picture, v, u):
    """Whether a pixel shows the volume of a person, and what nobody speaks against where there is no floor."""
    return _is_inside(picture, v, u, VOLUME) and (
        (picture[v, u] & FLOOR) != 0 or _is_inside(picture, v, u, SURE)
    )


@njit(cache=True, nogil=True)
def shadows_of_persons(picture, shadows, reach, share):
    """Add MASK to what is no shadow of a picture (H, W) uint8.  shadows : (N,) flat pixels of all shadow in it.

    It shows a person, no shadow lies there, and so does `share` of the shadow in the square of 2 reach + 1 pixels.
    """
    height, width = picture.shape
    u0, u1, v0, v1 = width, -1, height, -1
    for pixel in shadows:
        v = pixel // width
        u = pixel - v * width
        if (picture[v, u] & LYING) == 0 and _is_person(picture, v, u):
            picture[v, u] |= CHOSEN
            u0, u1, v0, v1 = min(u0, u), max(u1, u), min(v0, v), max(v1, v)
    if u1 < 0:
        return
    left, right = max(u0 - reach, 0), min(u1 + reach + 1, width)
    some, whole = np.zeros(right - left, np.int32), np.zeros(right - left, np.int32)
    for v in range(v0 - reach, v1 + reach + 1):
        # Sums over columns, which are carried on from row to row; that of row v - reach is complete.
        if v >= 0 and v < height:
            row = picture[v, left:right]
            for i in range(row.shape[0]):
                some[i] += row[i] >> np.uint8(7)
                whole[i] += (row[i] >> np.uint8(1)) & np.uint8(1)
        at = v - reach
        if at < v0:
            continue
        for u in range(u0, u1 + 1):
            if picture[at, u] & CHOSEN == 0:
                continue
            n_some, n_whole = 0, 0
            for i in range(max(u - reach, 0) - left, min(u + reach + 1, width) - left):
                n_some += some[i]
                n_whole += whole[i]
            if n_some >= share * n_whole:
                picture[at, u] |= MASK
        if at - reach >= 0:
            row = picture[at - reach, left:right]
            for i in range(row.shape[0]):
                some[i] -= row[i] >> np.uint8(7)
                whole[i] -= (row[i] >> np.uint8(1)) & np.uint8(1)
    for v in range(v0, v1 + 1):
        row = picture[v, u0 : u1 + 1]
        for i in range(row.shape[0]):
            row[i] &= ~CHOSEN


@njit(cache=True, nogil=True)
def on_no_person(picture, pixels, out):
    """Those of flat pixels (N,) of a picture (H, W) that are of its mask and show no person's volume; their number.

    out : (N,) int32.
    """
    n = 0
    for pixel in pixels:
        v = pixel // picture.shape[1]
        u = pixel - v * picture.shape[1]
        if (picture[v, u] & MASK) != 0 and not _is_person(picture, v, u):
            out[n] = pixel
            n += 1
    return n


@njit(cache=True, nogil=True)
def contact_shadows(rows, seen_from, pictures, start, limits, out):
    """Which pixels (N,) show the floor at somebody's feet, as the other cameras see it, into out bool.

    rows : (N,) of seen_from (M, K, C) int32, pixels of others that see the floor there, and K - 1 places above it;
    -1 = none.  limits : at most so many, of at least so many, see the floor bare, and more than so many nobody at each
    place.
    """
    most_bare, least_others, most_missing = limits
    for i in range(rows.shape[0]):
        seen = seen_from[np.uint64(rows[i])]
        n_bare, n_others = 0, 0
        for c in range(seen.shape[1]):
            n_others += seen[0, c] >= 0
            n_bare += (pictures[np.uint64(start[c] + seen[0, c])] & (MASK | SHADOW)) == 0
        is_shadow = n_bare <= most_bare and n_others >= least_others
        for k in range(1, seen.shape[0]):
            if not is_shadow:
                break
            n_missing = 0
            for c in range(seen.shape[1]):
                n_missing += (pictures[np.uint64(start[c] + seen[k, c])] & MASK) == 0
            is_shadow = n_missing > most_missing
        out[i] = is_shadow


@njit(cache=True, nogil=True)
def remove(picture, pixels, is_gone, reach, mask):
    """Take pixels out of a mask (H, W) uint8, and what would be left of it between.

    pixels : (N,) flat, is_gone : (N,) which of them go.  What is left of a square of 2 reach + 1 pixels goes when more
    than half of the mask in it does; what lies farther than `reach` from the rectangle of all that goes does not count.
    picture : (H, W) uint8 with that mask, gets CHOSEN where the pixels go.
    """
    height, width = picture.shape
    u0, u1, v0, v1 = width, -1, height, -1
    for i in range(pixels.shape[0]):
        if is_gone[i]:
            v = pixels[i] // width
            u = pixels[i] - v * width
            picture[v, u] |= CHOSEN
            u0, u1, v0, v1 = min(u0, u), max(u1, u), min(v0, v), max(v1, v)
    if u1 < 0:
        return
    u0, u1 = max(u0 - reach, 0), min(u1 + reach, width - 1)
    v0, v1 = max(v0 - reach, 0), min(v1 + reach, height - 1)
    for v in range(v0, v1 + 1):
        for u in range(u0, u1 + 1):
            if (picture[v, u] & MASK) == 0:
                continue
            n_gone, n_mask = 0, 0
            for y in range(max(v - reach, v0), min(v + reach, v1) + 1):
                for x in range(max(u - reach, u0), min(u + reach, u1) + 1):
                    n_gone += picture[y, x] >> 7
                    n_mask += picture[y, x] & MASK
            if (picture[v, u] & CHOSEN) != 0 or 2 * n_gone > n_mask:
                mask[v, u] = 0


@njit(cache=True, nogil=True)
def copy_mask(picture, box, mask):
    """The bit MASK of a picture (H, W) inside a box into a mask (H, W) uint8, 0 or 1."""
    for v in range(box[2], box[3] + 1):
        row, out = picture[v, box[0] : box[1] + 1], mask[v, box[0] : box[1] + 1]
        for i in range(row.shape[0]):
            out[i] = row[i] & MASK
