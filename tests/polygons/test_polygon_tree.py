"""Trees of polygons: layout, kinematics and several objects."""

from dataclasses import replace

import numpy as np
import pytest

from mocap.polygons.tree import (
    PolygonTree,
    corner_positions,
    object_trees,
    part_frames,
    star_tree,
    with_loose_joints,
)

# Sums of a few sines and products of numbers up to 1e3.
ROUNDING_PX = 1e-9


@pytest.mark.parametrize(
    ("arms", "levels", "objects", "parts", "columns"),
    # SW gives |X| = 3 P = 27, 33, 48; XN's own count is P + 2 (reading guide 22).
    [
        (4, 3, 1, 9, 11),
        (5, 3, 1, 11, 13),
        (5, 4, 1, 16, 18),
        (4, 8, 1, 29, 31),
        (4, 3, 3, 27, 33),
        (0, 1, 1, 1, 3),
    ],
)
def test_parts_and_columns_are_those_of_the_papers(
    arms: int, levels: int, objects: int, parts: int, columns: int
) -> None:
    tree = star_tree(arms, levels, objects)
    assert (tree.layout.n_parts, tree.layout.n_columns) == (parts, columns)
    assert np.count_nonzero(tree.layout.parent_of_part == -1) == objects


def test_a_part_moves_its_descendants_and_nothing_else() -> None:
    tree = star_tree(3, 4, 2)
    rng = np.random.default_rng(0)
    state = rng.normal(size=tree.layout.n_columns)
    before = corner_positions(tree, state)[0]
    for p in range(tree.layout.n_parts):
        moved = state.copy()
        moved[tree.layout.columns_of(p)] += 0.3
        changed = np.any(np.abs(corner_positions(tree, moved)[0] - before) > ROUNDING_PX, axis=1)
        below = np.zeros(tree.layout.n_parts, dtype=bool)
        for q in range(tree.layout.n_parts):
            r = q
            while r not in (-1, p):
                r = int(tree.layout.parent_of_part[r])
            below[q] = r == p
        np.testing.assert_array_equal(changed, np.repeat(below, np.diff(tree.corner_start)))


def test_arms_are_straight_in_the_zero_pose_and_turn_at_their_joints() -> None:
    tree = star_tree(2, 3)
    state = np.zeros(tree.layout.n_columns)
    origin, angle = part_frames(tree, state[None])
    np.testing.assert_allclose(origin[0, :, 1], 0.0, atol=ROUNDING_PX)
    np.testing.assert_allclose(origin[0, :, 0], [0, 25, -25, 55, -55], atol=ROUNDING_PX)
    np.testing.assert_allclose(angle[0], [0, 0, np.pi, 0, np.pi])
    state[:] = [100.0, 50.0, np.pi / 2, 0.0, 0.0, np.pi / 2, 0.0]  # quarter turn, second joint of arm 0 too
    origin, angle = part_frames(tree, state[None])
    np.testing.assert_allclose(origin[0, 3], [100, 105], atol=ROUNDING_PX)
    assert angle[0, 3] == pytest.approx(np.pi)
    corners = corner_positions(tree, state)[0][tree.corner_start[3] : tree.corner_start[4]]
    np.testing.assert_allclose(corners.mean(axis=0), [85, 105], atol=ROUNDING_PX)


def test_lengths_do_not_depend_on_the_pose() -> None:
    tree = star_tree(5, 4)
    states = np.random.default_rng(1).normal(scale=3.0, size=(7, tree.layout.n_columns))
    corners = corner_positions(tree, states)
    for p in range(tree.layout.n_parts):
        own = corners[:, tree.corner_start[p] : tree.corner_start[p + 1]]
        sides = np.linalg.norm(own - np.roll(own, 1, axis=1), axis=2)
        np.testing.assert_allclose(sides - sides[0], 0.0, atol=ROUNDING_PX)


def test_objects_taken_apart_stand_where_they_stood() -> None:
    tree = star_tree(3, 3, 2)
    states = np.random.default_rng(2).normal(size=(4, tree.layout.n_columns))
    whole = corner_positions(tree, states)
    found = object_trees(tree)
    assert len(found) == 2
    apart = [corner_positions(one, states[:, columns]) for one, columns in found]
    np.testing.assert_array_equal(np.concatenate(apart, axis=1), whole)
    assert found[1][0].layout.parts == tuple(p for p in tree.layout.parts if p.startswith("object1"))


