"""Genetic crossing: which coarse particle gives its columns to which fine one, when both lie in the order of weight.

Rules are plain functions `(n, *, rng) -> partners (n,)`, in a registry: fine particle k takes the columns of coarse
particle partners[k]. Every rule is a permutation, so that no particle's columns are lost.
Source: CF 7.3.2.3. The rule itself, Figure 7.9(c), is lost (reading guide 16); decision 16 says which one is ours.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Partners = NDArray[np.int64]

N_PARTITIONS = 10
CROSS_EVERY = 4  # every fourth particle of a partition goes to the opposite one


def direct(n: int, *, rng: np.random.Generator) -> Partners:
    """Rank by rank: the best with the best. The source tried it and found it slow to follow sudden motion."""
    return np.arange(n)


def mirror(n: int, *, rng: np.random.Generator) -> Partners:
    """Partition with partition, and a share of each with the opposite one: high ranks meet low ones.

    Both sets are cut into ten partitions of equal size by rank. Three quarters of a partition's particles are
    associated with the same partition of the other set, one quarter with the partition as far from the other end;
    within partitions at random.
    """
    rank = np.arange(n)
    from_end = np.minimum(rank, n - 1 - rank)
    is_crossed = from_end % CROSS_EVERY == CROSS_EVERY - 1
    wanted = np.where(is_crossed, n - 1 - rank, rank)
    return _shuffled_within_partitions(n, rng)[wanted]


def random(n: int, *, rng: np.random.Generator) -> Partners:
    """Any with any: the other extreme, which ignores the ranks."""
    return rng.permutation(n)


def _shuffled_within_partitions(n: int, rng: np.random.Generator) -> Partners:
    """Ranks, with those of each partition in random order."""
    partition = np.arange(n) * N_PARTITIONS // max(n, 1)
    return np.lexsort((rng.random(n), partition))


CrossingRule = Callable[..., Partners]

CROSSING: dict[str, CrossingRule] = {"direct": direct, "mirror": mirror, "random": random}
