"""Combinatorial resampling: draws from all particles that swapping could make, without making them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mocap.filters._kernels import draw_from_groups_kernel, group_weights_kernel
from mocap.filters.resampling import RESAMPLING
from mocap.filters.swapping import compact_groups
from mocap.filters.weights import normalise_log_weights

Array = NDArray[np.float64]
Indices = NDArray[np.int64]


def combinatorial(
    log_weights: Array, groups: Indices, n: int, *, rng: np.random.Generator, scheme: str = "systematic"
) -> tuple[Indices, Indices]:
    """Draw n particles from the set of all recombinations of parts that swapping allows.

    log_weights : (N, K), -inf for zero, of the K parts of a set.  groups : (N, K), particles among which a part may be
    exchanged. Returns centers (n,), the particles that everything outside the set is taken from, and sources (n, K),
    those that each part is taken from, always of the center's group. The new particles have equal weights.
    When every recombination has weight zero, centers are drawn as if all were equal.

    A center's weight is the product over the parts of the mean weight in its group; summed over the particles that
    agree on all that is placed before, this is W_h = N_h prod_k W_h^k / N_h^k. `scheme` draws the centers; inside a
    group parts are drawn in equal strata and dealt out in random order, independently for each part.
    Source: XN Eq. 5.1, Alg. 5.1; departs from them: the factorials cancel (reading guide 20), and the new weights are
    equal, because the draw has used the weights up.
    """
    N, K = log_weights.shape
    log_center = np.zeros(N)
    grouped = []
    for k in range(K):
        group = compact_groups(groups[:, k])
        order, start = np.empty(N, dtype=np.int64), np.empty(N + 1, dtype=np.int64)
        cumulative, log_mean = np.empty(N), np.empty(N)
        group_weights_kernel(
            np.ascontiguousarray(log_weights[:, k]), group, order, start, cumulative, log_mean
        )
        log_center += log_mean[group]
        grouped.append((group, order, start, cumulative))
    center_weights, _ = normalise_log_weights(log_center)
    centers = RESAMPLING[scheme](center_weights, n, rng=rng)
    sources = np.empty((n, K), dtype=np.int64)
    for k, (group, order, start, cumulative) in enumerate(grouped):
        source = np.empty(n, dtype=np.int64)
        turn, uniform = rng.permutation(n), rng.random(n)
        draw_from_groups_kernel(group[centers], turn, uniform, order, start, cumulative, source)
        sources[:, k] = source
    return centers, sources
