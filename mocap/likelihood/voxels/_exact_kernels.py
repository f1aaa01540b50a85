"""The voxel likelihood as one compiled kernel; the honest twin is `exact.part_scores_numpy`.

What makes it fast, measured: every gather goes through unsigned 32-bit indices into slices that start at 0 (signed
ones cost a wrap-around test per access and block vectorisation); two passes per segment, indices first; one 32-bit
cell per voxel that holds the packed volume and a tag, so that stamping is one read and one write without a branch
(a branch mispredicts on every other point); tags carry the particle's number, so that nothing is wiped between
particles; a segment whose bounding sphere lies inside the crop needs no test per point.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mocap.body._kernels import forward_kinematics

# Cell: bits 0-6 smoothed surface, bit 7 occupied, bit 8 two parts of the current particle hold the voxel, and the tag
# of the last point that fell in: bits 9-13 its part (< 32), bits 14-31 its particle (counted from 1, then anew).
_VOLUME = np.uint32(0xFF)
_SURFACE = np.uint32(0x7F)
_DOUBLE = np.uint32(1 << 8)
_ONE = np.uint32(1)
_ZERO = np.uint32(0)
_OCCUPIED_SHIFT = np.uint32(7)
_DOUBLE_SHIFT = np.uint32(8)
_PART_SHIFT = np.uint32(9)
_PARTICLE_SHIFT = np.uint32(14)
_N_TAGS = 2**18
_SAME_PARTICLE = np.uint32((1 << 14) - (1 << 8))
_TAKEN = np.uint8(1 << 7)
MAX_LIMB_PARTS = 7


class Segments(NamedTuple):
    """Points of the flesh that one evaluation needs, segment by segment.

    x, y, z : (M,) float32, m, in the segment's joint frame; within a segment surface points come first.
    start : (S + 1,) first point.  n_surface, joint : (S,).  part : (S,) row of the counts, and what tells parts apart.
    center : (S, 3) m and radius : (S,) m, bounding sphere in the joint's frame.
    n_scored : the first segments, which are scored; the others only take up room.
    """

    x: NDArray[np.float32]
    y: NDArray[np.float32]
    z: NDArray[np.float32]
    start: NDArray[np.int64]
    n_surface: NDArray[np.int64]
    joint: NDArray[np.int64]
    part: NDArray[np.int64]
    center: NDArray[np.float64]
    radius: NDArray[np.float64]
    n_scored: int


class Box(NamedTuple):
    """Where the volume is.  shape, lower : (3,) voxels and m, the crop's; room_lower, room_upper : (3,) m."""

    shape: NDArray[np.int64]
    lower: NDArray[np.float64]
    voxel_size: float
    room_lower: NDArray[np.float64]
    room_upper: NDArray[np.float64]


@njit(cache=True, nogil=True, error_model="numpy")
def _indices_inside(x, y, z, A, b, shape, index):
    """Linear crop indices of points A p + b in voxel units, all of which lie inside the crop."""
    # Scalars, because array elements would be loaded again for every point and keep the loop from vectorising.
    a00, a01, a02, b0 = A[0, 0], A[0, 1], A[0, 2], b[0]
    a10, a11, a12, b1 = A[1, 0], A[1, 1], A[1, 2], b[1]
    a20, a21, a22, b2 = A[2, 0], A[2, 1], A[2, 2], b[2]
    ny = np.int32(shape[1])
    nz = np.int32(shape[2])
    n = x.shape[0]
    y = y[:n]
    z = z[:n]
    index = index[:n]
    for i in range(n):
        u = a00 * x[i] + a01 * y[i] + a02 * z[i] + b0
        v = a10 * x[i] + a11 * y[i] + a12 * z[i] + b1
        w = a20 * x[i] + a21 * y[i] + a22 * z[i] + b2
        # Truncation is rounding down: nothing is negative here.
        index[i] = np.uint32(np.int32(np.int32(np.int32(u) * ny + np.int32(v)) * nz + np.int32(w)))


