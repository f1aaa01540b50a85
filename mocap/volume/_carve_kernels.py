"""Compiled loops of the carver. Arrays and scalars only; each has a numpy twin in the tests.

Blocks of voxels of one size are numbered in C order over the grid. Inside a block of 16 the 64 blocks of 4 are
numbered (x * 4 + y) * 4 + z, its 8 blocks of 8 (x * 2 + y) * 2 + z, and the 64 voxels of a block of 4 again
(x * 4 + y) * 4 + z. Camera sets are bit sets in int64. Gather indices are cast to uint64: a signed index would
make the compiler emit a wrap-around test per access.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

DROP, KEEP, DESCEND = 0, 1, 2
TIE_PX = 1e-7  # values this close below a rounding tie count as the tie; see carve.nearest_pixel
MIN_DEPTH_M = 1e-6
MARGIN_PX = 0.01  # by which enclosing boxes are widened against rounding errors
N_PARAMETERS = 26
HIDDEN = -2  # the pixel of a voxel that lies in the picture, but behind an occluder


@njit(cache=True, nogil=True, error_model="numpy")
def pinhole_pixels(xs, ys, zs, p, width, height, out):
    """Flat pixel index (v * width + u) of n points in one camera; -1 outside its view.

    xs, ys, zs : (n,) m, world.  p : (26,) R row by row, t, fx, fy, cx, cy, k1 k2 p1 p2 k3 k4 k5 k6, limit of the
    normalised radius, fisheye; see carve.camera_parameters.
    Everything is computed for every point and chosen at the end: without branches, and with coordinates apart,
    the compiler works on several points at once.
    """
    r00, r01, r02, r10, r11, r12, r20, r21, r22 = p[0], p[1], p[2], p[3], p[4], p[5], p[6], p[7], p[8]
    tx, ty, tz, fx, fy, cx, cy = p[9], p[10], p[11], p[12], p[13], p[14], p[15]
    k1, k2, p1, p2, k3, k4, k5, k6 = p[16], p[17], p[18], p[19], p[20], p[21], p[22], p[23]
    limit2 = p[24] * p[24]
    w, h = np.float64(width), np.float64(height)
    for i in range(xs.shape[0]):
        x, y, z = xs[i], ys[i], zs[i]
        c = r20 * x + r21 * y + r22 * z + tz
        a = (r00 * x + r01 * y + r02 * z + tx) / c
        b = (r10 * x + r11 * y + r12 * z + ty) / c
        s = a * a + b * b
        radial = (1 + s * (k1 + s * (k2 + s * k3))) / (1 + s * (k4 + s * (k5 + s * k6)))
        ab2 = 2 * a * b
        u = np.floor(fx * (a * radial + p1 * ab2 + p2 * (s + 2 * a * a)) + cx + (0.5 + TIE_PX))
        v = np.floor(fy * (b * radial + p1 * (s + 2 * b * b) + p2 * ab2) + cy + (0.5 + TIE_PX))
        inside = (c > MIN_DEPTH_M) & (s <= limit2) & (u >= 0) & (u < w) & (v >= 0) & (v < h)
        out[i] = np.int32(v * w + u if inside else -1.0)


@njit(cache=True, nogil=True, error_model="numpy")
def fisheye_pixels(xs, ys, zs, p, width, height, out):
    """As pinhole_pixels, for the fisheye model; the limit is an angle, rad."""
    w, h = np.float64(width), np.float64(height)
    for i in range(xs.shape[0]):
        x, y, z = xs[i], ys[i], zs[i]
        c = p[6] * x + p[7] * y + p[8] * z + p[11]
        a = (p[0] * x + p[1] * y + p[2] * z + p[9]) / c
        b = (p[3] * x + p[4] * y + p[5] * z + p[10]) / c
        r = math.sqrt(a * a + b * b)
        theta = math.atan(r)
        t2 = theta * theta
        bent = theta * (1 + t2 * (p[16] + t2 * (p[17] + t2 * (p[18] + t2 * p[19]))))
        scale = bent / r if r > 1e-8 else 1.0
        u = np.floor(p[12] * a * scale + p[14] + (0.5 + TIE_PX))
        v = np.floor(p[13] * b * scale + p[15] + (0.5 + TIE_PX))
        inside = (c > MIN_DEPTH_M) & (theta <= p[24]) & (u >= 0) & (u < w) & (v >= 0) & (v < h)
        out[i] = np.int32(v * w + u if inside else -1.0)


@njit(cache=True, nogil=True)
def times(a0, a1, b0, b1):
    """Interval product."""
    w, x, y, z = a0 * b0, a0 * b1, a1 * b0, a1 * b1
    return min(min(w, x), min(y, z)), max(max(w, x), max(y, z))


@njit(cache=True, nogil=True)
def square(a0, a1):
    """Interval square."""
    low, high = min(abs(a0), abs(a1)), max(abs(a0), abs(a1))
    return (0.0 if a0 <= 0.0 <= a1 else low * low), high * high


@njit(cache=True, nogil=True)
def one_plus(s0, s1, c1, c2, c3, c4):
    """Interval of 1 + s (c1 + s (c2 + s (c3 + s c4))) over s in [s0, s1]."""
    low, high = c4, c4
    for c in (c3, c2, c1, 1.0):
        low, high = times(s0, s1, low, high)
        low += c
        high += c
    return low, high


@njit(cache=True, nogil=True, error_model="numpy")
def pixel_bounds(lower, upper, p):
    """Bounds of the pixels of a box of points: (state, u0, u1, v0, v1), u0 .. v1 as real numbers.

    lower, upper : (3,) m, world.  state : 0 = no point is seen by geometry, 1 = some may be, 2 = all are.
    Interval arithmetic, so the bounds hold for every point between; with state 1 they may be infinite.
    """
    a0 = b0 = c0 = np.inf
    a1 = b1 = c1 = -np.inf
    for corner in range(8):
        x = upper[0] if corner & 1 else lower[0]
        y = upper[1] if corner & 2 else lower[1]
        z = upper[2] if corner & 4 else lower[2]
        c = p[6] * x + p[7] * y + p[8] * z + p[11]
        # On a convex set before the camera a ratio of linear functions is largest and smallest at corners.
        a = (p[0] * x + p[1] * y + p[2] * z + p[9]) / c
        b = (p[3] * x + p[4] * y + p[5] * z + p[10]) / c
        a0, a1 = min(a0, a), max(a1, a)
        b0, b1 = min(b0, b), max(b1, b)
        c0, c1 = min(c0, c), max(c1, c)
    if c1 <= MIN_DEPTH_M:
        return 0, 0.0, 0.0, 0.0, 0.0
    if c0 <= 2 * MIN_DEPTH_M:
        return 1, -np.inf, np.inf, -np.inf, np.inf
    aa0, aa1 = square(a0, a1)
    bb0, bb1 = square(b0, b1)
    s0, s1 = aa0 + bb0, aa1 + bb1
    is_fisheye = p[25] > 0.5
    limit2 = p[24] * p[24]
    if is_fisheye:
        limit2 = math.tan(p[24]) ** 2 if p[24] < 1.57 else np.inf
    slack = 1 + 1e-9
    if s0 > limit2 * slack:
        return 0, 0.0, 0.0, 0.0, 0.0
    state = 2 if s1 * slack < limit2 else 1
    s1 = min(s1, limit2 * slack)
    if is_fisheye:
        # scale = theta / tan(theta) * (1 + ...): the first factor falls with the angle
        t0, t1 = math.atan(math.sqrt(s0)), math.atan(math.sqrt(s1))
        f0 = t1 / math.sqrt(s1) if s1 > 1e-16 else 1.0
        f1 = t0 / math.sqrt(s0) if s0 > 1e-16 else 1.0
        g0, g1 = one_plus(t0 * t0, t1 * t1, p[16], p[17], p[18], p[19])
        m0, m1 = times(f0, f1, g0, g1)
        u0, u1 = times(a0, a1, m0, m1)
        v0, v1 = times(b0, b1, m0, m1)
    else:
        n0, n1 = one_plus(s0, s1, p[16], p[17], p[20], 0.0)
        d0, d1 = one_plus(s0, s1, p[21], p[22], p[23], 0.0)
        if d0 <= 0.0:
            return 1, -np.inf, np.inf, -np.inf, np.inf
        m0, m1 = times(n0, n1, 1 / d1, 1 / d0)
        ab0, ab1 = times(2 * a0, 2 * a1, b0, b1)
        u0, u1 = times(a0, a1, m0, m1)
        v0, v1 = times(b0, b1, m0, m1)
        w0, w1 = times(p[18], p[18], ab0, ab1)
        x0, x1 = times(p[19], p[19], s0 + 2 * aa0, s1 + 2 * aa1)
        y0, y1 = times(p[18], p[18], s0 + 2 * bb0, s1 + 2 * bb1)
        z0, z1 = times(p[19], p[19], ab0, ab1)
        u0, u1, v0, v1 = u0 + w0 + x0, u1 + w1 + x1, v0 + y0 + z0, v1 + y1 + z1
    return state, p[12] * u0 + p[14], p[12] * u1 + p[14], p[13] * v0 + p[15], p[13] * v1 + p[15]


@njit(cache=True, nogil=True)
def enclose_blocks(lower, upper, p, width, height, camera, box, sees_all, sees_some):
    """Enter into the tables of blocks what is certain of one camera without projecting their voxels.

    lower, upper : (n, 3) m, world, first and last voxel centre of each block.  p : (C, 26).
    box : (n, C, 4) int16 u0, u1, v0, v1, holds the pixels of all voxels seen.  sees_all : (n,) int64, bit set
    only if every voxel is seen.  sees_some : bit clear only if none is.
    """
    bit = np.int64(1) << camera
    for i in range(lower.shape[0]):
        state, u0, u1, v0, v1 = pixel_bounds(lower[i], upper[i], p)
        box[i, camera, 0] = 32767
        box[i, camera, 1] = -1
        box[i, camera, 2] = 32767
        box[i, camera, 3] = -1
        u0 = math.floor(max(u0, -2.0) + 0.5 - MARGIN_PX)
        v0 = math.floor(max(v0, -2.0) + 0.5 - MARGIN_PX)
        u1 = math.floor(min(u1, width + 2.0) + 0.5 + MARGIN_PX)
        v1 = math.floor(min(v1, height + 2.0) + 0.5 + MARGIN_PX)
        if state == 0 or u1 < 0 or v1 < 0 or u0 >= width or v0 >= height:
            continue
        sees_some[i] |= bit
        if state == 2 and u0 >= 0 and v0 >= 0 and u1 < width and v1 < height:
            sees_all[i] |= bit
        box[i, camera, 0] = max(u0, 0)
        box[i, camera, 1] = min(u1, width - 1)
        box[i, camera, 2] = max(v0, 0)
        box[i, camera, 3] = min(v1, height - 1)


@njit(cache=True, nogil=True)
def block_centers(block, counts, shape, origin, side, xs, ys, zs, is_real):
    """Centres, m, of the 4096 voxels of a block of 16 in the order of the tables; voxels beyond the grid too.

    is_real : (4096,) uint8 out, 1 inside the grid.
    """
    bz = block % counts[2]
    by = (block // counts[2]) % counts[1]
    bx = block // (counts[2] * counts[1])
    for i in range(4096):
        b, j = i >> 6, i & 63
        x = bx * 16 + (b >> 4) * 4 + (j >> 4)
        y = by * 16 + ((b >> 2) & 3) * 4 + ((j >> 2) & 3)
        z = bz * 16 + (b & 3) * 4 + (j & 3)
        xs[i] = origin[0] + (x + 0.5) * side
        ys[i] = origin[1] + (y + 0.5) * side
        zs[i] = origin[2] + (z + 0.5) * side
        is_real[i] = x < shape[0] and y < shape[1] and z < shape[2]


@njit(cache=True, nogil=True)
def enter_pixels(pixels, is_real, camera, width, table, n_seen, n_hidden, box4, all4, some4):
    """Enter one camera's pixels of the 4096 voxels of a block of 16 into its tables.

    pixels : (4096,) int32, -1 outside the picture, HIDDEN behind an occluder.  table : (64, C, 64) int32, -1 where not
    seen.  n_seen, n_hidden : (64, 64) uint8, added to.  box4 : (64, C, 4) int16.  all4, some4 : (64,) int64 bit sets,
    added to.
    """
    bit = np.int64(1) << camera
    w = np.float64(width)
    for b in range(64):
        found, real, row = pixels[64 * b : 64 * b + 64], is_real[64 * b : 64 * b + 64], table[b, camera]
        seen, hidden = n_seen[b], n_hidden[b]
        n_real, n_inside = 0, 0
        # Without branches, so that the compiler works on several voxels at once.
        for j in range(64):
            row[j] = found[j] if (real[j] != 0) & (found[j] >= 0) else np.int32(-1)
        for j in range(64):
            seen[j] += np.uint8(row[j] >= 0)
        for j in range(64):
            hidden[j] += np.uint8((real[j] != 0) & (found[j] == HIDDEN))
        for j in range(64):
            n_real += real[j]
            n_inside += row[j] >= 0
        u0, u1, v0, v1 = np.int32(32767), np.int32(-1), np.int32(32767), np.int32(-1)
        for j in range(64):
            # A quotient of whole numbers is never rounded up to the next one.
            v = np.int32(np.float64(row[j]) / w)
            u = row[j] - v * np.int32(width)
            inside = row[j] >= 0
            u0, u1 = min(u0, u if inside else np.int32(32767)), max(u1, u if inside else np.int32(-1))
            v0, v1 = min(v0, v if inside else np.int32(32767)), max(v1, v if inside else np.int32(-1))
        box4[b, camera, 0] = u0
        box4[b, camera, 1] = u1
        box4[b, camera, 2] = v0
        box4[b, camera, 3] = v1
        if n_inside > 0:
            some4[b] |= bit
        if n_inside == n_real:
            all4[b] |= bit


@njit(cache=True, nogil=True)
def merge_blocks(box, sees_all, sees_some, high, children, box_out):
    """Box (C, 4) and sets of a block from those of its children: (sees_all, sees_some, high)."""
    everyone, someone, most = np.int64(-1), np.int64(0), 0
    for c in range(box.shape[1]):
        box_out[c, 0] = box_out[c, 2] = 32767
        box_out[c, 1] = box_out[c, 3] = -1
    for k in children:
        everyone &= sees_all[k]
        someone |= sees_some[k]
        most = max(most, high[k])
        for c in range(box.shape[1]):
            box_out[c, 0] = min(box_out[c, 0], box[k, c, 0])
            box_out[c, 1] = max(box_out[c, 1], box[k, c, 1])
            box_out[c, 2] = min(box_out[c, 2], box[k, c, 2])
            box_out[c, 3] = max(box_out[c, 3], box[k, c, 3])
    return everyone, someone, most


@njit(cache=True, nogil=True)
def sum_up_block(n_seen, n_hidden, box4, all4, some4, high4, box8, all8, some8, high8, box16):
    """Levels 8 and 16 of one block of 16 from its blocks of 4: (sees_all, sees_some, high) of the whole."""
    for b in range(64):
        most = 0
        for j in range(64):
            most = max(most, n_seen[b, j] + n_hidden[b, j])
        high4[b] = most
    children = np.empty(8, dtype=np.int64)
    for k in range(8):
        for i in range(8):
            x, y, z = 2 * (k >> 2) + (i >> 2), 2 * ((k >> 1) & 1) + ((i >> 1) & 1), 2 * (k & 1) + (i & 1)
            children[i] = (x * 4 + y) * 4 + z
        all8[k], some8[k], high8[k] = merge_blocks(box4, all4, some4, high4, children, box8[k])
    return merge_blocks(box8, all8, some8, high8, np.arange(8), box16)


class Blocks(NamedTuple):
    """Blocks of one size.  box : (B, C, 4) int16, pixel boxes.  sees_all, sees_some : (B,) int64 bit sets, cameras that
    see all or some of each.  high : (B,) uint8, most views of one voxel.  counts : (3,) blocks along each axis."""

    box: NDArray[np.int16]
    sees_all: NDArray[np.int64]
    sees_some: NDArray[np.int64]
    high: NDArray[np.uint8]
    counts: NDArray[np.int64]


class InnerBlocks(NamedTuple):
    """`Blocks` of one size inside blocks of 16: (T, n, ...) for the T tables there are."""

    box: NDArray[np.int16]
    sees_all: NDArray[np.int64]
    sees_some: NDArray[np.int64]
    high: NDArray[np.uint8]


class Tables(NamedTuple):
    """Exact tables of blocks of 16.  slot : (B,) int32, where those of each block lie, -1 = it has none.  eight, four :
    its blocks of 8 and 4.  pixels : (T, 64, C, 64) int32, of `enter_pixels`.  n_seen, n_hidden : (T, 64, 64) uint8."""

    slot: NDArray[np.int32]
    eight: InnerBlocks
    four: InnerBlocks
    pixels: NDArray[np.int32]
    n_seen: NDArray[np.uint8]
    n_hidden: NDArray[np.uint8]


class Integrals(NamedTuple):
    """Integral images of all cameras end to end, each of the rectangle around its foreground alone.

    start : (C,) where a camera's begins.  rect : (C, 4) u0, u1, v0, v1, inclusive.
    """

    sums: NDArray[np.int32]
    start: NDArray[np.int64]
    rect: NDArray[np.int64]


class Silhouettes(NamedTuple):
    """Masks of one frame.  masks : of all cameras end to end, uint8; one more pixel stands before each, which holds
    what a camera votes that does not see a voxel.  mask_start : (C,) where a camera's begins."""

    integrals: Integrals
    masks: NDArray[np.uint8]
    mask_start: NDArray[np.int64]


