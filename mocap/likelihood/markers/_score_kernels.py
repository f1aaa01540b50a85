"""The marker likelihood as compiled code; the honest twin is `scores.marker_scores_numpy`.

Measured: what depends on the detections alone is done once per frame. The symmetric epipolar distance of every pair of
detections stands in a table, and every cell of a coarse grid over a picture lists the few detections that can be the
closest one to a point in it, in blocks of four so that the search seldom branches on the data (12 us per evaluation
with plain loops, a third of it mispredicted branches).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mocap.body._kernels import forward_kinematics

_BLOCK = 4
OUT_OF_REACH_PX = 1e150  # its square does not overflow, and no gate reaches it


class MarkerPoints(NamedTuple):
    """Markers on a body.  joint : (M,).  offset : (M, 3) m in the joint's frame."""

    joint: NDArray[np.int64]
    offset: NDArray[np.float64]


class Cells(NamedTuple):
    """A coarse grid over every picture.  lower : (C, 2) px, corner of cell (0, 0).  n : (C, 2) columns and rows.  first
    : (C + 1,) number of a picture's first cell.  side : px."""

    lower: NDArray[np.float64]
    n: NDArray[np.int64]
    first: NDArray[np.int64]
    side: float


class Candidates(NamedTuple):
    """Detections that may be the closest one to a point in a cell: cell k lists member[start[k] : stop[k]]."""

    start: NDArray[np.uint32]
    stop: NDArray[np.uint32]
    member: NDArray[np.uint32]


class Search(NamedTuple):
    """Per frame, what the scores look up.  uv : (Q + 1, 2), the last one out of reach of everything.  table : (Q, Q) of
    `epipolar_table`, (0, 0) where it is not wanted."""

    uv: NDArray[np.float64]
    table: NDArray[np.float32]
    cells: Cells
    candidates: Candidates


@njit(cache=True, nogil=True)
def epipolar_table(F, is_pair, detections, table):
    """Squared symmetric epipolar distance (px^2) of detections q, r of views i < j into table[q, r]; -1 for a pair of
    views without epipolar geometry.

    F : (C, C, 3, 3), a point of view i times F[i, j] is its line in view j.  is_pair : (C, C) bool.
    """
    uv, first = detections
    n_views = first.shape[0] - 1
    Q = first[n_views]
    to_j = np.empty((Q, 3))
    to_i = np.empty((Q, 3))
    for i in range(n_views):
        for j in range(i + 1, n_views):
            if not is_pair[i, j]:
                table[first[i] : first[i + 1], first[j] : first[j + 1]] = -1.0
                continue
            for a, b, lines in ((i, j, to_j), (j, i, to_i)):
                G = F[a, b]
                for q in range(first[a], first[a + 1]):
                    u = uv[q, 0]
                    v = uv[q, 1]
                    l0 = G[0, 0] * u + G[0, 1] * v + G[0, 2]
                    l1 = G[1, 0] * u + G[1, 1] * v + G[1, 2]
                    l2 = G[2, 0] * u + G[2, 1] * v + G[2, 2]
                    s = 1.0 / max(math.sqrt(l0 * l0 + l1 * l1), 1e-300)
                    lines[q, 0] = l0 * s
                    lines[q, 1] = l1 * s
                    lines[q, 2] = l2 * s
            for q in range(first[i], first[i + 1]):
                u = uv[q, 0]
                v = uv[q, 1]
                for r in range(first[j], first[j + 1]):
                    in_j = to_j[q, 0] * uv[r, 0] + to_j[q, 1] * uv[r, 1] + to_j[q, 2]
                    in_i = to_i[r, 0] * u + to_i[r, 1] * v + to_i[r, 2]
                    table[q, r] = in_j * in_j + in_i * in_i


@njit(cache=True, nogil=True)
def _reached(at, low, side, gate, n):
    """First and last of n cells from `low` on that lie within the gate of a place, all along one axis."""
    return max(0, math.floor((at - gate - low) / side)), min(n - 1, math.floor((at + gate - low) / side))


@njit(cache=True, nogil=True)
def _near_and_far(low, side):
    """Distances along one axis to the nearest and to the farthest place of a cell that begins at `low`."""
    return max(0.0, max(low, -low - side)), max(abs(low), abs(low + side))


