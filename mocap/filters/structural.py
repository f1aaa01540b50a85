"""Structural steps of SHBM-APF between its models: particles to a finer or a coarser one, their noise, their number."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mocap.data.hierarchy import LevelsOf
from mocap.filters.crossing import CROSSING
from mocap.filters.resampling import adaptive_systematic

Array = NDArray[np.float64]


def backward(
    particles: Array,
    weights: Array,
    levels: LevelsOf,
    n_particles: Sequence[int],
    *,
    rng: np.random.Generator,
) -> list[Array]:
    """G_backward: a particle set for every model from that of the finest one, (N_i, D) each, coarse to fine.

    Sorted by falling weight and adaptively resampled, so that weights are equal and the index is a rank. Columns that
    a model does not have are pinned.
    Source: CF Eq. 7.22 with 7.3.2.5, Alg. 4.
    """
    sets = []
    for level, n in zip(levels.levels, n_particles, strict=True):
        own = particles[adaptive_systematic(weights, n, rng=rng)]
        sets.append(np.where(level.has, own, levels.pinned))
    return sets


def forward(
    coarse: Array,
    weights: Array,
    fine: Array,
    levels: LevelsOf,
    index: int,
    crossing: str,
    *,
    rng: np.random.Generator,
) -> Array:
    """G_forward: the filtered columns of model `index` - 1 joined with those that model `index` adds, (N, D).

    coarse : (M, D) with weights (M,), just filtered; sorted and adaptively resampled to the size of the finer set.
    fine : (N, D) of model `index`, in the order of rank. Who meets whom is the crossing rule's decision. The result
    has equal weights.
    Source: CF Eq. 7.22 with 7.3.2.3, Alg. 4.
    """
    own = coarse[adaptive_systematic(weights, len(fine), rng=rng)]
    joined = own[CROSSING[crossing](len(fine), rng=rng)]
    added = levels.levels[index].added
    joined[:, added] = fine[:, added]
    return joined


def level_std(
    levels: LevelsOf,
    index: int,
    std: Array,
    n_layers: Sequence[int],
    *,
    survival_rate: float,
    structural_rate: float,
) -> Array:
    """Standard deviations (D,) of the first layer of model `index`; 0 in columns it does not have.

    std : (D,) of a column in the model that adds it. From model to model a covariance shrinks by structural_rate
    (alpha_S) and by survival_rate (alpha) for every layer in between.
    Source: CF Eq. 7.14, 7.23-7.26. Departs from 7.26 as printed in the exponent of alpha_S, which must be the
    number of models passed (as in 7.24 and 7.25), not q - 1.
    """
    factor = np.zeros_like(std)
    for q, level in enumerate(levels.levels[: index + 1]):
        passed = sum(n_layers[q:index])
        factor[level.added] = structural_rate ** (index - q) * survival_rate**passed
    return std * np.sqrt(factor)


def particles_per_level(dimensions: Sequence[int], n_total: int) -> tuple[int, ...]:
    """n_total particles shared out by the number of columns that each model adds, at least 2 each.

    Source: CF Eq. 7.21, 7.28.
    """
    share = np.array(dimensions, dtype=np.float64) / sum(dimensions)
    return tuple(int(n) for n in np.maximum(np.round(n_total * share), 2))


def effective_particles(n_particles: Sequence[int], n_layers: Sequence[int]) -> tuple[int, ...]:
    """How many particle evaluations filter the columns of each model: its own and those of all finer ones.

    Source: CF Eq. 7.20.
    """
    spent = [n * layers for n, layers in zip(n_particles, n_layers, strict=True)]
    return tuple(sum(spent[i:]) for i in range(len(spent)))