class Rule(NamedTuple):
    """When a voxel is occupied: at most n_faulty_views cameras vote background, min_views have it in their picture,
    min_votes vote foreground.  is_strict : a camera that does not see a voxel counts as a miss, else it has no vote.
    counts_votes : whether min_votes has to be looked at; else it follows from the other numbers."""

    n_faulty_views: int
    min_views: int
    min_votes: int
    is_strict: bool
    counts_votes: bool


@njit(cache=True, nogil=True)
def foreground_in(box, integral, start, rect):
    """Foreground pixels in a pixel box u0, u1, v0, v1.

    integral : integral images of all cameras end to end, of the rectangle rect (u0, u1, v0, v1) around all
    foreground alone; this camera's begins at `start`.
    """
    u0, u1 = max(np.int64(box[0]), rect[0]), min(np.int64(box[1]), rect[1])
    v0, v1 = max(np.int64(box[2]), rect[2]), min(np.int64(box[3]), rect[3])
    if u0 > u1 or v0 > v1:
        return np.int64(0)
    row = rect[1] - rect[0] + 2
    top = start + (v0 - rect[2]) * row - rect[0]
    bottom = start + (v1 + 1 - rect[2]) * row - rect[0]
    return (
        np.int64(integral[np.uint64(bottom + u1 + 1)])
        - integral[np.uint64(bottom + u0)]
        - integral[np.uint64(top + u1 + 1)]
        + integral[np.uint64(top + u0)]
    )