@njit(cache=True, nogil=True)
def _number_candidates(count, start, stop):
    """Fill start and stop from the numbers of candidates, which are set to 0 again; returns the room they need."""
    size = _BLOCK
    for k in range(count.shape[0]):
        n = (count[k] + _BLOCK - 1) // _BLOCK * _BLOCK
        start[k] = size if n > 0 else 0
        stop[k] = size + n if n > 0 else _BLOCK
        size += n
        count[k] = 0
    start[count.shape[0]] = 0
    stop[count.shape[0]] = _BLOCK
    return size


@njit(cache=True, nogil=True)
def closest_cells(detections, cells, gate, start, stop):
    """For every cell of every view the detections that may be the closest one, within the gate, to a point in it.

    Fills start, stop (cells + 1,) of `Candidates` and returns its member: every list is a multiple of four of ascending
    indices, padded with Q. Empty cells, and the last one, share the first four.
    """
    uv, first = detections
    lower, n_cells, cell_first, side = cells
    n_views = first.shape[0] - 1
    Q = first[n_views]
    n_all = cell_first[n_views]
    # The nearest far corner of any detection: what is further than it can be in a cell is never the closest there.
    reach = np.full(n_all, np.inf)
    count = np.zeros(n_all, np.int64)
    member = np.full(_BLOCK, Q).astype(np.uint32)
    for step in range(3):
        for c in range(n_views):
            for q in range(first[c], first[c + 1]):
                x0, x1 = _reached(uv[q, 0], lower[c, 0], side, gate, n_cells[c, 0])
                y0, y1 = _reached(uv[q, 1], lower[c, 1], side, gate, n_cells[c, 1])
                for y in range(y0, y1 + 1):
                    near_v, far_v = _near_and_far(lower[c, 1] + y * side - uv[q, 1], side)
                    for x in range(x0, x1 + 1):
                        near_u, far_u = _near_and_far(lower[c, 0] + x * side - uv[q, 0], side)
                        near = near_u * near_u + near_v * near_v
                        if near > gate * gate:
                            continue
                        k = cell_first[c] + y * n_cells[c, 0] + x
                        if step == 0:
                            reach[k] = min(reach[k], far_u * far_u + far_v * far_v)
                        elif near <= reach[k]:
                            if step == 2:
                                member[start[k] + count[k]] = q
                            count[k] += 1
        if step == 1:
            member = np.full(_number_candidates(count, start, stop), Q).astype(np.uint32)
    return member


@njit(cache=True, nogil=True)
def _closest(at, uv, member, begin, end, gate_2):
    """The closest of some candidates to a place, and its squared distance; 0 and gate_2 where none is nearer."""
    best = np.uint64(0)
    best_2 = gate_2
    a = np.uint64(begin)
    b = np.uint64(end)
    while a < b:
        for _ in range(_BLOCK):
            q = np.uint64(member[a])
            du = at[0] - uv[q, 0]
            dv = at[1] - uv[q, 1]
            d = du * du + dv * dv
            is_closer = d < best_2
            best = q if is_closer else best
            best_2 = d if is_closer else best_2
            a += np.uint64(1)
    return best, best_2


@njit(cache=True, nogil=True)
def _epipolar_score(table, chosen, n_hits, scale):
    """Root mean square over the pairs of the first n_hits chosen detections, at most 1; 1 without a pair."""
    total = 0.0
    n_pairs = 0
    for a in range(np.uint64(n_hits)):
        q = chosen[a]
        for b in range(a + np.uint64(1), np.uint64(n_hits)):
            d = table[q, chosen[b]]
            if d >= 0.0:
                total += d
                n_pairs += 1
    return min(1.0, math.sqrt(total / n_pairs * scale)) if n_pairs > 0 else 1.0


@njit(cache=True, nogil=True)
def _place_markers(markers, R, t, x, y, z):
    """World places of markers (M,) into x, y, z (M,)."""
    joint, offset = markers
    for m in range(joint.shape[0]):
        j = joint[m]
        o0 = offset[m, 0]
        o1 = offset[m, 1]
        o2 = offset[m, 2]
        x[m] = R[j, 0, 0] * o0 + R[j, 0, 1] * o1 + R[j, 0, 2] * o2 + t[j, 0]
        y[m] = R[j, 1, 0] * o0 + R[j, 1, 1] * o1 + R[j, 1, 2] * o2 + t[j, 1]
        z[m] = R[j, 2, 0] * o0 + R[j, 2, 1] * o1 + R[j, 2, 2] * o2 + t[j, 2]


