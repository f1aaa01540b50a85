"""Sets of parts that may be processed together, against d-separation worked out on the graph itself."""

from itertools import pairwise

import numpy as np
import pytest
from linear_gaussian_tree import LinearGaussianTree, tree_layout

from mocap.filters.parts import columns_in, owners, part_scores, part_sets, require_parts

Node = tuple[str, int, int]  # ("x" or "y", part, time slice)
N_SLICES = 3


def network(parents: list[int]) -> dict[Node, set[Node]]:
    """The dynamic Bayesian network of a tree, unrolled: node -> its parents.  Source: XN Definition 4-1."""
    graph: dict[Node, set[Node]] = {}
    for t in range(N_SLICES):
        for part, parent in enumerate(parents):
            x = ("x", part, t)
            graph[x] = set()
            if parent >= 0:
                graph[x].add(("x", parent, t))
            if t > 0:
                graph[x].add(("x", part, t - 1))
            graph[("y", part, t)] = {x}
    return graph


def are_separated(graph: dict[Node, set[Node]], a: Node, others: set[Node], given: set[Node]) -> bool:
    """d-separation by the moral graph of the ancestors: no path from a to the others that avoids what is given."""
    others = others - given - {a}
    alive: set[Node] = set()
    stack = [a, *others, *given]
    while stack:
        node = stack.pop()
        if node not in alive:
            alive.add(node)
            stack.extend(graph[node])
    neighbours: dict[Node, set[Node]] = {node: set() for node in alive}
    for node in alive:
        family = [node, *graph[node]]
        for one in family:
            neighbours[one] |= {other for other in family if other != one}
    reached, stack = {a}, [a]
    while stack:
        for other in neighbours[stack.pop()] - reached - given:
            reached.add(other)
            stack.append(other)
    return not reached & others


def condition_holds(parents: list[int], sets: list[list[int]]) -> bool:
    """XN Eq. 4.1 for every part of every set, in the last time slice."""
    graph, t = network(parents), N_SLICES - 1
    everything = set(range(len(parents)))
    for j, parts in enumerate(sets):
        before = {p for s in sets[:j] for p in s}
        for k in parts:
            others = {("x", h, t) for h in set(parts) - {k} | before}
            others |= {("x", h, t - 1) for h in everything - before}
            others |= {("y", h, s) for h in everything for s in range(t)}
            others |= {("y", h, t) for h in before}
            if not are_separated(graph, ("x", k, t), others, graph[("x", k, t)]):
                return False
    return True


def random_parents(rng: np.random.Generator, *, n_roots: int) -> list[int]:
    n = int(rng.integers(n_roots + 2, 9))
    return [-1 if p == 0 or 0 < p < n_roots else int(rng.integers(0, p)) for p in range(n)]


TREES = [random_parents(np.random.default_rng(seed), n_roots=1 + seed % 3) for seed in range(24)]


def sets_of(parents: list[int]) -> list[list[int]]:
    return part_sets(tree_layout(parents, [1] * len(parents)))


@pytest.mark.parametrize("parents", TREES)
def test_the_sets_are_independent_given_their_parents(parents: list[int]) -> None:
    sets = sets_of(parents)
    assert sorted(p for s in sets for p in s) == list(range(len(parents)))
    assert condition_holds(parents, sets)


@pytest.mark.parametrize("parents", TREES)
def test_no_set_could_be_larger(parents: list[int]) -> None:
    """Taking any part into the set before its own puts it beside its parent, on which it depends."""
    sets = sets_of(parents)
    for j, (_, later) in enumerate(pairwise(sets)):
        for part in later:
            merged = [list(s) for s in sets]
            merged[j].append(part)
            merged[j + 1].remove(part)
            assert not condition_holds(parents, [s for s in merged if s])


def test_the_check_itself_knows_the_example_of_the_source() -> None:
    """SW 4.2: x2 is independent of x3 of the last frame given x1 and its own past, not given x1 alone."""
    graph = network([-1, 0, 0])
    a, past = ("x", 1, 2), {("x", 2, 1)}
    assert are_separated(graph, a, past, {("x", 0, 2), ("x", 1, 1)})
    assert not are_separated(graph, a, past, {("x", 0, 2)})


def test_sets_of_a_body_and_of_two_objects() -> None:
    assert sets_of([-1, 0, 0, 2, 0, 4, 4]) == [[0], [1, 2, 4], [3, 5, 6]]
    assert sets_of([-1, -1, 0, 1, 2]) == [[0, 1], [2, 3], [4]]
    assert sets_of([-1]) == [[0]]


def test_a_part_moves_all_that_hangs_on_it() -> None:
    layout = tree_layout([-1, 0, 1, 0, 2, 3], [2, 1, 1, 1, 3, 1])
    np.testing.assert_array_equal(owners(layout, [0]), np.zeros(6))
    np.testing.assert_array_equal(owners(layout, [1, 3]), [-1, 0, 0, 1, 0, 1])
    np.testing.assert_array_equal(owners(layout, [5]), [-1, -1, -1, -1, -1, 0])
    np.testing.assert_array_equal(np.flatnonzero(columns_in(layout, [1, 4])), [2, 5, 6, 7])


@pytest.mark.parametrize("parents", [[-1, 2, 1], [-1, 1], [0], [1, -1], [-1, 0, 3, 2]])
def test_a_tree_with_a_cycle_is_refused(parents: list[int]) -> None:
    with pytest.raises(ValueError, match="tree"):
        tree_layout(parents, [1] * len(parents))


def test_a_global_likelihood_is_refused_with_the_remedy() -> None:
    layout = tree_layout([-1, 0, 0], [1, 1, 1])
    problem = LinearGaussianTree(layout, np.zeros(3), 1.0, is_global=True)
    with pytest.raises(ValueError, match=r"expected 3 columns, got 1.*use sir, apf, pso or apsopf"):
        require_parts(problem, np.zeros((5, 3)))


def test_a_silent_part_neither_prefers_nor_excludes() -> None:
    layout = tree_layout([-1, 0, 0], [1, 1, 1])
    x = np.random.default_rng(0).normal(size=(4, 3))
    scores, is_silent = part_scores(LinearGaussianTree(layout, np.zeros(3), 1.0, silent=(1,)), x, [1, 2], [0])
    assert is_silent
    np.testing.assert_array_equal(scores[:, 0], 0.0)
    np.testing.assert_allclose(scores[:, 1], -0.5 * (x[:, 0] + x[:, 2]) ** 2)
    scores, is_silent = part_scores(
        LinearGaussianTree(layout, np.zeros(3), 1.0, silent=(1,), silence=np.nan), x, [1], [0]
    )
    assert is_silent
    np.testing.assert_array_equal(scores, 0.0)


def test_a_likelihood_of_the_wrong_shape_is_refused() -> None:
    layout = tree_layout([-1, 0, 0], [1, 1, 1])
    problem = LinearGaussianTree(layout, np.zeros(3), 1.0, is_global=True)
    with pytest.raises(ValueError, match=r"shape \(4, 1\), expected \(4, 2\)"):
        part_scores(problem, np.zeros((4, 3)), [1, 2], [0])
