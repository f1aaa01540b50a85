"""Kernels of texture: where rays enter the flesh, what they teach of its colours there, and how those pull a pose."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mocap.body._kernels import chain_axes
from mocap.likelihood.colours._kernels import see_cones
from mocap.likelihood.residuals._pull_kernels import add_pull, place_points, robust_loss, spread_pulls

_TURN = 2.0 * math.pi
_LEAST_RADIUS = 0.3  # of a cone's: nearer to its axis colours do not turn faster


class Lattice(NamedTuple):
    """Nodes on the flesh of every cone, along its axis, round ends included, and about it.

    axes : (K, 3, 3), rows along the cone's axis and two across, in its joint's frame.  length : (K,) m.  shape : (K, 2)
    nodes along and about.  first : (K,) index of each cone's first node; about runs fastest.
    """

    axes: NDArray[np.float64]
    length: NDArray[np.float64]
    shape: NDArray[np.int64]
    first: NDArray[np.int64]


class SeenRays(NamedTuple):
    """Rays with what they show.  columns : (6, M) float32, origins and unit directions.  colours : (M, 3) luma and
    chroma."""

    columns: NDArray[np.float32]
    colours: NDArray[np.uint8]


class TextureTerms(NamedTuple):
    """Known colours of the flesh.  mean : (N, 3).  inverse : (N, 3) inverse deviation, 0 where nothing is known.
    least_cosine : of the angle at which rays must enter.  scale : deviations at which a pixel loses three quarters of
    its pull."""

    lattice: Lattice
    mean: NDArray[np.float64]
    inverse: NDArray[np.float64]
    least_cosine: float
    scale: float


class _Posed(NamedTuple):
    """A body in one pose.  R, t : (J, 3, 3), (J, 3), joint to world.  axes : of the rotations, (n_dofs, 3).  start :
    (K, 3), of the cones.  cone : (M,) which one each ray enters first, -1 = none."""

    R: NDArray[np.float64]
    t: NDArray[np.float64]
    axes: NDArray[np.float64]
    start: NDArray[np.float64]
    cone: NDArray[np.int32]


@njit(cache=True, nogil=True)
def _pose(state, body, columns):
    """What a state (D,) does to a body, and which of its cones rays enter first."""
    chain, cones = body.chain, body.cones
    J = chain.parent.shape[0]
    R, t, axes = np.empty((J, 3, 3)), np.empty((J, 3)), np.empty((chain.dof_joint.shape[0], 3))
    chain_axes(state, chain, R, t, axes)
    start, end = np.empty_like(cones.start), np.empty_like(cones.end)
    place_points(cones.start, cones.joint, R, t, start)
    place_points(cones.end, cones.joint, R, t, end)
    n = columns.shape[1]
    depth, miss = np.full(n, np.float32(np.inf)), np.zeros(n, np.float32)
    cone, at = np.full(n, np.int32(-1)), np.zeros(n, np.float32)
    see_cones(columns, start, end, cones.radii, depth, miss, cone, at)
    return _Posed(R, t, axes, start, cone)


@njit(cache=True, nogil=True)
def _axes_in_world(R, axes, world):
    """Rows of axes (3, 3), in a joint's frame, turned by its R (3, 3) into world (3, 3)."""
    for a in range(3):
        for r in range(3):
            world[a, r] = R[r, 0] * axes[a, 0] + R[r, 1] * axes[a, 1] + R[r, 2] * axes[a, 2]


@njit(cache=True, nogil=True)
def _along(world, x, y, z):
    """A vector of the world in the frame of three axes, rows of world (3, 3)."""
    return (
        world[0, 0] * x + world[0, 1] * y + world[0, 2] * z,
        world[1, 0] * x + world[1, 1] * y + world[1, 2] * z,
        world[2, 0] * x + world[2, 1] * y + world[2, 2] * z,
    )


