"""Exchanges of parts between particles, against enumeration of all that is allowed."""

from collections import Counter
from collections.abc import Callable, Iterator
from itertools import permutations, product
from math import factorial

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from linear_gaussian_tree import LinearGaussianTree, tree_layout

from mocap.data import StateLayout
from mocap.filters import _kernels
from mocap.filters.combinatorial import combinatorial
from mocap.filters.partitioned import Partial
from mocap.filters.parts import owners
from mocap.filters.pfcr import combine_parts
from mocap.filters.sbps import swap_parts
from mocap.filters.swapping import parents_placement, placements, swap_sources

CONVEX: tuple[Callable[[np.ndarray], np.ndarray], ...] = (lambda w: w, np.square, np.exp)


def admissible(groups: np.ndarray) -> Iterator[np.ndarray]:
    """All permutations of particles that stay inside their groups.  groups : (N,)."""
    members = [np.flatnonzero(groups == g) for g in np.unique(groups)]
    for choice in product(*(permutations(m) for m in members)):
        sigma = np.empty(len(groups), dtype=np.int64)
        for m, c in zip(members, choice, strict=True):
            sigma[m] = c
        yield sigma


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("f", CONVEX)
def test_no_exchange_makes_the_sum_of_convex_weights_larger(seed: int, f: Callable) -> None:
    """XN Proposition 4-3 by enumeration: 5 particles in 2 groups, 2 parts."""
    rng = np.random.default_rng(seed)
    groups = np.array([0, 1, 0, 1, 0])
    w = rng.random((5, 2))
    best = max(f(w[a, 0] * w[b, 1]).sum() for a in admissible(groups) for b in admissible(groups))
    v = np.stack([w[swap_sources(np.log(w[:, k]), groups), k] for k in range(2)], axis=1)
    assert f(v.prod(axis=1)).sum() == pytest.approx(best, rel=1e-12)


@given(
    seed=st.integers(0, 9999), n=st.integers(2, 40), n_groups=st.integers(1, 12), n_parts=st.integers(1, 5)
)
def test_swapping_never_lowers_the_sum(seed: int, n: int, n_groups: int, n_parts: int) -> None:
    rng = np.random.default_rng(seed)
    groups = rng.integers(0, n_groups, n)
    w = rng.random((n, n_parts)) * (rng.random((n, n_parts)) > 0.2)
    with np.errstate(divide="ignore"):
        sources = [swap_sources(np.log(w[:, k]), groups) for k in range(n_parts)]
    v = np.stack([w[s, k] for k, s in enumerate(sources)], axis=1)
    for s in sources:
        assert sorted(s) == list(range(n))
        np.testing.assert_array_equal(groups[s], groups)
    for f in CONVEX:
        assert f(v.prod(axis=1)).sum() >= f(w.prod(axis=1)).sum() * (1 - 1e-12)


def test_the_example_of_the_source() -> None:
    """XN Figure 4-10: values of the two forearms are their weights."""
    groups = np.array([1, 1, 1, 2, 2])
    left, right = np.array([6.0, 5, 7, 11, 10]), np.array([9.0, 12, 8, 13, 14])
    np.testing.assert_array_equal(left[swap_sources(np.log(left), groups)], [7, 6, 5, 11, 10])
    np.testing.assert_array_equal(right[swap_sources(np.log(right), groups)], [12, 9, 8, 14, 13])


TREE = tree_layout([-1, 0, 0, 1, 2, 2, 3], [2, 1, 2, 1, 1, 3, 1])