@njit(cache=True, nogil=True, error_model="numpy")
def _voxel_indices(x, y, z, A, b, shape, index):
    """Linear crop indices of points A p + b in voxel units; 0, a voxel of the empty rim, for points outside."""
    a00, a01, a02, b0 = A[0, 0], A[0, 1], A[0, 2], b[0]
    a10, a11, a12, b1 = A[1, 0], A[1, 1], A[1, 2], b[1]
    a20, a21, a22, b2 = A[2, 0], A[2, 1], A[2, 2], b[2]
    nx = np.float32(shape[0])
    ny = np.float32(shape[1])
    nz = np.float32(shape[2])
    zero = np.float32(0.0)
    n = x.shape[0]
    y = y[:n]
    z = z[:n]
    index = index[:n]
    for i in range(n):
        u = a00 * x[i] + a01 * y[i] + a02 * z[i] + b0
        v = a10 * x[i] + a11 * y[i] + a12 * z[i] + b1
        w = a20 * x[i] + a21 * y[i] + a22 * z[i] + b2
        inside = (u >= zero) & (u < nx) & (v >= zero) & (v < ny) & (w >= zero) & (w < nz)
        # Exact in float32: crops hold fewer than 2^24 voxels.
        linear = (np.floor(u) * ny + np.floor(v)) * nz + np.floor(w)
        index[i] = np.uint32(np.int32(linear if inside else zero))


@njit(cache=True, nogil=True, error_model="numpy")
def _count_outside(x, y, z, A, b, lower, upper):
    """Points A p + b, in voxel units, outside the box lower..upper."""
    a00, a01, a02, b0 = A[0, 0], A[0, 1], A[0, 2], b[0]
    a10, a11, a12, b1 = A[1, 0], A[1, 1], A[1, 2], b[1]
    a20, a21, a22, b2 = A[2, 0], A[2, 1], A[2, 2], b[2]
    l0, l1, l2 = lower[0], lower[1], lower[2]
    h0, h1, h2 = upper[0], upper[1], upper[2]
    n = x.shape[0]
    y = y[:n]
    z = z[:n]
    out = np.int32(0)
    for i in range(n):
        u = a00 * x[i] + a01 * y[i] + a02 * z[i] + b0
        v = a10 * x[i] + a11 * y[i] + a12 * z[i] + b1
        w = a20 * x[i] + a21 * y[i] + a22 * z[i] + b2
        outside = (u < l0) | (u > h0) | (v < l1) | (v > h1) | (w < l2) | (w > h2)
        out += np.int32(1 if outside else 0)
    return out


@njit(cache=True, nogil=True, error_model="numpy")
def place_segment(
    R, t, j, s, center, radius, shape, lower, voxel_size, room_lower, room_upper, A, b, world_center
):
    """Map of segment s on joint j into the crop's voxel units: fills A (3, 3), b (3,) float32 and world_center[s].

    Returns whether its bounding sphere lies wholly inside the crop, and whether it touches the room's border. The
    arguments come one by one: handed on as tuples they cost the fast likelihood 10 % of its time.
    """
    is_inside = True
    touches_border = False
    for r in range(3):
        c = t[j, r]
        for k in range(3):
            A[r, k] = R[j, r, k] / voxel_size
            c += R[j, r, k] * center[s, k]
        b[r] = (t[j, r] - lower[r]) / voxel_size
        # A voxel of room to spare, for float32; false for NaN.
        first = lower[r] + voxel_size
        last = lower[r] + (shape[r] - 1) * voxel_size
        is_inside = is_inside and c - radius[s] > first and c + radius[s] < last
        if c - radius[s] < room_lower[r] or c + radius[s] > room_upper[r]:
            touches_border = True
        world_center[s, r] = c
    return is_inside, touches_border


@njit(cache=True, nogil=True, error_model="numpy")
def _stamp(index, cells, tag):
    for i in range(index.shape[0]):
        k = index[i]
        v = cells[k]
        # v ^ tag is below 2^8 where the same part of the same particle was here, below 2^14 where the same particle.
        is_double = np.uint32((v ^ tag) - _DOUBLE) < _SAME_PARTICLE
        cells[k] = (v & _VOLUME) | tag | (_DOUBLE if is_double else _ZERO)


@njit(cache=True, nogil=True, error_model="numpy")
def _gather(index, cells):
    """How many points lie in occupied voxels and in voxels of several parts, and the sum of the surface map."""
    occupied = _ZERO
    double = _ZERO
    surface = _ZERO
    for i in range(index.shape[0]):
        v = cells[index[i]]
        surface += v & _SURFACE
        occupied += (v >> _OCCUPIED_SHIFT) & _ONE
        double += (v >> _DOUBLE_SHIFT) & _ONE
    return occupied, double, surface