@njit(cache=True, nogil=True)
def marker_scores_kernel(states, chain, markers, views, search, gate, reprojection_weight, scores):
    """Score s_m in [0, 1] of every marker for every state, scores (N, M); 0 = fits, 1 = nothing fits.

    markers : MarkerPoints.  views : Projections.  search : Search.
    """
    parent, offset, dof_joint, dof_axis, dof_column = chain
    # Unpacked once: taken from a tuple inside the loop each array would cost a reference count.
    P, lower, upper = views
    uv, table = search.uv, search.table
    _, n_cells, cell_first, side = search.cells
    start, stop, member = search.candidates
    n_views = P.shape[0]
    n_markers = markers.joint.shape[0]
    gate_2 = gate * gate
    # Two detections inside their gates lie at most about two gates from each other's epipolar lines, in both views.
    epipolar_scale = 1.0 / (8.0 * gate_2)
    per_cell = 1.0 / side
    n_all = cell_first[n_views]
    J = parent.shape[0]
    R = np.empty((J, 3, 3))
    t = np.empty((J, 3))
    x = np.empty(n_markers)
    y = np.empty(n_markers)
    z = np.empty(n_markers)
    u = np.empty(n_markers)
    v = np.empty(n_markers)
    cell = np.empty(n_markers, np.int64)
    is_seen = np.empty(n_markers)
    far = np.empty(n_markers)
    n_seen = np.empty(n_markers)
    n_hits = np.empty(n_markers, np.int64)
    chosen = np.empty((n_markers, n_views + 1), np.uint64)
    for n in range(states.shape[0]):
        forward_kinematics(states[n], parent, offset, dof_joint, dof_axis, dof_column, R, t)
        _place_markers(markers, R, t, x, y, z)
        far[:] = 0.0
        n_seen[:] = 0.0
        n_hits[:] = 0
        for c in range(n_views):
            p00, p01, p02, p03 = P[c, 0, 0], P[c, 0, 1], P[c, 0, 2], P[c, 0, 3]
            p10, p11, p12, p13 = P[c, 1, 0], P[c, 1, 1], P[c, 1, 2], P[c, 1, 3]
            p20, p21, p22, p23 = P[c, 2, 0], P[c, 2, 1], P[c, 2, 2], P[c, 2, 3]
            u0, v0, u1, v1 = lower[c, 0], lower[c, 1], upper[c, 0], upper[c, 1]
            row = n_cells[c, 0]
            cell_0 = cell_first[c]
            for m in range(n_markers):
                s = 1.0 / (p20 * x[m] + p21 * y[m] + p22 * z[m] + p23)
                um = (p00 * x[m] + p01 * y[m] + p02 * z[m] + p03) * s
                vm = (p10 * x[m] + p11 * y[m] + p12 * z[m] + p13) * s
                seen = (s > 0.0) & (s < 1e6) & (um >= u0) & (um <= u1) & (vm >= v0) & (vm <= v1)
                column = np.int32((um - u0) * per_cell if seen else 0.0)
                line = np.int32((vm - v0) * per_cell if seen else 0.0)
                cell[m] = cell_0 + line * row + column if seen else n_all
                is_seen[m] = 1.0 if seen else 0.0
                n_seen[m] += is_seen[m]
                u[m] = um if seen else 0.0
                v[m] = vm if seen else 0.0
            for m in range(n_markers):
                at = (u[m], v[m])
                best, best_2 = _closest(at, uv, member, start[cell[m]], stop[cell[m]], gate_2)
                far[m] += best_2 * is_seen[m]
                chosen[m, n_hits[m]] = best
                n_hits[m] += best_2 < gate_2
        for m in range(n_markers):
            epipolar = 1.0
            if reprojection_weight < 1.0:
                epipolar = _epipolar_score(table, chosen[m], n_hits[m], epipolar_scale)
            reprojection = 1.0
            if n_seen[m] > 0.0:
                reprojection = math.sqrt(far[m] / (n_seen[m] * gate_2))
            scores[n, m] = (1.0 - reprojection_weight) * epipolar + reprojection_weight * reprojection