@njit(cache=True, nogil=True)
def judge(block, integrals, active, misses, min_votes, rule):
    """Vote of the active cameras on one block: (decision, cameras still undecided, sure misses).

    block : (box (C, 4), sees_all, sees_some).  misses : cameras that are sure not to find anything in what holds it.
    min_votes : active cameras that must find some foreground; otherwise the block is dropped.
    """
    box, sees_all, sees_some = block
    integral, start, rect = integrals
    undecided = np.int64(0)
    n_undecided = 0
    n_votes = 0
    for c in range(box.shape[0]):
        if (active >> c) & 1 == 0:
            continue
        n = np.int64(0)
        sees = (sees_some >> c) & 1
        if not sees and not rule.is_strict:
            continue
        if sees:
            n = foreground_in(box[c], integral, start[c], rect[c])
            n_votes += n > 0
        if n == 0 and (rule.is_strict or (sees_all >> c) & 1):
            misses += 1
            if misses > rule.n_faulty_views:
                return DROP, undecided, misses
            continue
        area = (np.int64(box[c, 1]) - box[c, 0] + 1) * (np.int64(box[c, 3]) - box[c, 2] + 1)
        if n < area or (rule.is_strict and not (sees_all >> c) & 1):
            undecided |= np.int64(1) << c
            n_undecided += 1
    if n_votes < min_votes:
        return DROP, undecided, misses
    if misses + n_undecided <= rule.n_faulty_views:
        return KEEP, undecided, misses
    return DESCEND, undecided, misses