@pytest.mark.parametrize(
    ("arms", "levels", "objects", "columns"), [(4, 3, 1, 27), (5, 3, 1, 33), (5, 4, 1, 48)]
)
def test_loose_joints_give_three_columns_for_every_part(
    arms: int, levels: int, objects: int, columns: int
) -> None:
    """SW prints |X| = 3 P = 27, 33, 48. With the new columns at zero the object is the jointed one."""
    tree = star_tree(arms, levels, objects)
    loose, kept = with_loose_joints(tree)
    assert loose.layout.n_columns == columns == 3 * loose.layout.n_parts
    state = np.random.default_rng(3).normal(size=tree.layout.n_columns)
    same = np.zeros(columns)
    same[kept] = state
    np.testing.assert_array_equal(corner_positions(loose, same), corner_positions(tree, state))
    assert [loose.layout.names[c] for c in kept] == list(tree.layout.names)
    assert loose.layout.is_circular[kept].tolist() == tree.layout.is_circular.tolist()
    assert not loose.layout.is_circular[np.setdiff1d(np.arange(columns), kept)].any()
    for q, p in enumerate(loose.layout.parent_of_part):
        assert list(loose.layout.columns_of(q)) == [3 * q, 3 * q + 1, 3 * q + 2]
        assert p == tree.layout.parent_of_part[q]


def test_a_loose_joint_moves_in_the_frame_of_the_parent() -> None:
    """A root turned by a quarter: 5 px along its u are 5 px along v in the picture, for the part and its child."""
    loose, _ = with_loose_joints(star_tree(1, 3))
    state = np.zeros(loose.layout.n_columns)
    state[2] = np.pi / 2
    before = part_frames(loose, state[None])[0][0]
    state[3] = 5.0
    after = part_frames(loose, state[None])[0][0]
    np.testing.assert_allclose(after - before, [[0, 0], [0, 5], [0, 5]], atol=ROUNDING_PX)
    state[3:5] = 0.0, 5.0
    after = part_frames(loose, state[None])[0][0]
    np.testing.assert_allclose(after - before, [[0, 0], [-5, 0], [-5, 0]], atol=ROUNDING_PX)


def test_loose_objects_can_be_taken_apart() -> None:
    loose, _ = with_loose_joints(star_tree(2, 3, 2))
    states = np.random.default_rng(2).normal(size=(4, loose.layout.n_columns))
    apart = [corner_positions(one, states[:, columns]) for one, columns in object_trees(loose)]
    np.testing.assert_array_equal(np.concatenate(apart, axis=1), corner_positions(loose, states))


def test_several_roots_are_a_layout_and_a_cycle_is_none() -> None:
    layout = star_tree(2, 3, 2).layout
    assert layout.parent_of_part.tolist().count(-1) == 2
    parent = layout.parent_of_part.copy()
    parent[1], parent[3] = 3, 1
    with pytest.raises(ValueError, match="tree"):
        replace(layout, parent_of_part=parent)
    with pytest.raises(ValueError, match="tree"):
        replace(layout, parent_of_part=np.where(layout.parent_of_part < 0, -2, layout.parent_of_part))


def test_wrong_trees_are_refused() -> None:
    tree = star_tree(2, 2)
    with pytest.raises(ValueError, match="n_arms"):
        star_tree(-1, 3)
    with pytest.raises(ValueError, match="n_levels"):
        star_tree(3, 0)
    dented = tree.corners.copy()
    dented[1] = dented[:4].mean(axis=0)
    with pytest.raises(ValueError, match="convex"):
        PolygonTree(tree.layout, tree.offset, tree.rest_angle, dented, tree.corner_start)
    with pytest.raises(ValueError, match="offset"):
        PolygonTree(tree.layout, tree.offset[1:], tree.rest_angle, tree.corners, tree.corner_start)


def test_nan_reaches_only_what_hangs_below_it() -> None:
    tree = star_tree(2, 3)
    state = np.zeros(tree.layout.n_columns)
    state[tree.layout.columns_of(1)] = np.nan
    is_nan = np.isnan(corner_positions(tree, state)[0]).any(axis=1)
    own = [bool(is_nan[s]) for s in tree.corner_start[:-1]]
    assert own == [False, True, False, True, False]