def partial_of(layout: StateLayout, n: int, n_copied: int, seed: int) -> tuple[Partial, LinearGaussianTree]:
    """Particles whose root was copied from a few, with the second set just placed and scored."""
    rng = np.random.default_rng(seed)
    problem = LinearGaussianTree(layout, rng.normal(size=layout.n_parts), 0.7)
    root = rng.integers(0, n_copied, n)
    particles = rng.normal(size=(n, layout.n_columns))
    particles[:, layout.columns_of(0)] = rng.normal(size=(n_copied, len(layout.columns_of(0))))[root]
    scores = np.zeros((n, layout.n_parts))
    scores[:, [0, 1, 2]] = problem.log_likelihood(particles, [0, 1, 2])
    placed = np.zeros((n, layout.n_parts), dtype=np.int64)
    placed[:, 0] = root
    placed[:, 1] = placed[:, 2] = np.arange(n)
    return Partial(particles, np.full(n, 1 / n), scores, placed), problem


def rows_of(layout: StateLayout, particles: np.ndarray, parts: list[int]) -> Counter:
    columns = layout.columns_of(parts)
    return Counter(map(tuple, particles[:, columns].tolist()))


@pytest.mark.parametrize(("n", "n_copied"), [(30, 7), (30, 30), (9, 1), (3, 50)])
def test_swapping_changes_no_subtree_and_nothing_else(n: int, n_copied: int) -> None:
    """Each part's subtree together with its parent occurs as often as before, and scores travel with their parts.

    (3, 50): fewer particles than groups, so that nobody finds a partner.
    """
    partial, problem = partial_of(TREE, n, n_copied, seed=n)
    swapped = swap_parts(TREE, partial, [1, 2], scheme="systematic", rng=np.random.default_rng(0))
    for part in (1, 2):
        family = [0, *np.flatnonzero(owners(TREE, [part]) == 0)]
        assert rows_of(TREE, swapped.particles, family) == rows_of(TREE, partial.particles, family)
    np.testing.assert_array_equal(swapped.particles[:, :2], partial.particles[:, :2])
    np.testing.assert_allclose(
        swapped.scores[:, [0, 1, 2]], problem.log_likelihood(swapped.particles, [0, 1, 2]), atol=1e-12
    )
    total = np.exp(swapped.scores[:, [1, 2]].sum(axis=1))
    np.testing.assert_allclose(swapped.weights, total / total.sum(), rtol=1e-9)
    before = np.exp(partial.scores[:, [1, 2]].sum(axis=1)).sum()
    assert total.sum() >= before * (1 - 1e-12)
    if n_copied in (7, 1):
        assert total.sum() > before * 1.01
        assert rows_of(TREE, swapped.particles, [1, 2]) != rows_of(TREE, partial.particles, [1, 2])


def test_placements_tell_copies_from_equals() -> None:
    """What moved is new everywhere; what did not agrees where it and its parent agree; roots may go anywhere."""
    layout = tree_layout([-1, 0, 0], [1, 1, 0])
    particles = np.array([[1.0, 5.0], [1.0, 5.0], [2.0, 5.0], [1.0, 6.0]])
    nothing = np.zeros((4, 3), dtype=np.int64)
    moved = placements(layout, nothing, particles, [0], np.array([True, False]))
    np.testing.assert_array_equal(moved[:, 0], [0, 1, 2, 3])
    still = placements(layout, nothing, particles, [0], np.array([False, False]))
    still = placements(layout, still, particles, [1, 2], np.array([False, False]))
    same = still[:, None, :] == still[None, :, :]
    np.testing.assert_array_equal(same[0, :, 0], [True, True, False, True])
    np.testing.assert_array_equal(same[0, :, 1], [True, True, False, False])
    np.testing.assert_array_equal(same[0, :, 2], same[0, :, 0])  # a part without columns goes with its parent
    np.testing.assert_array_equal(parents_placement(layout, still, 0), np.zeros(4))
    np.testing.assert_array_equal(parents_placement(layout, still, 2), still[:, 0])


# XN Figure 5-3: five particles; forearms (parts 3 and 5) hang on upper arms (2 and 4).
GROUPS = np.array([[1, 3], [1, 3], [1, 4], [2, 4], [2, 4]])
PART_WEIGHTS = np.array([[0.2, 0.9], [0.5, 0.1], [0.3, 0.4], [0.8, 0.6], [0.05, 0.7]])