@njit(cache=True, nogil=True)
def place_of(block, counts):
    """Subscripts of a block on its grid of blocks, three numbers."""
    return block // (counts[2] * counts[1]), (block // counts[2]) % counts[1], block % counts[2]


@njit(cache=True, nogil=True)
def children_of(block, huge, large):
    """The blocks of 16 in a block of 64, ascending."""
    x64, y64, z64 = place_of(block, huge.counts)
    counts = large.counts
    children = np.empty(64, np.int64)
    n = 0
    for x in range(4 * x64, min(4 * x64 + 4, counts[0])):
        for y in range(4 * y64, min(4 * y64 + 4, counts[1])):
            for z in range(4 * z64, min(4 * z64 + 4, counts[2])):
                children[n] = (x * counts[1] + y) * counts[2] + z
                n += 1
    return children[:n]


@njit(cache=True, nogil=True)
def survey(huge, large, integrals, rule, out):
    """Blocks of 16 that cannot be dropped by their pixel boxes, into out; returns their number.

    huge, large : Blocks of 64 and 16.
    """
    n = 0
    everyone = (np.int64(1) << large.box.shape[1]) - 1
    for b64 in range(huge.box.shape[0]):
        if huge.high[b64] < rule.min_views:
            continue
        block = (huge.box[b64], huge.sees_all[b64], huge.sees_some[b64])
        if judge(block, integrals, everyone, 0, rule.min_votes, rule)[0] == DROP:
            continue
        for b in children_of(b64, huge, large):
            if large.high[b] < rule.min_views:
                continue
            block = (large.box[b], large.sees_all[b], large.sees_some[b])
            if judge(block, integrals, everyone, 0, rule.min_votes, rule)[0] != DROP:
                out[n] = b
                n += 1
    return n


