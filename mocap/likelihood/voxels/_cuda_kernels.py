"""The voxel likelihood on a CUDA device: a block of threads per particle, whose threads share its points.

What happens to a point is what `_exact_kernels` and `_fast_kernels` do to it: their functions are compiled for the
device as they stand. Points add to whole numbers alone, whose sum is the same in any order: a device gives the same
scores every time.
"""

from __future__ import annotations

import threading
import warnings
from typing import Any

import numpy as np
from numba import cuda, float32, float64, int32, uint32

from mocap.body._kernels import forward_kinematics
from mocap.likelihood.voxels._exact_kernels import (
    _N_TAGS,
    _PART_SHIFT,
    _PARTICLE_SHIFT,
    _count_outside,
    _gather,
    _stamp,
    place_segment,
)
from mocap.likelihood.voxels._fast_kernels import _gather_surface, _is_near_box, _place_in_map, _sum_map

MAX_JOINTS = (
    64  # room for joints, and for segments, in the memory that the threads of a block share; `whole` has 22
)
_THREADS = 128  # of a block: some points of every segment for each
_STAMPS_BYTES = 2**29  # for blocks of the exact likelihood, each of which stamps a crop of its own
_N_COUNTS, _N_SUMS = 4, 5  # whole numbers of a part, exact; of a segment, fast
# numba warns a user of few blocks, which he cannot mend: they are his particles.
warnings.filterwarnings("ignore", ".*Grid size .* under-utilization")


@cuda.jit(device=True)
def _voxel_of(x, y, z, A, b, shape):
    """The linear crop index of a point A p + b, as of `_voxel_indices`: there is no `np.floor` on a device."""
    u = A[0, 0] * x + A[0, 1] * y + A[0, 2] * z + b[0]
    v = A[1, 0] * x + A[1, 1] * y + A[1, 2] * z + b[1]
    w = A[2, 0] * x + A[2, 1] * y + A[2, 2] * z + b[2]
    zero = np.float32(0.0)
    is_above = u >= zero and v >= zero and w >= zero  # false for NaN
    if is_above and u < np.float32(shape[0]) and v < np.float32(shape[1]) and w < np.float32(shape[2]):
        # Truncation is rounding down: nothing is negative here.
        return np.uint32((np.int32(u) * shape[1] + np.int32(v)) * shape[2] + np.int32(w))
    return np.uint32(0)


@cuda.jit(device=True)
def _place_body(state, chain, segments, box, R, t, A, b, centers, touches_border):
    """Joints of a state and maps of the segments, by the threads of a block; all of them wait for the end."""
    if cuda.threadIdx.x == 0:
        forward_kinematics(
            state, chain.parent, chain.offset, chain.dof_joint, chain.dof_axis, chain.dof_column, R, t
        )
    cuda.syncthreads()
    for s in range(cuda.threadIdx.x, segments.part.shape[0], cuda.blockDim.x):
        _, touches_border[s] = place_segment(
            R,
            t,
            segments.joint[s],
            s,
            segments.center,
            segments.radius,
            box.shape,
            box.lower,
            box.voxel_size,
            box.room_lower,
            box.room_upper,
            A[s],
            b[s],
            centers,
        )
    cuda.syncthreads()


