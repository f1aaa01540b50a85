"""Levenberg-Marquardt on hull surface and outlines together as one compiled loop; its twin is `filters.refine`."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from mocap.likelihood.residuals._outline_kernels import outline_equations
from mocap.likelihood.residuals._surface_kernels import surface_equations

_DAMPING_START = 1e-3
_DAMPING_MAX = 1e4


@njit(cache=True, nogil=True)
def fit_equations(state, body, surface, outlines, weights, usual, H, g, H_part, g_part):
    """Weighted robust cost of hull surface and outlines at a state; fills H (D, D) and g (D,).

    body : (chain, moves, cones).  surface, outlines : the arguments of their kernels after these.  weights : of the
    two; a weight of 0 leaves one out.  usual : (D,) weight of each column's pull to 0.  H_part, g_part : scratch.
    """
    chain, moves, cones = body
    cost = 0.0
    H[:] = 0.0
    g[:] = 0.0
    if weights[0] > 0.0:
        hull, flesh, flesh_joint, may_meet, volume, settings = surface
        cost += weights[0] * surface_equations(
            state, chain, moves, cones, hull, flesh, flesh_joint, may_meet, volume, settings, H, g
        )
        H *= weights[0]
        g *= weights[0]
    if weights[1] > 0.0:
        rays, flesh, flesh_joint, cameras, crops, settings = outlines
        H_part[:] = 0.0
        g_part[:] = 0.0
        cost += weights[1] * outline_equations(
            state, chain, moves, cones, rays, flesh, flesh_joint, cameras, crops, settings, H_part, g_part
        )
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
def damped_step(H, g, damping, free, L, step):
    """Solve (H + damping diag H) step = -g in the free columns by Cholesky; the others hold still.

    L : (D, D) scratch.  Returns False when the matrix is not positive definite.
    """
    n = g.shape[0]
    for a in range(n):
        step[a] = 0.0
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
def descend(
    states, body, surface, outlines, weights, usual, lower, upper, is_circular, prior, n_iterations, tolerance
):
    """Move each of the states (K, D), in place, to a nearby minimum of the weighted cost plus the prior at its start.

    As `filters.refine`: never a state of higher cost; columns at a limit are held there while the step points out.
    """
    D = states.shape[1]
    x, start, candidate, step = np.empty(D), np.empty(D), np.empty(D), np.empty(D)
    H, g = np.empty((D, D)), np.empty(D)
    new_H, new_g = np.empty((D, D)), np.empty(D)
    H_part, g_part, L = np.empty((D, D)), np.empty(D), np.zeros((D, D))
    free = np.empty(D, np.bool_)
    for k in range(states.shape[0]):
        for a in range(D):
            start[a] = min(max(states[k, a], lower[a]), upper[a])
            x[a] = start[a]
        cost = fit_equations(x, body, surface, outlines, weights, usual, H, g, H_part, g_part)
        cost += add_prior(x, start, prior, is_circular, H, g)
        damping = _DAMPING_START
        for _ in range(n_iterations):
            for a in range(D):
                free[a] = not ((x[a] <= lower[a] and g[a] > 0.0) or (x[a] >= upper[a] and g[a] < 0.0))
            is_solved = damped_step(H, g, damping, free, L, step)
            new_cost = np.inf
            if is_solved:
                for a in range(D):
                    candidate[a] = min(max(x[a] + step[a], lower[a]), upper[a])
                new_cost = fit_equations(
                    candidate, body, surface, outlines, weights, usual, new_H, new_g, H_part, g_part
                )
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
        states[k] = x