@njit(cache=True, nogil=True)
def part_of_block(k, i):
    """Subscripts among the 4 x 4 x 4 blocks of 4 of a block of 16, of the i-th block of 4 in its k-th block of 8."""
    return 2 * (k >> 2) + (i >> 2), 2 * ((k >> 1) & 1) + ((i >> 1) & 1), 2 * (k & 1) + (i & 1)


@njit(cache=True, nogil=True)
def carve_blocks(blocks, large, tables, silhouettes, rule, grid_shape, out):
    """Occupied voxels of blocks of 16 by blocks of 8 and 4; linear indices into out, returns their number.

    A block is dropped when more than n_faulty_views cameras that see all of it find no foreground in its pixel box,
    kept when at most so many cameras could still vote background, else opened with the undecided cameras. Where the
    rule counts votes all of these are asked, because a voxel needs min_votes; else min_votes must follow from min_views
    and n_faulty_views.
    """
    # Unpacked once: taken from a tuple inside the loop each array would cost a reference count.
    integrals, masks, mask_start = silhouettes.integrals, silhouettes.masks, silhouettes.mask_start
    box16, all16, some16, high16, counts16 = large
    box8, all8, some8, high8 = tables.eight
    box4, all4, some4, high4 = tables.four
    slot, table, n_seen, n_hidden = tables.slot, tables.pixels, tables.n_seen, tables.n_hidden
    tolerance, min_views = rule.n_faulty_views, rule.min_views
    ny, nz = grid_shape[1], grid_shape[2]
    n_cameras = box16.shape[1]
    everyone = (np.int64(1) << n_cameras) - 1
    n = 0
    sums = np.zeros(64, dtype=np.uint8)
    for b16 in blocks:
        if high16[b16] < min_views:
            continue
        block = (box16[b16], all16[b16], some16[b16])
        d16, open16, m16 = judge(block, integrals, everyone, 0, rule.min_votes, rule)
        if d16 == DROP:
            continue
        t = slot[b16]
        x16, y16, z16 = place_of(b16, counts16)
        for k in range(8):
            if high8[t, k] < min_views:
                continue
            d8, open8, m8 = judge((box8[t, k], all8[t, k], some8[t, k]), integrals, open16, m16, 0, rule)
            if d8 == DROP:
                continue
            for i in range(8):
                x4, y4, z4 = part_of_block(k, i)
                b = (x4 * 4 + y4) * 4 + z4
                if high4[t, b] < min_views:
                    continue
                d4, open4, m4 = judge((box4[t, b], all4[t, b], some4[t, b]), integrals, open8, m8, 0, rule)
                if d4 == DROP:
                    continue
                sums[:] = m4
                if d4 == DESCEND or rule.counts_votes:
                    for c in range(n_cameras):
                        if (open4 >> c) & 1:
                            first = mask_start[c]
                            row = table[t, b, c]
                            for j in range(64):
                                # -1 reads the pixel before each mask, which holds the vote of "not seen"
                                sums[j] += np.uint8(1) - masks[np.uint64(first + np.int64(row[j]))]
                corner = ((x16 * 16 + x4 * 4) * ny + y16 * 16 + y4 * 4) * nz + z16 * 16 + z4 * 4
                for j in range(64):
                    if (
                        sums[j] <= tolerance
                        and n_seen[t, b, j] + n_hidden[t, b, j] >= min_views
                        and n_seen[t, b, j] - sums[j] >= rule.min_votes
                    ):
                        out[n] = corner + ((j >> 4) * ny + ((j >> 2) & 3)) * nz + (j & 3)
                        n += 1
    return n