@njit(cache=True, nogil=True, error_model="numpy")
def part_scores_kernel(states, chain, segments, box, crop, cells, counts):
    """Fill counts (N, P', 4) int64: out, double, occupied, surface-sum (0..127 each), of states (N, D).

    chain : `Body.chain`.  crop : (V,) uint8.  cells : (V,) uint32, scratch; what it holds does not matter.
    """
    # Everything is unpacked here: a named tuple handed on costs a reference count per array and call.
    parent, offset, dof_joint, dof_axis, dof_column = chain
    x, y, z = segments.x, segments.y, segments.z
    start, part, joint, n_surface = segments.start, segments.part, segments.joint, segments.n_surface
    center, radius, n_scored = segments.center, segments.radius, segments.n_scored
    shape, lower, voxel_size = box.shape, box.lower, box.voxel_size
    room_lower, room_upper = box.room_lower, box.room_upper
    n_segments = part.shape[0]
    R = np.empty((parent.shape[0], 3, 3))
    t = np.empty((parent.shape[0], 3))
    A = np.empty((3, 3), np.float32)
    b = np.empty(3, np.float32)
    centers = np.empty((n_segments, 3))
    index = np.empty(x.shape[0], np.uint32)
    # The room in the crop's voxel units.
    box_lower = np.empty(3, np.float32)
    box_upper = np.empty(3, np.float32)
    for r in range(3):
        box_lower[r] = (room_lower[r] - lower[r]) / voxel_size
        box_upper[r] = (room_upper[r] - lower[r]) / voxel_size
    for n in range(states.shape[0]):
        particle = n % (_N_TAGS - 1) + 1
        if particle == 1:
            for i in range(crop.shape[0]):
                cells[i] = crop[i]
        forward_kinematics(states[n], parent, offset, dof_joint, dof_axis, dof_column, R, t)
        for s in range(n_segments):
            is_inside, touches_border = place_segment(
                R,
                t,
                joint[s],
                s,
                center,
                radius,
                shape,
                lower,
                voxel_size,
                room_lower,
                room_upper,
                A,
                b,
                centers,
            )
            lo = start[s]
            hi = start[s + 1]
            if is_inside:
                _indices_inside(x[lo:hi], y[lo:hi], z[lo:hi], A, b, shape, index[lo:hi])
            else:
                _voxel_indices(x[lo:hi], y[lo:hi], z[lo:hi], A, b, shape, index[lo:hi])
            if touches_border and s < n_scored:
                counts[n, part[s], 0] += _count_outside(
                    x[lo:hi], y[lo:hi], z[lo:hi], A, b, box_lower, box_upper
                )
            tag = (np.uint32(particle) << _PARTICLE_SHIFT) | (np.uint32(part[s]) << _PART_SHIFT)
            _stamp(index[lo:hi], cells, tag)
        # Points outside the crop all fell on voxel 0: they meet nobody.
        cells[0] = crop[0]
        for s in range(n_scored):
            lo = start[s]
            middle = lo + n_surface[s]
            occupied, double, surface = _gather(index[lo:middle], cells)
            counts[n, part[s], 3] += surface
            more_occupied, more_double, _ = _gather(index[middle : start[s + 1]], cells)
            counts[n, part[s], 2] += occupied + more_occupied
            counts[n, part[s], 1] += double + more_double


@njit(cache=True, nogil=True, error_model="numpy")
def _placed_indices(R, t, segments, s, box, A, b, centers, index):
    """Crop indices of a segment's points under joint transforms R, t; returns whether it touches the room's border."""
    shape, lower, voxel_size = box.shape, box.lower, box.voxel_size
    joint, center, radius = segments.joint, segments.center, segments.radius
    is_inside, touches_border = place_segment(
        R,
        t,
        joint[s],
        s,
        center,
        radius,
        shape,
        lower,
        voxel_size,
        box.room_lower,
        box.room_upper,
        A,
        b,
        centers,
    )
    lo, hi = segments.start[s], segments.start[s + 1]
    x, y, z = segments.x[lo:hi], segments.y[lo:hi], segments.z[lo:hi]
    if is_inside:
        _indices_inside(x, y, z, A, b, shape, index[: hi - lo])
    else:
        _voxel_indices(x, y, z, A, b, shape, index[: hi - lo])
    return touches_border


