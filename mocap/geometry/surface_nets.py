"""Naive surface nets: a triangle mesh of the zero level of a sampled function."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Faces = NDArray[np.int64]


def surface_nets(values: Array, origin: Array, cell_m: float) -> tuple[Array, Faces]:
    """Vertices and triangles of {value = 0}, outward orientation (value < 0 is inside).

    values : (nx, ny, nz) samples, positive on the whole border.  origin : (3,) m of sample (0, 0, 0).
    Returns vertices (V, 3) m and faces (F, 3). One vertex per mixed cell (mean of its edge crossings), one
    quad per mixed grid edge. Raises ValueError when the surface touches the border of the grid.
    Source: Gibson, Constrained Elastic Surface Nets, 1998.
    """
    values = _without_checkerboards(values)
    inside = values < 0
    border = (inside[0], inside[-1], inside[:, 0], inside[:, -1], inside[:, :, 0], inside[:, :, -1])
    if any(side.any() for side in border):
        raise ValueError("surface_nets: the surface leaves the grid; give a larger margin")
    cells = tuple(n - 1 for n in values.shape)
    position = np.zeros((*cells, 3))
    count = np.zeros(cells)
    for axis in range(3):
        u, v = (axis + 1) % 3, (axis + 2) % 3
        low = _shifted(values, axis, 0)
        high = _shifted(values, axis, 1)
        crosses = (low < 0) != (high < 0)
        fraction = np.where(crosses, low / np.where(crosses, low - high, 1.0), 0.0)
        for du in (0, 1):
            for dv in (0, 1):
                window = [slice(None)] * 3
                window[u] = slice(du, du + cells[u])
                window[v] = slice(dv, dv + cells[v])
                hit = crosses[tuple(window)]
                count += hit
                position[..., axis] += np.where(hit, fraction[tuple(window)], 0.0)
                position[..., u] += du * hit
                position[..., v] += dv * hit
    used = count > 0
    index = np.full(cells, -1, dtype=np.int64)
    index[used] = np.arange(int(used.sum()))
    local = position[used] / count[used][:, None]
    vertices = origin + (np.argwhere(used) + local) * cell_m
    quads = []
    for axis in range(3):
        u, v = (axis + 1) % 3, (axis + 2) % 3
        low, high = _shifted(inside, axis, 0), _shifted(inside, axis, 1)
        where = np.argwhere(low != high)
        starts_inside = low[tuple(where.T)]
        step_u, step_v = np.eye(3, dtype=np.int64)[u], np.eye(3, dtype=np.int64)[v]
        ring = [index[tuple((where - o).T)] for o in (step_u + step_v, step_v, 0 * step_u, step_u)]
        quad = np.column_stack(ring)
        quads.append(np.where(starts_inside[:, None], quad, quad[:, ::-1]))
    quad = np.concatenate(quads)
    first = np.linalg.norm(vertices[quad[:, 0]] - vertices[quad[:, 2]], axis=1)
    second = np.linalg.norm(vertices[quad[:, 1]] - vertices[quad[:, 3]], axis=1)
    by_first = first <= second
    for _ in range(4):
        faces = _split(quad, by_first)
        edges = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
        code, count = np.unique(edges @ np.array([len(vertices), 1]), return_counts=True)
        crowded = code[count > 2]
        if not len(crowded):
            break
        # Two quads may own the same pair of vertices as diagonal: turn the later one's diagonal.
        diagonal = np.sort(np.where(by_first[:, None], quad[:, [0, 2]], quad[:, [1, 3]]), axis=1)
        diagonal_code = diagonal @ np.array([len(vertices), 1])
        for value in crowded:
            owners = np.flatnonzero(diagonal_code == value)
            by_first[owners[-1:]] = ~by_first[owners[-1:]]
    return vertices, faces


def _without_checkerboards(values: Array) -> Array:
    """Samples in which no grid face has its two inside corners on a diagonal (four quads would meet there)."""
    values = values.copy()
    for _ in range(20):
        changed = False
        for axis in range(3):
            u, v = (axis + 1) % 3, (axis + 2) % 3
            a = _shifted(_shifted(values, u, 0), v, 0)
            b = _shifted(_shifted(values, u, 1), v, 0)
            c = _shifted(_shifted(values, u, 1), v, 1)
            d = _shifted(_shifted(values, u, 0), v, 1)
            ia, ib, ic, id_ = a < 0, b < 0, c < 0, d < 0
            bad = (ia == ic) & (ib == id_) & (ia != ib)
            if bad.any():
                changed = True
                # Views: the outside corner that is nearest to the surface goes just inside.
                for corner, other, outside in ((a, c, ~ia), (b, d, ~ib)):
                    first = bad & outside & (corner <= other)
                    second = bad & outside & ~first
                    corner[first] = -1e-6
                    other[second] = -1e-6
        if not changed:
            break
    return values


def _split(quad: Faces, by_first: NDArray[np.bool_]) -> Faces:
    choose = by_first[:, None]
    faces_a = np.where(choose, quad[:, [0, 1, 2]], quad[:, [0, 1, 3]])
    faces_b = np.where(choose, quad[:, [0, 2, 3]], quad[:, [1, 2, 3]])
    return np.concatenate([faces_a, faces_b])


def _shifted(values: NDArray, axis: int, shift: int) -> NDArray:
    window = [slice(None)] * 3
    window[axis] = slice(shift, values.shape[axis] - 1 + shift)
    return values[tuple(window)]