@njit(cache=True, nogil=True)
def unknown_voxels(blocks, large, tables, silhouettes, rule, room, out):
    """Voxels of blocks of 16 that nobody speaks against and too few can judge; their number.

    They lie in the picture of min_views cameras, at most n_faulty_views vote background, fewer than min_votes
    foreground, and at least one lies behind an occluder. Blocks against which more cameras speak as a whole are dropped
    as in `carve_blocks`.  room : (grid_shape, lower, upper), (3,) each, subscripts of the box that is asked for, upper
    exclusive.  out : linear indices.
    """
    grid_shape, lower, upper = room
    integrals, masks, mask_start = silhouettes.integrals, silhouettes.masks, silhouettes.mask_start
    box16, all16, some16, _, counts16 = large
    box8, all8, some8, _ = tables.eight
    box4, all4, some4, _ = tables.four
    slot, table, n_seen, n_hidden = tables.slot, tables.pixels, tables.n_seen, tables.n_hidden
    ny, nz = grid_shape[1], grid_shape[2]
    n_cameras = table.shape[2]
    everyone = (np.int64(1) << n_cameras) - 1
    n = 0
    for b16 in blocks:
        d16, open16, m16 = judge((box16[b16], all16[b16], some16[b16]), integrals, everyone, 0, 0, rule)
        if d16 == DROP:
            continue
        t = slot[b16]
        x16, y16, z16 = place_of(b16, counts16)
        for k in range(8):
            d8, open8, m8 = judge((box8[t, k], all8[t, k], some8[t, k]), integrals, open16, m16, 0, rule)
            if d8 == DROP:
                continue
            for i in range(8):
                x4, y4, z4 = part_of_block(k, i)
                b = (x4 * 4 + y4) * 4 + z4
                most_hidden = np.uint8(0)
                for j in range(64):
                    most_hidden = max(most_hidden, n_hidden[t, b, j])
                if most_hidden == 0:
                    continue
                d4, _, _ = judge((box4[t, b], all4[t, b], some4[t, b]), integrals, open8, m8, 0, rule)
                if d4 == DROP:
                    continue
                for j in range(64):
                    seen, hidden = np.int64(n_seen[t, b, j]), np.int64(n_hidden[t, b, j])
                    if hidden == 0 or seen + hidden < rule.min_views:
                        continue
                    x = x16 * 16 + x4 * 4 + (j >> 4)
                    y = y16 * 16 + y4 * 4 + ((j >> 2) & 3)
                    z = z16 * 16 + z4 * 4 + (j & 3)
                    if x < lower[0] or y < lower[1] or z < lower[2]:
                        continue
                    if x >= upper[0] or y >= upper[1] or z >= upper[2]:
                        continue
                    votes = 0
                    for c in range(n_cameras):
                        pixel = np.int64(table[t, b, c, j])
                        if pixel >= 0:
                            votes += masks[np.uint64(mask_start[c] + pixel)]
                    if votes < rule.min_votes and seen - votes <= rule.n_faulty_views:
                        out[n] = (x * ny + y) * nz + z
                        n += 1
    return n


