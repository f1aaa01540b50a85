"""Hierarchies and limbs: names become indices, and what does not fit is refused."""

import numpy as np
import pytest

from mocap.data import Hierarchy, Level, Limb, StateLayout
from mocap.data.hierarchy import depth_hierarchy, levels_on, limbs_on, tree_limbs


@pytest.fixture
def layout() -> StateLayout:
    """trunk(a, b) - upper(c, d) - lower(e) - tip(no column); trunk - other(f)."""
    return StateLayout(
        names=("a", "b", "c", "d", "e", "f"),
        lower=np.array([-9.0, -9.0, 0.5, -1.0, -1.0, -1.0]),
        upper=np.full(6, 9.0),
        is_circular=np.zeros(6, dtype=np.bool_),
        parts=("trunk", "upper", "lower", "tip", "other"),
        part_of_column=np.array([0, 0, 1, 1, 2, 4]),
        parent_of_part=np.array([-1, 0, 1, 2, 0]),
    )


TWO = Hierarchy(
    "two",
    (Level("coarse", ("b", "a"), ("trunk",)), Level("fine", ("e", "c"), ("other", "trunk", "upper"))),
    {"e": 0.25, "d": 20.0},
)


def test_levels_are_indices_of_the_layout(layout: StateLayout) -> None:
    levels = levels_on(TWO, layout)
    assert levels.dimensions == (2, 2)
    coarse, fine = levels.levels
    assert coarse.added.tolist() == [1, 0]
    assert coarse.has.tolist() == [True, True, False, False, False, False]
    assert coarse.parts == (0,)
    assert fine.added.tolist() == [4, 2]
    assert fine.has.tolist() == [True, True, True, False, True, False]
    assert fine.parts == (0, 1, 4)
    # Named, at its rest inside the bounds (c), moved to a bound (d), and 0.
    assert levels.pinned.tolist() == [0.0, 0.0, 0.5, 9.0, 0.25, 0.0]


@pytest.mark.parametrize(
    ("levels", "message"),
    [
        ((), "no levels"),
        ((Level("x", ("nose",), ("trunk",)),), "unknown column 'nose'"),
        ((Level("x", ("a",), ("tail",)),), "unknown part 'tail'"),
        ((Level("x", (), ("trunk",)),), "adds no column"),
        ((Level("x", ("a", "a"), ("trunk",)),), "added twice"),
        ((Level("x", ("a",), ("trunk",)), Level("y", ("b", "a"), ("trunk",))), "level 'y'.*added twice"),
        ((Level("x", ("a",), ()),), "parts must be named once"),
        ((Level("x", ("a",), ("trunk", "trunk")),), "parts must be named once"),
        ((Level("x", ("a",), ("trunk", "upper")), Level("y", ("b",), ("trunk",))), "level before"),
    ],
)
def test_bad_hierarchies_are_refused(layout: StateLayout, levels: tuple[Level, ...], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        levels_on(Hierarchy("bad", levels), layout)


def test_unknown_pinned_column_is_refused(layout: StateLayout) -> None:
    with pytest.raises(ValueError, match="pinned: unknown column 'q'"):
        levels_on(Hierarchy("bad", (Level("x", ("a",), ("trunk",)),), {"q": 1.0}), layout)


def test_depth_gives_one_level_per_joint_from_the_root(layout: StateLayout) -> None:
    hierarchy = depth_hierarchy(layout)
    assert [level.columns for level in hierarchy.levels] == [("a", "b"), ("c", "d", "f"), ("e",)]
    assert [level.parts for level in hierarchy.levels] == [
        ("trunk",),
        ("trunk", "upper", "other"),
        ("trunk", "upper", "lower", "tip", "other"),
    ]
    assert levels_on(hierarchy, layout).dimensions == (2, 3, 1)


def test_limbs_are_indices_with_their_columns(layout: StateLayout) -> None:
    (limb,) = limbs_on([Limb("arm", (("upper",), ("lower", "tip")))], layout)
    assert limb.parts == ((1,), (2, 3))
    assert [c.tolist() for c in limb.columns] == [[2, 3], [4]]
    assert tree_limbs(layout) == (
        Limb("upper", (("upper", "lower", "tip"),)),
        Limb("other", (("other",),)),
    )


@pytest.mark.parametrize(
    ("units", "message"),
    [
        ((), "every unit needs a part"),
        (((),), "every unit needs a part"),
        ((("upper",), ("upper",)), "comes twice"),
        ((("trunk",),), "always present"),
        ((("wing",),), "unknown part 'wing'"),
    ],
)
def test_bad_limbs_are_refused(layout: StateLayout, units: tuple[tuple[str, ...], ...], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        limbs_on([Limb("arm", units)], layout)