@njit(cache=True, nogil=True, error_model="numpy")
def take_voxels(state, chain, segments, box, taken):
    """Mark the voxels that the segments of one state (D,) hold: taken (V,) uint8, bit 7."""
    parent, offset, dof_joint, dof_axis, dof_column = chain
    R = np.empty((parent.shape[0], 3, 3))
    t = np.empty((parent.shape[0], 3))
    A = np.empty((3, 3), np.float32)
    b = np.empty(3, np.float32)
    centers = np.empty((segments.part.shape[0], 3))
    index = np.empty(segments.x.shape[0], np.uint32)
    forward_kinematics(state, parent, offset, dof_joint, dof_axis, dof_column, R, t)
    for s in range(segments.part.shape[0]):
        _placed_indices(R, t, segments, s, box, A, b, centers, index)
        for i in range(segments.start[s + 1] - segments.start[s]):
            taken[index[i]] |= _TAKEN
    taken[0] = 0


@njit(cache=True, nogil=True, error_model="numpy")
def limb_scores_kernel(states, chain, segments, box, crop, taken, counts):
    """`part_scores_kernel` for a few parts of states (N, D) while all others hold still.

    segments : of at most seven parts, all scored.  taken : (V,) uint8, bit 7 where the others are (`take_voxels`); the
    other bits are scratch, 0 before and after.
    """
    parent, offset, dof_joint, dof_axis, dof_column = chain
    start, part, n_surface = segments.start, segments.part, segments.n_surface
    n_segments = part.shape[0]
    R = np.empty((parent.shape[0], 3, 3))
    t = np.empty((parent.shape[0], 3))
    A = np.empty((3, 3), np.float32)
    b = np.empty(3, np.float32)
    centers = np.empty((n_segments, 3))
    index = np.empty(segments.x.shape[0], np.uint32)
    box_lower = np.empty(3, np.float32)
    box_upper = np.empty(3, np.float32)
    for r in range(3):
        box_lower[r] = (box.room_lower[r] - box.lower[r]) / box.voxel_size
        box_upper[r] = (box.room_upper[r] - box.lower[r]) / box.voxel_size
    for n in range(states.shape[0]):
        forward_kinematics(states[n], parent, offset, dof_joint, dof_axis, dof_column, R, t)
        for s in range(n_segments):
            lo, hi = start[s], start[s + 1]
            if _placed_indices(R, t, segments, s, box, A, b, centers, index[lo:hi]):
                counts[n, part[s], 0] += _count_outside(
                    segments.x[lo:hi], segments.y[lo:hi], segments.z[lo:hi], A, b, box_lower, box_upper
                )
            own = np.uint8(1 << part[s])
            for i in range(lo, hi):
                taken[index[i]] |= own
        taken[0] = 0
        for s in range(n_segments):
            own = np.uint8(1 << part[s])
            lo, hi = start[s], start[s + 1]
            occupied = _ZERO
            double = _ZERO
            surface = _ZERO
            for i in range(lo, hi):
                k = index[i]
                v = np.uint32(crop[k])
                occupied += v >> _OCCUPIED_SHIFT
                double += _ONE if (taken[k] & ~own) != 0 else _ZERO
                if i < lo + n_surface[s]:
                    surface += v & _SURFACE
            counts[n, part[s], 1] += double
            counts[n, part[s], 2] += occupied
            counts[n, part[s], 3] += surface
        for i in range(index.shape[0]):
            taken[index[i]] &= _TAKEN


@njit(cache=True, nogil=True)
def axes_in_volume(start, end, crop, lower, voxel_size, share):
    """Share of the middles and ends of the axes start..end (N, K, 3) that lie in occupied voxels: fills share (N,)."""
    n_axes = start.shape[1]
    for n in range(start.shape[0]):
        count = 0
        for k in range(n_axes):
            for half in range(2):
                x, y, z = end[n, k, 0], end[n, k, 1], end[n, k, 2]
                if half == 0:
                    x, y, z = (
                        0.5 * (x + start[n, k, 0]),
                        0.5 * (y + start[n, k, 1]),
                        0.5 * (z + start[n, k, 2]),
                    )
                ix = math.floor((x - lower[0]) / voxel_size)
                iy = math.floor((y - lower[1]) / voxel_size)
                iz = math.floor((z - lower[2]) / voxel_size)
                if ix < 0 or iy < 0 or iz < 0:
                    continue
                if ix < crop.shape[0] and iy < crop.shape[1] and iz < crop.shape[2]:
                    count += crop[ix, iy, iz] >> 7
        share[n] = count / (2 * n_axes)