@njit(cache=True, nogil=True)
def count_votes(box, sees_some, integrals, active):
    """(cameras still undecided, cameras that vote foreground wherever they see) of one block.  box : (C, 4)."""
    integral, start, rect = integrals
    undecided, sure = np.int64(0), np.int64(0)
    for c in range(box.shape[0]):
        if (active & sees_some) >> c & 1 == 0:
            continue
        n = foreground_in(box[c], integral, start[c], rect[c])
        if n == 0:
            continue
        area = (np.int64(box[c, 1]) - box[c, 0] + 1) * (np.int64(box[c, 3]) - box[c, 2] + 1)
        if n < area:
            undecided |= np.int64(1) << c
        else:
            sure |= np.int64(1) << c
    return undecided, sure


@njit(cache=True, nogil=True)
def n_bits(bits):
    """Members of a camera set."""
    n = 0
    while bits:
        bits &= bits - 1
        n += 1
    return n


@njit(cache=True, nogil=True)
def survey_votes(huge, large, integrals, min_votes, out):
    """Blocks of 16 in which a voxel may have min_votes, into out; returns their number.  huge, large : as of survey."""
    n = 0
    everyone = (np.int64(1) << large.box.shape[1]) - 1
    for b64 in range(huge.box.shape[0]):
        undecided, sure = count_votes(huge.box[b64], huge.sees_some[b64], integrals, everyone)
        if n_bits(undecided | sure) < min_votes:
            continue
        for b in children_of(b64, huge, large):
            undecided, sure = count_votes(large.box[b], large.sees_some[b], integrals, everyone)
            if n_bits(undecided | sure) >= min_votes:
                out[n] = b
                n += 1
    return n