@njit(cache=True, nogil=True)
def _entry(w, u, length, radii, k):
    """Where a ray enters a round-ended cone that lies along the first axis from 0.

    w, u : three numbers each, the ray's origin and unit direction.  Returns the place and the outward normal there,
    three numbers each; a normal of 0 where the ray passes by.
    """
    taper = (radii[k, 1] - radii[k, 0]) / max(length, 1e-9)
    r = radii[k, 0] + taper * w[0]
    a = u[1] * u[1] + u[2] * u[2] - taper * taper * u[0] * u[0]
    b = w[1] * u[1] + w[2] * u[2] - taper * r * u[0]
    root = b * b - a * (w[1] * w[1] + w[2] * w[2] - r * r)
    x = w[0] - u[0] * (w[0] * u[0] + w[1] * u[1] + w[2] * u[2])  # nearest to where the cone begins
    if a > 1e-9 and root > 0.0:
        depth = (-b - math.sqrt(root)) / a
        x = w[0] + depth * u[0]
        if 0.0 <= x <= length:
            y, z = w[1] + depth * u[1], w[2] + depth * u[2]
            scale = 1.0 / math.sqrt(1.0 + taper * taper)
            across = scale / (radii[k, 0] + taper * x)
            return (x, y, z), (-scale * taper, across * y, across * z)
    end = 0.0 if x < 0.5 * length else length
    radius = radii[k, 0] if end == 0.0 else radii[k, 1]
    b = (w[0] - end) * u[0] + w[1] * u[1] + w[2] * u[2]
    root = b * b - (w[0] - end) ** 2 - w[1] * w[1] - w[2] * w[2] + radius * radius
    if root <= 0.0:
        return (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    depth = -b - math.sqrt(root)
    x, y, z = w[0] + depth * u[0], w[1] + depth * u[1], w[2] + depth * u[2]
    return (x, y, z), ((x - end) / radius, y / radius, z / radius)


@njit(cache=True, nogil=True)
def _nodes_at(at, k, radii, lattice, node, share, slope):
    """The four nodes about a place on cone k, in its frame: their indices into node (4,), shares into share (4,), and
    how the shares grow with the place, 1/m, into slope (4, 3)."""
    n_along, n_about = lattice.shape[k, 0], lattice.shape[k, 1]
    rise = (n_along - 1) / (lattice.length[k] + radii[k, 0] + radii[k, 1])
    a = (at[0] + radii[k, 0]) * rise
    if a <= 0.0 or a >= n_along - 1:
        a = min(max(a, 0.0), n_along - 1.0)
        rise = 0.0
    i = min(int(a), n_along - 2)
    b = (math.atan2(at[2], at[1]) % _TURN) / _TURN * n_about
    j = int(b) % n_about
    least = _LEAST_RADIUS * min(radii[k, 0], radii[k, 1])
    turn = n_about / _TURN / max(at[1] * at[1] + at[2] * at[2], least * least)
    for q in range(4):
        along, about = q // 2, q % 2
        node[q] = lattice.first[k] + (i + along) * n_about + (j + about) % n_about
        share_along = a - i if along else 1.0 - (a - i)
        share_about = b - math.floor(b) if about else 1.0 - (b - math.floor(b))
        share[q] = share_along * share_about
        slope[q, 0] = (2 * along - 1) * rise * share_about
        slope[q, 1] = -(2 * about - 1) * turn * at[2] * share_along
        slope[q, 2] = (2 * about - 1) * turn * at[1] * share_along


@njit(cache=True, nogil=True)
def _met(posed, columns, i, cones, lattice, world):
    """What ray i meets of the cone that it enters first: its direction, the place and the normal there, three numbers
    each, in the cone's frame; world (3, 3) is filled with the cone's axes."""
    k = posed.cone[i]
    _axes_in_world(posed.R[cones.joint[k]], lattice.axes[k], world)
    w = _along(
        world,
        columns[0, i] - posed.start[k, 0],
        columns[1, i] - posed.start[k, 1],
        columns[2, i] - posed.start[k, 2],
    )
    u = _along(world, columns[3, i], columns[4, i], columns[5, i])
    at, normal = _entry(w, u, lattice.length[k], cones.radii, k)
    return u, at, normal


@njit(cache=True, nogil=True)
def learn_texture(state, body, rays, known, gate, weight, total, square):
    """Add what rays show under a state (D,) to the sums of every node.

    known : TextureTerms, what is known already; a colour further from it than `gate` deviations teaches nothing.
    weight : (N,), total, square : (N, 3), of shares, colours and their squares.
    """
    posed = _pose(state, body, rays.columns)
    cones, lattice, world = body.cones, known.lattice, np.empty((3, 3))
    node, share, slope = np.empty(4, np.int64), np.empty(4), np.empty((4, 3))
    for i in range(posed.cone.shape[0]):
        k = posed.cone[i]
        if k < 0:
            continue
        u, at, n = _met(posed, rays.columns, i, cones, lattice, world)
        if -(n[0] * u[0] + n[1] * u[1] + n[2] * u[2]) < known.least_cosine:
            continue
        _nodes_at(at, k, cones.radii, lattice, node, share, slope)
        is_usual = True
        for c in range(3):
            mean, inverse = 0.0, 0.0
            for q in range(4):
                mean += share[q] * known.mean[node[q], c]
                inverse += share[q] * known.inverse[node[q], c]
            is_usual &= abs(rays.colours[i, c] - mean) * inverse < gate
        if not is_usual:
            continue
        for q in range(4):
            weight[node[q]] += share[q]
            for c in range(3):
                colour = np.float64(rays.colours[i, c])
                total[node[q], c] += share[q] * colour
                square[node[q], c] += share[q] * colour * colour


@njit(cache=True, nogil=True)
def texture_equations(state, body, rays, known, H, g):
    """Robust cost of a state (D,), half the squared deviations summed over rays and channels; adds its normal equations
    to H (D, D) and g (D,)."""
    posed = _pose(state, body, rays.columns)
    cones, lattice, world = body.cones, known.lattice, np.empty((3, 3))
    node, share, slope = np.empty(4, np.int64), np.empty(4), np.empty((4, 3))
    pulls = np.zeros((posed.t.shape[0], 7, 6))
    cost = 0.0
    for i in range(posed.cone.shape[0]):
        k = posed.cone[i]
        if k < 0:
            continue
        u, at, n = _met(posed, rays.columns, i, cones, lattice, world)
        cosine = n[0] * u[0] + n[1] * u[1] + n[2] * u[2]
        if -cosine < known.least_cosine:
            continue
        _nodes_at(at, k, cones.radii, lattice, node, share, slope)
        is_known = True
        for q in range(4):
            is_known &= known.inverse[node[q], 0] > 0.0
        if not is_known:
            continue
        place = (
            posed.start[k, 0] + at[0] * world[0, 0] + at[1] * world[1, 0] + at[2] * world[2, 0],
            posed.start[k, 1] + at[0] * world[0, 1] + at[1] * world[1, 1] + at[2] * world[2, 1],
            posed.start[k, 2] + at[0] * world[0, 2] + at[1] * world[1, 2] + at[2] * world[2, 2],
        )
        for c in range(3):
            mean, inverse, gx, gy, gz = 0.0, 0.0, 0.0, 0.0, 0.0
            for q in range(4):
                colour = known.mean[node[q], c]
                mean += share[q] * colour
                inverse += share[q] * known.inverse[node[q], c]
                gx += slope[q, 0] * colour
                gy += slope[q, 1] * colour
                gz += slope[q, 2] * colour
            residual = (rays.colours[i, c] - mean) * inverse
            loss, weight = robust_loss(residual, known.scale, 1.0)
            cost += loss
            # Where the ray meets the flesh slides over it as the flesh moves.
            slide = (gx * u[0] + gy * u[1] + gz * u[2]) / cosine
            gx, gy, gz = (
                inverse * (gx - slide * n[0]),
                inverse * (gy - slide * n[1]),
                inverse * (gz - slide * n[2]),
            )
            pull = (
                gx * world[0, 0] + gy * world[1, 0] + gz * world[2, 0],
                gx * world[0, 1] + gy * world[1, 1] + gz * world[2, 1],
                gx * world[0, 2] + gy * world[1, 2] + gz * world[2, 2],
            )
            add_pull(place, pull, residual, weight, cones.joint[k], pulls)
    spread_pulls(pulls, body, posed.t, posed.axes, H, g)
    return cost