@cuda.jit(cache=True)
def exact_kernel(states, chain, box, room, crop, segments, stamps, counts):
    """`part_scores_kernel`.  room : (2, 3) float32, in the crop's voxels.  stamps : (V * blocks,) uint32, scratch."""
    block, first, step = cuda.blockIdx.x, cuda.threadIdx.x, cuda.blockDim.x
    R = cuda.shared.array((MAX_JOINTS, 3, 3), float64)
    t = cuda.shared.array((MAX_JOINTS, 3), float64)
    A = cuda.shared.array((MAX_JOINTS, 3, 3), float32)
    b = cuda.shared.array((MAX_JOINTS, 3), float32)
    centers = cuda.shared.array((MAX_JOINTS, 3), float64)
    touches_border = cuda.shared.array(MAX_JOINTS, int32)
    count = cuda.shared.array(0, int32)
    here = cuda.local.array(1, uint32)
    x, y, z, start, part = segments.x, segments.y, segments.z, segments.start, segments.part
    cells = stamps[block * crop.shape[0] : (block + 1) * crop.shape[0]]
    for n in range(block, states.shape[0], cuda.gridDim.x):
        for i in range(first, _N_COUNTS * counts.shape[1], step):
            count[i] = 0
        _place_body(states[n], chain, segments, box, R, t, A, b, centers, touches_border)
        particle = n // cuda.gridDim.x % (_N_TAGS - 1) + 1
        if particle == 1:
            for i in range(first, crop.shape[0], step):
                cells[i] = crop[i]
            cuda.syncthreads()
        for s in range(part.shape[0]):
            tag = (np.uint32(particle) << _PARTICLE_SHIFT) | (np.uint32(part[s]) << _PART_SHIFT)
            outside = 0
            for i in range(start[s] + first, start[s + 1], step):
                here[0] = _voxel_of(x[i], y[i], z[i], A[s], b[s], box.shape)
                _stamp(here, cells, tag)
                if touches_border[s] and s < segments.n_scored:
                    outside += _count_outside(
                        x[i : i + 1], y[i : i + 1], z[i : i + 1], A[s], b[s], room[0], room[1]
                    )
            if outside:
                cuda.atomic.add(count, _N_COUNTS * part[s], outside)
            # Threads that stamp a voxel for the same part write the same; parts come one after the other.
            cuda.syncthreads()
        if first == 0:
            cells[0] = crop[0]
        cuda.syncthreads()
        for s in range(segments.n_scored):
            occupied = double = surface = 0
            for i in range(start[s] + first, start[s + 1], step):
                here[0] = _voxel_of(x[i], y[i], z[i], A[s], b[s], box.shape)
                more_occupied, more_double, more_surface = _gather(here, cells)
                occupied += more_occupied
                double += more_double
                if i < start[s] + segments.n_surface[s]:
                    surface += more_surface
            cuda.atomic.add(count, _N_COUNTS * part[s] + 1, double)
            cuda.atomic.add(count, _N_COUNTS * part[s] + 2, occupied)
            cuda.atomic.add(count, _N_COUNTS * part[s] + 3, surface)
        cuda.syncthreads()
        for i in range(first, _N_COUNTS * counts.shape[1], step):
            counts[n, i // _N_COUNTS, i % _N_COUNTS] = count[i]


@cuda.jit(device=True)
def _look_up_pair(k, sample, R, t, centers, A, b, here):
    """Sum of the map of a pair's second segment over the points of its first; 0 where they do not meet."""
    segments, overlap = sample.segments, sample.overlap
    u, v = overlap.pairs[k, 0], overlap.pairs[k, 1]
    apart = 0.0
    for r in range(3):
        apart += (centers[u, r] - centers[v, r]) ** 2
    reach = segments.radius[u] + segments.radius[v]
    i, j = segments.joint[u], segments.joint[v]
    if not apart < reach * reach:
        return 0
    if not _is_near_box(centers, u, segments.radius, R, t, j, overlap.box_lower, overlap.box_upper, v):
        return 0
    _place_in_map(R, t, i, j, overlap.map_lower, v, overlap.cell, A, b)
    total = 0
    for q in range(overlap.start[u], overlap.start[u + 1]):
        here[0] = _voxel_of(overlap.x[q], overlap.y[q], overlap.z[q], A, b, overlap.map_shape[v])
        total += _sum_map(here, overlap.maps[overlap.map_start[v] :])
    return total


@cuda.jit(cache=True)
def fast_kernel(states, chain, box, room, crop, sample, scores):
    """`fast_scores_kernel`, whose scores need not be zero.  room : (2, 3) float32, in the crop's voxels."""
    first, step = cuda.threadIdx.x, cuda.blockDim.x
    R = cuda.shared.array((MAX_JOINTS, 3, 3), float64)
    t = cuda.shared.array((MAX_JOINTS, 3), float64)
    A = cuda.shared.array((MAX_JOINTS, 3, 3), float32)
    b = cuda.shared.array((MAX_JOINTS, 3), float32)
    centers = cuda.shared.array((MAX_JOINTS, 3), float64)
    touches_border = cuda.shared.array(MAX_JOINTS, int32)
    total = cuda.shared.array(0, int32)
    here = cuda.local.array(1, uint32)
    A_map = cuda.local.array((3, 3), float32)
    b_map = cuda.local.array(3, float32)
    segments, overlap = sample.segments, sample.overlap
    x, y, z, start, part = segments.x, segments.y, segments.z, segments.start, segments.part
    n_pairs, pairs_from = overlap.pairs.shape[0], _N_SUMS * segments.n_scored
    for n in range(cuda.blockIdx.x, states.shape[0], cuda.gridDim.x):
        for i in range(first, pairs_from, step):
            total[i] = 0
        _place_body(states[n], chain, segments, box, R, t, A, b, centers, touches_border)
        for s in range(segments.n_scored):
            for i in range(start[s] + first, start[s + 1], step):
                inner = 1 if i >= start[s] + segments.n_surface[s] else 0
                here[0] = _voxel_of(x[i], y[i], z[i], A[s], b[s], box.shape)
                occupied, surface = _gather_surface(here, crop)
                cuda.atomic.add(total, _N_SUMS * s + inner, occupied)
                if not inner:
                    cuda.atomic.add(total, _N_SUMS * s + 2, surface)
                if touches_border[s]:
                    outside = _count_outside(
                        x[i : i + 1], y[i : i + 1], z[i : i + 1], A[s], b[s], room[0], room[1]
                    )
                    cuda.atomic.add(total, _N_SUMS * s + 3 + inner, outside)
        for k in range(first, n_pairs, step):
            total[pairs_from + k] = _look_up_pair(k, sample, R, t, centers, A_map, b_map, here)
        cuda.syncthreads()
        for p in range(first, scores.shape[1], step):
            out = double = occupied_share = surface_share = 0.0
            for s in range(segments.n_scored):
                if part[s] == p:
                    o = _N_SUMS * s
                    out += total[o + 3] * sample.share_surface[s]
                    out += total[o + 4] * sample.share_inner[s]
                    occupied_share += total[o] * sample.share_surface[s]
                    occupied_share += total[o + 1] * sample.share_inner[s]
                    surface_share += total[o + 2] * sample.share_of_surface[s]
            for k in range(n_pairs):
                u = overlap.pairs[k, 0]
                if part[u] == p or part[overlap.pairs[k, 1]] == p:
                    shared = overlap.points_per_sample[u] * (total[pairs_from + k] / 255.0)
                    double += shared / sample.size[p]
            scores[n, p, 0] = out
            scores[n, p, 1] = min(double, 1.0)
            scores[n, p, 2] = occupied_share
            scores[n, p, 3] = surface_share
        cuda.syncthreads()


_own = threading.local()


def _stamps(n: int) -> Any:
    """Scratch of n cells on the device, one per thread, kept."""
    held = getattr(_own, "stamps", None)
    if held is None or len(held) < n:
        held = _own.stamps = cuda.device_array(n, np.uint32)
    return held


def uploaded(value: Any) -> Any:
    """Arrays, and tuples of arrays, on the device; numbers as they are."""
    if isinstance(value, np.ndarray):
        return cuda.to_device(value)
    return getattr(type(value), "_make", tuple)(map(uploaded, value)) if isinstance(value, tuple) else value


def exact_counts(states, n_parts, chain, box, room, crop, segments):
    """Counts (N, P', 4) of `part_scores_kernel` for states (N, D).  chain and what follows : as `uploaded` gives it."""
    if not len(states) or not n_parts:
        return np.zeros((len(states), n_parts, _N_COUNTS), np.int64)
    counts = cuda.device_array((len(states), n_parts, _N_COUNTS), np.int64)
    n_blocks = min(len(states), max(1, _STAMPS_BYTES // (4 * crop.size)))
    run = exact_kernel[n_blocks, _THREADS, 0, 4 * _N_COUNTS * n_parts]
    run(cuda.to_device(states), chain, box, room, crop, segments, _stamps(n_blocks * crop.size), counts)
    return counts.copy_to_host()


def fast_scores(states, n_parts, chain, box, room, crop, sample):
    """Scores (N, P', 4) of `fast_scores_kernel` for states (N, D); the rest as in `exact_counts`."""
    if not len(states) or not n_parts:
        return np.zeros((len(states), n_parts, _N_COUNTS))
    scores = cuda.device_array((len(states), n_parts, _N_COUNTS), np.float64)
    n_sums = _N_SUMS * sample.segments.n_scored + sample.overlap.pairs.shape[0]
    run = fast_kernel[len(states), _THREADS, 0, 4 * n_sums]
    run(cuda.to_device(states), chain, box, room, crop, sample, scores)
    return scores.copy_to_host()


def device_name() -> str | None:
    """What the first CUDA device is called; None where none answers."""
    if not cuda.is_available():
        return None
    name = getattr(cuda.current_context().device, "name", "numba's simulator")
    return name.decode() if isinstance(name, bytes) else str(name)
