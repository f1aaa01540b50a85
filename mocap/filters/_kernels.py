"""Compiled loops of the exchange of parts between particles; tested against their own plain Python."""

from __future__ import annotations

import numpy as np
from numba import njit

_INSERTION_MAX = 24  # groups up to this size are sorted by insertion, which needs no memory


@njit(cache=True)
def _by_group(groups, order, start):
    """Counting sort: particles in the order of their groups, and where each of the N possible groups starts.

    groups : (N,) in 0..N-1.  order : (N,) out.  start : (N + 1,) out.
    """
    n = groups.shape[0]
    start[:] = 0
    for i in range(n):
        start[groups[i] + 1] += 1
    for g in range(n):
        start[g + 1] += start[g]
    filled = start[:-1].copy()
    for i in range(n):
        g = groups[i]
        order[filled[g]] = i
        filled[g] += 1


@njit(cache=True)
def swap_sources_kernel(log_weights, groups, sources):
    """Inside each group, the first particle takes from the heaviest, and so on; ties keep their order.

    log_weights, groups : (N,), groups in 0..N-1.  sources : (N,) out.
    """
    n = groups.shape[0]
    order = np.empty(n, dtype=np.int64)
    start = np.empty(n + 1, dtype=np.int64)
    _by_group(groups, order, start)
    for g in range(n):
        a, b = start[g], start[g + 1]
        if b - a == 0:
            continue
        givers = order[a:b].copy()
        if b - a <= _INSERTION_MAX:
            for i in range(1, b - a):
                giver = givers[i]
                j = i - 1
                while j >= 0 and log_weights[givers[j]] < log_weights[giver]:
                    givers[j + 1] = givers[j]
                    j -= 1
                givers[j + 1] = giver
        else:
            givers = givers[np.argsort(-log_weights[givers], kind="mergesort")]
        for i in range(b - a):
            sources[order[a + i]] = givers[i]


@njit(cache=True)
def group_weights_kernel(log_weights, groups, order, start, cumulative, log_mean):
    """Distribution of the particles inside every group.

    log_weights, groups : (N,), groups in 0..N-1.  order : (N,), start : (N + 1,) out, as `_by_group`.
    cumulative : (N,) out, along order, up to 1 in each group; uniform where all weights are zero.  log_mean : (N,)
    out, log of the mean weight of each group, -inf for zero and for empty groups.
    """
    n = groups.shape[0]
    _by_group(groups, order, start)
    for g in range(n):
        a, b = start[g], start[g + 1]
        log_mean[g] = -np.inf
        top = -np.inf
        for i in range(a, b):
            top = max(top, log_weights[order[i]])
        if top == -np.inf:
            for i in range(a, b):
                cumulative[i] = (i - a + 1.0) / (b - a)
            continue
        total = 0.0
        for i in range(a, b):
            total += np.exp(log_weights[order[i]] - top)
            cumulative[i] = total
        for i in range(a, b):
            cumulative[i] /= total
        log_mean[g] = top + np.log(total / (b - a))


@njit(cache=True)
def draw_from_groups_kernel(wanted, turn, uniform, order, start, cumulative, sources):
    """One particle for every draw, from the wanted group by its distribution, in equal strata per group.

    wanted : (n,) groups.  turn : (n,) permutation, which deals the strata out.  uniform : (n,) in [0, 1).
    sources : (n,) out.
    """
    n = wanted.shape[0]
    n_groups = start.shape[0] - 1
    n_draws = np.zeros(n_groups, dtype=np.int64)
    n_dealt = np.zeros(n_groups, dtype=np.int64)
    for i in range(n):
        n_draws[wanted[i]] += 1
    for t in range(n):
        i = turn[t]
        g = wanted[i]
        position = (n_dealt[g] + uniform[i]) / n_draws[g]
        n_dealt[g] += 1
        low, high = start[g], start[g + 1] - 1
        while low < high:  # the first cumulative weight above the position; equal ones have weight zero
            middle = (low + high) // 2
            if cumulative[middle] > position:
                high = middle
            else:
                low = middle + 1
        while low > start[g] and cumulative[low] == cumulative[low - 1]:
            low -= 1  # rounding took a last draw to a weight of zero at the end
        sources[i] = order[low]


@njit(cache=True)
def exchange_kernel(base, donor, sources, owner, out):
    """Rows of `base` with some columns from other rows of `donor`.

    base : (n, C).  donor : (N, C).  sources : (n, K) rows.  owner : (C,) which column of `sources` tells the row, -1
    to keep the base's.  out : (n, C).
    """
    for i in range(base.shape[0]):
        for c in range(base.shape[1]):
            k = owner[c]
            if k < 0:
                out[i, c] = base[i, c]
            else:
                out[i, c] = donor[sources[i, k], c]
