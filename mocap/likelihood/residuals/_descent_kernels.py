"""Levenberg-Marquardt on hull surface and outlines together as one compiled loop; its twin is `filters.refine`."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mocap.body._kernels import BodyArrays
from mocap.likelihood.residuals._outline_kernels import OutlineTerms, outline_equations
from mocap.likelihood.residuals._surface_kernels import SurfaceTerms, surface_equations

_DAMPING_START = 1e-3
_DAMPING_MAX = 1e4


class FitTerms(NamedTuple):
    """What a fit minimises: distances to hull surface and outlines, and unusual angles.

    weights : (2,) of surface and outlines; a weight of 0 leaves one out.  usual : (D,) weight of each column's pull to
    0.
    """

    body: BodyArrays
    surface: SurfaceTerms
    outlines: OutlineTerms
    weights: tuple[float, float]
    usual: NDArray[np.float64]


class Bounds(NamedTuple):
    """Limits of a state.  lower, upper : (D,).  is_circular : (D,) bool, angles without bounds."""

    lower: NDArray[np.float64]
    upper: NDArray[np.float64]
    is_circular: NDArray[np.bool_]


@njit(cache=True, nogil=True)
def fit_equations(state, fit, H, g, H_part, g_part):
    """Weighted robust cost of a state (D,); fills H (D, D) and g (D,).  fit : FitTerms.  H_part, g_part : scratch."""
    weights, usual = fit.weights, fit.usual
    cost = 0.0
    H[:] = 0.0
    g[:] = 0.0
    if weights[0] > 0.0:
        cost += weights[0] * surface_equations(state, fit.body, fit.surface, H, g)
        H *= weights[0]
        g *= weights[0]
    if weights[1] > 0.0:
        H_part[:] = 0.0
        g_part[:] = 0.0
        cost += weights[1] * outline_equations(state, fit.body, fit.outlines, H_part, g_part)
        for a in range(g.shape[0]):
            g[a] += weights[1] * g_part[a]
            for b in range(g.shape[0]):
                H[a, b] += weights[1] * H_part[a, b]
    for a in range(g.shape[0]):
        cost += 0.5 * usual[a] * state[a] * state[a]
        H[a, a] += usual[a]
        g[a] += usual[a] * state[a]
    return cost


@njit(cache=True, nogil=True)
def _factorised(H, damping, free, L):
    """Cholesky factor of H + damping diag H in the free columns into L; False when it is not positive definite."""
    n = H.shape[0]
    for a in range(n):
        if not free[a]:
            continue
        for b in range(a + 1):
            if not free[b]:
                continue
            value = H[a, b] * (1.0 + damping) if a == b else H[a, b]
            for c in range(b):
                if free[c]:
                    value -= L[a, c] * L[b, c]
            if a == b:
                if not value > 0.0:
                    return False
                L[a, a] = math.sqrt(value)
            else:
                L[a, b] = value / L[b, b]
    return True


@njit(cache=True, nogil=True)
def damped_step(H, g, damping, free, L, step):
    """Solve (H + damping diag H) step = -g in the free columns by Cholesky; the others hold still.

    L : (D, D) scratch.  Returns False when the matrix is not positive definite.
    """
    n = g.shape[0]
    step[:] = 0.0
    if not _factorised(H, damping, free, L):
        return False
    for a in range(n):
        if free[a]:
            value = -g[a]
            for c in range(a):
                if free[c]:
                    value -= L[a, c] * step[c]
            step[a] = value / L[a, a]
    for a in range(n - 1, -1, -1):
        if free[a]:
            value = step[a]
            for c in range(a + 1, n):
                if free[c]:
                    value -= L[c, a] * step[c]
            step[a] = value / L[a, a]
    return True


@njit(cache=True, nogil=True)
def add_prior(x, start, prior, is_circular, H, g):
    """Add the pull to the start to H and g; returns its cost.  prior : (D,) weight of each column."""
    cost = 0.0
    for a in range(x.shape[0]):
        d = x[a] - start[a]
        if is_circular[a]:
            d -= 2.0 * math.pi * math.floor((d + math.pi) / (2.0 * math.pi))
        cost += 0.5 * prior[a] * d * d
        H[a, a] += prior[a]
        g[a] += prior[a] * d
    return cost


@njit(cache=True, nogil=True)
def _move_within(x, step, reach, bounds, out):
    """out = x + reach * step, taken back to the bounds."""
    for a in range(x.shape[0]):
        out[a] = min(max(x[a] + reach * step[a], bounds.lower[a]), bounds.upper[a])


@njit(cache=True, nogil=True)
def _find_free(x, g, bounds, free):
    """Columns that are not held at a limit because the step would point out of it."""
    lower, upper = bounds.lower, bounds.upper
    for a in range(x.shape[0]):
        free[a] = not ((x[a] <= lower[a] and g[a] > 0.0) or (x[a] >= upper[a] and g[a] < 0.0))


@njit(cache=True, nogil=True)
def descend(states, fit, bounds, prior, n_iterations, tolerance, reach):
    """Move each of the states (K, D), in place, to a nearby minimum of the weighted cost plus the prior at its start.

    fit : FitTerms.  prior : (D,) weight of each column's pull to the start.  As `filters.refine`: never a state of
    higher cost; columns at a limit are held there while the step points out.  reach : factor on every step.
    """
    # Numbers are copied one by one: an array into another takes 2 s to compile, for the error that they may differ.
    D = states.shape[1]
    is_circular = bounds.is_circular
    x, start, candidate, step = np.empty(D), np.empty(D), np.empty(D), np.zeros(D)
    H, g = np.empty((D, D)), np.empty(D)
    new_H, new_g = np.empty((D, D)), np.empty(D)
    H_part, g_part, L = np.empty((D, D)), np.empty(D), np.zeros((D, D))
    free = np.empty(D, np.bool_)
    for k in range(states.shape[0]):
        step[:] = 0.0
        _move_within(states[k], step, 0.0, bounds, start)
        for a in range(D):
            x[a] = start[a]
        cost = fit_equations(x, fit, H, g, H_part, g_part)
        cost += add_prior(x, start, prior, is_circular, H, g)
        damping = _DAMPING_START
        for _ in range(n_iterations):
            _find_free(x, g, bounds, free)
            new_cost = np.inf
            if damped_step(H, g, damping, free, L, step):
                _move_within(x, step, reach, bounds, candidate)
                new_cost = fit_equations(candidate, fit, new_H, new_g, H_part, g_part)
                new_cost += add_prior(candidate, start, prior, is_circular, new_H, new_g)
            if new_cost < cost:
                gain = (cost - new_cost) / max(cost, 1e-300)
                x, candidate = candidate, x
                H, new_H = new_H, H
                g, new_g = new_g, g
                cost = new_cost
                damping = max(0.3 * damping, 1e-6)
                if gain < tolerance:
                    break
            else:
                damping *= 8.0
                if damping > _DAMPING_MAX:
                    break
        for a in range(D):
            states[k, a] = x[a]