@njit(cache=True, nogil=True)
def vote_blocks(blocks, large, tables, silhouettes, min_votes, grid_shape, out):
    """Voxels of blocks of 16 with at least min_votes foreground votes, their votes and views; their number.

    out : (voxels, votes, views).  The pixel before each mask must be background: -1, "not seen", reads it and adds no
    vote.
    """
    integrals, masks, mask_start = silhouettes.integrals, silhouettes.masks, silhouettes.mask_start
    box16, some16 = large.box, large.sees_some
    box8, some8 = tables.eight.box, tables.eight.sees_some
    box4, some4 = tables.four.box, tables.four.sees_some
    slot, table, n_seen = tables.slot, tables.pixels, tables.n_seen
    voxels_out, votes_out, seen_out = out
    ny, nz = grid_shape[1], grid_shape[2]
    n_cameras = box16.shape[1]
    everyone = (np.int64(1) << n_cameras) - 1
    n = 0
    sums = np.zeros(64, dtype=np.uint8)
    for b16 in blocks:
        open16, sure16 = count_votes(box16[b16], some16[b16], integrals, everyone)
        if n_bits(open16 | sure16) < min_votes:
            continue
        t = slot[b16]
        x16, y16, z16 = place_of(b16, large.counts)
        for k in range(8):
            open8, sure8 = count_votes(box8[t, k], some8[t, k], integrals, open16)
            sure8 |= sure16 & some8[t, k]
            if n_bits(open8 | sure8) < min_votes:
                continue
            for i in range(8):
                x4, y4, z4 = part_of_block(k, i)
                b = (x4 * 4 + y4) * 4 + z4
                open4, sure4 = count_votes(box4[t, b], some4[t, b], integrals, open8)
                sure4 |= sure8 & some4[t, b]
                if n_bits(open4 | sure4) < min_votes:
                    continue
                sums[:] = 0
                for c in range(n_cameras):
                    if ((open4 | sure4) >> c) & 1:
                        first = mask_start[c]
                        row = table[t, b, c]
                        for j in range(64):
                            sums[j] += masks[np.uint64(first + np.int64(row[j]))]
                corner = ((x16 * 16 + x4 * 4) * ny + y16 * 16 + y4 * 4) * nz + z16 * 16 + z4 * 4
                for j in range(64):
                    if sums[j] >= min_votes:
                        voxels_out[n] = corner + ((j >> 4) * ny + ((j >> 2) & 3)) * nz + (j & 3)
                        votes_out[n] = sums[j]
                        seen_out[n] = n_seen[t, b, j]
                        n += 1
    return n