def enumerated() -> Counter:
    """Weight of every (upper arms, left forearm's source, right forearm's source) in the union of all exchanges."""
    found: Counter = Counter()
    for a in admissible(GROUPS[:, 0]):
        for b in admissible(GROUPS[:, 1]):
            for i in range(5):
                key = (tuple(GROUPS[i]), int(a[i]), int(b[i]))
                found[key] += PART_WEIGHTS[a[i], 0] * PART_WEIGHTS[b[i], 1]
    total = sum(found.values())
    return Counter({key: value / total for key, value in found.items()})


def printed_weight(h: np.ndarray) -> float:
    """W_h of XN Eq. 5.1 as printed, with its factorials, for the particles that hold the upper arms h."""

    def arrangements(n: int, k: int) -> float:
        return factorial(n) / factorial(n - k)

    n_h = int((h == GROUPS).all(axis=1).sum())
    w = float(n_h)
    for k in range(2):
        members = GROUPS[:, k] == h[k]
        n_k = int(members.sum())
        largest = max(np.bincount(GROUPS[:, k]))
        w *= factorial(largest) / arrangements(n_k, n_h) * arrangements(n_k - 1, n_h - 1)
        w *= float(PART_WEIGHTS[members, k].sum())
    return w


def test_the_printed_weights_are_the_enumerated_ones_and_the_short_ones() -> None:
    """XN Eq. 5.1 = reading guide 20 = counting, up to a constant."""
    values = np.unique(GROUPS, axis=0)
    printed = np.array([printed_weight(h) for h in values])
    counted = np.array([sum(p for key, p in enumerated().items() if key[0] == tuple(h)) for h in values])
    mean = np.array([[PART_WEIGHTS[GROUPS[:, k] == h[k], k].mean() for k in range(2)] for h in values]).prod(
        axis=1
    )
    short = np.array([(h == GROUPS).all(axis=1).sum() for h in values]) * mean
    np.testing.assert_allclose(printed / printed.sum(), counted, rtol=1e-12)
    np.testing.assert_allclose(short / short.sum(), counted, rtol=1e-12)


@pytest.mark.parametrize("scheme", ["systematic", "multinomial"])
def test_combinatorial_resampling_draws_from_the_union_of_all_exchanges(scheme: str) -> None:
    """200 000 draws: a standard error is at most 0.0011; over 40 seeds no share was off by more than 0.0017."""
    n = 200_000
    centers, sources = combinatorial(
        np.log(PART_WEIGHTS), GROUPS, n, rng=np.random.default_rng(2), scheme=scheme
    )
    drawn = Counter(
        zip(map(tuple, GROUPS[centers].tolist()), *(sources[:, k].tolist() for k in range(2)), strict=True)
    )
    expected = enumerated()
    assert set(drawn) <= set(expected)
    for key, probability in expected.items():
        assert drawn[key] / n == pytest.approx(probability, abs=0.004)


@given(
    seed=st.integers(0, 9999),
    n=st.integers(1, 30),
    n_groups=st.integers(1, 40),
    n_drawn=st.integers(1, 50),
    spread=st.sampled_from([0.0, 1.0, 800.0]),
)
def test_combinatorial_resampling_never_leaves_a_group_nor_takes_weight_zero(
    seed: int, n: int, n_groups: int, n_drawn: int, spread: float
) -> None:
    """Also with more groups than particles, and with weights that differ by more than a double can hold."""
    rng = np.random.default_rng(seed)
    groups = rng.integers(0, n_groups, (n, 3))
    log_weights = spread * rng.normal(size=(n, 3))
    log_weights[rng.random((n, 3)) < 0.3] = -np.inf
    centers, sources = combinatorial(log_weights, groups, n_drawn, rng=rng)
    assert centers.shape == (n_drawn,)
    np.testing.assert_array_equal(np.take_along_axis(groups, sources, axis=0), groups[centers])
    possible = [
        all(np.isfinite(log_weights[groups[:, k] == groups[i, k], k]).any() for k in range(3))
        for i in range(n)
    ]
    if any(possible):
        assert np.isfinite(np.take_along_axis(log_weights, sources, axis=0)).all()


def test_all_weights_zero_gives_everybody_back() -> None:
    groups = np.array([[0], [0], [1]])
    centers, sources = combinatorial(np.full((3, 1), -np.inf), groups, 3, rng=np.random.default_rng(0))
    np.testing.assert_array_equal(centers, [0, 1, 2])
    np.testing.assert_array_equal(groups[sources[:, 0]], groups[centers])


def test_combined_particles_are_made_of_old_parts() -> None:
    partial, problem = partial_of(TREE, 30, 7, seed=5)
    combined = combine_parts(TREE, partial, [1, 2], scheme="systematic", rng=np.random.default_rng(1))
    np.testing.assert_array_equal(combined.weights, np.full(30, 1 / 30))
    for part in (1, 2):
        family = [0, *np.flatnonzero(owners(TREE, [part]) == 0)]
        assert set(rows_of(TREE, combined.particles, family)) <= set(rows_of(TREE, partial.particles, family))
    np.testing.assert_allclose(
        combined.scores[:, [0, 1, 2]], problem.log_likelihood(combined.particles, [0, 1, 2]), atol=1e-12
    )
    assert set(rows_of(TREE, combined.particles, [1, 2])) - set(rows_of(TREE, partial.particles, [1, 2]))


@pytest.mark.parametrize("seed", range(8))
def test_kernels_are_their_own_plain_python(seed: int) -> None:
    """Sizes on both sides of the border between the two ways of sorting; ties and zeros included."""
    rng = np.random.default_rng(seed)
    n, n_groups = 60, (1, 2, 4, 60)[seed % 4]
    groups = rng.integers(0, n_groups, n)
    lw = np.round(rng.normal(size=n), 1)
    lw[rng.random(n) < 0.2] = -np.inf
    a, b = np.empty(n, dtype=np.int64), np.empty(n, dtype=np.int64)
    _kernels.swap_sources_kernel(lw, groups, a)
    _kernels.swap_sources_kernel.py_func(lw, groups, b)
    takers, givers = np.argsort(groups, kind="stable"), np.lexsort((-lw, groups))
    np.testing.assert_array_equal(a, b)
    np.testing.assert_array_equal(a[takers], givers)
    outs = []
    for kernel in (_kernels.group_weights_kernel, _kernels.group_weights_kernel.py_func):
        out = (np.empty(n, dtype=np.int64), np.empty(n + 1, dtype=np.int64), np.empty(n), np.empty(n))
        kernel(lw, groups, *out)
        outs.append(out)
    for x, y in zip(*outs, strict=True):
        np.testing.assert_allclose(x, y, rtol=1e-12)
    order, start, cumulative, _ = outs[0]
    wanted, turn, uniform = groups[rng.integers(0, n, 45)], rng.permutation(45), rng.random(45)
    uniform[0] = np.nextafter(1.0, 0.0)
    a, b = np.empty(45, dtype=np.int64), np.empty(45, dtype=np.int64)
    _kernels.draw_from_groups_kernel(wanted, turn, uniform, order, start, cumulative, a)
    _kernels.draw_from_groups_kernel.py_func(wanted, turn, uniform, order, start, cumulative, b)
    np.testing.assert_array_equal(a, b)
    np.testing.assert_array_equal(groups[a], wanted)
    base, donor = rng.normal(size=(45, 4)), rng.normal(size=(n, 4))
    sources, owner = rng.integers(0, n, (45, 2)), np.array([-1, 1, 0, 1])
    x, y = np.empty_like(base), np.empty_like(base)
    _kernels.exchange_kernel(base, donor, sources, owner, x)
    _kernels.exchange_kernel.py_func(base, donor, sources, owner, y)
    np.testing.assert_array_equal(x, y)
    np.testing.assert_array_equal(x[:, [0, 2]], np.stack([base[:, 0], donor[sources[:, 0], 2]], axis=1))
