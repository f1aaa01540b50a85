"""Articulated objects of convex polygons in the picture plane: the 2D world of XN and SW."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from mocap.data.problem import StateLayout

Array = NDArray[np.float64]

# Sizes of the parts in pixels. Our choice: the sources print none.
_ROOT_APOTHEM_PX = 25.0
_ARM_PART_PX = (30.0, 14.0)
_GAP_PX = 2.0  # between a joint and the polygon on either side, so that bent arms hardly cover themselves


@dataclass(frozen=True, eq=False)
class PolygonTree:
    """A tree of convex polygons in pixels; u to the right, v down, angles from u towards v.

    layout : a root part has three columns x (px), y (px) and theta (rad); every other part has one, the angle at
    its joint against its parent, or with a loose joint three: how far the joint lies off its place, x and y (px) in
    the frame of the parent, and the angle (reading guide 22).
    offset : (P, 2) px, joint of each part in the frame of its parent; unused for roots.
    rest_angle : (P,) rad, orientation against the parent when the angle is 0.
    corners : (S, 2) px, corners of all parts, each in the frame of its part (origin at the joint; for a root at
    its centre).  corner_start : (P + 1,), corners of part p are corner_start[p] to corner_start[p + 1] - 1.
    """

    layout: StateLayout
    offset: Array
    rest_angle: Array
    corners: Array
    corner_start: NDArray[np.int64]

    def __post_init__(self) -> None:
        P = self.layout.n_parts
        for name, shape in (("offset", (P, 2)), ("rest_angle", (P,)), ("corner_start", (P + 1,))):
            if getattr(self, name).shape != shape:
                raise ValueError(f"{name} has shape {getattr(self, name).shape}, expected {shape}")
        for p in range(P):
            n_columns = len(self.layout.columns_of(p))
            expected = (3,) if self.layout.parent_of_part[p] < 0 else (1, 3)
            if n_columns not in expected:
                words = " or ".join(map(str, expected))
                raise ValueError(f"part {self.layout.parts[p]} has {n_columns} columns, expected {words}")
            if not _is_convex(self.corners_of(p)):
                raise ValueError(f"the corners of part {self.layout.parts[p]} are no convex polygon")

    @property
    def n_corners(self) -> int:
        return len(self.corners)

    @cached_property
    def first_column(self) -> NDArray[np.int64]:
        """(P,) column of x for roots and parts on loose joints, of the angle for all other parts."""
        return np.array([self.layout.columns_of(p)[0] for p in range(self.layout.n_parts)])

    @cached_property
    def angle_column(self) -> NDArray[np.int64]:
        """(P,) column of the angle; that of a part with one column is its first."""
        return np.array([self.layout.columns_of(p)[-1] for p in range(self.layout.n_parts)])

    @cached_property
    def is_ancestor(self) -> NDArray[np.bool_]:
        """(P, P) whether part q holds part p, itself included, at [p, q]."""
        out = np.eye(self.layout.n_parts, dtype=np.bool_)
        for p, q in enumerate(self.layout.parent_of_part):
            if q >= 0:
                out[p] |= out[q]
        return out

    @cached_property
    def chain(
        self,
    ) -> tuple[
        NDArray[np.int64], Array, Array, NDArray[np.int64], NDArray[np.int64], Array, NDArray[np.int64]
    ]:
        """What kernels need: parent, offset, rest angle, first and angle column, corners, corner start."""
        parent = self.layout.parent_of_part
        return (
            parent,
            self.offset,
            self.rest_angle,
            self.first_column,
            self.angle_column,
            self.corners,
            self.corner_start,
        )

    def corners_of(self, part: int) -> Array:
        """Corners (C, 2) px of one part in its own frame."""
        return self.corners[self.corner_start[part] : self.corner_start[part + 1]]


def _is_convex(corners: Array) -> bool:
    if len(corners) < 3:
        return False
    edge = np.roll(corners, -1, axis=0) - corners
    following = np.roll(edge, -1, axis=0)
    cross = edge[:, 0] * following[:, 1] - edge[:, 1] * following[:, 0]
    # All turns in one sense, and once around: a star polygon turns more than once.
    turn = np.arctan2(cross, np.sum(edge * following, axis=1)).sum()
    return bool((np.all(cross > 0) or np.all(cross < 0)) and abs(abs(turn) - 2 * np.pi) < 1e-6)


def star_tree(n_arms: int, n_levels: int, n_objects: int = 1) -> PolygonTree:
    """Objects with a central polygon and straight arms around it, P = n_objects (1 + n_arms (n_levels - 1)) parts.

    n_arms : |P_j| of the sources.  n_levels : their K, so that an arm has n_levels - 1 rectangles.
    n_objects : several objects share one layout with as many roots.
    Parts are listed object by object, within an object level by level, so that a level's parts are neighbours.
    Source: XN 4.4.2; SW 6.2. Sizes are ours.
    """
    for name, value, least in (("n_arms", n_arms, 0), ("n_levels", n_levels, 1), ("n_objects", n_objects, 1)):
        if value < least:
            raise ValueError(f"{name}: expected at least {least}, got {value}")
    names: list[str] = []
    parts: list[str] = []
    column_part: list[int] = []
    parent: list[int] = []
    offset: list[tuple[float, float]] = []
    rest: list[float] = []
    corners: list[Array] = []
    length, width = _ARM_PART_PX
    rectangle = np.array([[0.0, -0.5], [1.0, -0.5], [1.0, 0.5], [0.0, 0.5]])
    rectangle = rectangle * [length - 2 * _GAP_PX, width] + [_GAP_PX, 0.0]
    for m in range(n_objects):
        prefix = f"object{m}_" if n_objects > 1 else ""
        root = len(parts)
        parts.append(f"{prefix}root")
        names += [f"{prefix}{c}" for c in ("x", "y", "theta")]
        column_part += [root] * 3
        parent.append(-1)
        offset.append((0.0, 0.0))
        rest.append(0.0)
        corners.append(_regular_polygon(max(n_arms, 4), _ROOT_APOTHEM_PX))
        for level in range(1, n_levels):
            for arm in range(n_arms):
                part = len(parts)
                parts.append(f"{prefix}arm{arm}_{level}")
                names.append(f"{prefix}arm{arm}_{level}_angle")
                column_part.append(part)
                direction = 2 * np.pi * arm / n_arms
                if level == 1:
                    parent.append(root)
                    offset.append(
                        (_ROOT_APOTHEM_PX * np.cos(direction), _ROOT_APOTHEM_PX * np.sin(direction))
                    )
                    rest.append(direction)
                else:
                    parent.append(part - n_arms)
                    offset.append((length, 0.0))
                    rest.append(0.0)
                corners.append(rectangle)
    D = len(names)
    layout = StateLayout(
        names=tuple(names),
        lower=np.full(D, -np.inf),
        upper=np.full(D, np.inf),
        is_circular=np.array([n.endswith(("theta", "angle")) for n in names]),
        parts=tuple(parts),
        part_of_column=np.array(column_part),
        parent_of_part=np.array(parent),
    )
    start = np.concatenate([[0], np.cumsum([len(c) for c in corners])])
    return PolygonTree(layout, np.array(offset), np.array(rest), np.concatenate(corners), start)


def _regular_polygon(n_sides: int, apothem: float) -> Array:
    """Corners (n, 2) of a regular polygon with the middle of its first side on the u axis."""
    angle = 2 * np.pi * (np.arange(n_sides) - 0.5) / n_sides
    return apothem / np.cos(np.pi / n_sides) * np.column_stack([np.cos(angle), np.sin(angle)])


def with_loose_joints(tree: PolygonTree) -> tuple[PolygonTree, NDArray[np.int64]]:
    """The same objects with three columns for every part, 3 P in all, and where the old columns stand in them (D,).

    A part may then leave its joint; a state that is zero in the new columns is the old one.
    Source: SW 6.2 and XN 4.4.2 (x^k = (x, y, theta), |X| = 3P).
    """
    old = tree.layout
    names: list[str] = []
    part_of_column: list[int] = []
    kept: list[int] = []
    for p in range(old.n_parts):
        own = [old.names[c] for c in old.columns_of(p)]
        if len(own) == 1:
            own = [*(own[0].removesuffix("angle") + axis for axis in "xy"), *own]
            kept.append(len(names) + 2)
        else:
            kept += range(len(names), len(names) + 3)
        names += own
        part_of_column += [p] * len(own)
    D = len(names)
    layout = StateLayout(
        names=tuple(names),
        lower=np.full(D, -np.inf),
        upper=np.full(D, np.inf),
        is_circular=np.arange(D) % 3 == 2,
        parts=old.parts,
        part_of_column=np.array(part_of_column),
        parent_of_part=old.parent_of_part,
    )
    return replace(tree, layout=layout), np.array(kept)


def object_trees(tree: PolygonTree) -> tuple[tuple[PolygonTree, NDArray[np.int64]], ...]:
    """Every object of a tree of several on its own, with the columns (D',) of its state in the whole."""
    root_of = np.arange(tree.layout.n_parts)
    for p in range(tree.layout.n_parts):
        if tree.layout.parent_of_part[p] >= 0:
            root_of[p] = root_of[tree.layout.parent_of_part[p]]
    found = []
    for root in np.unique(root_of):
        own = np.flatnonzero(root_of == root)
        found.append(_sub_tree(tree, own))
    return tuple(found)


def _sub_tree(
    tree: PolygonTree, own: Sequence[int] | NDArray[np.int64]
) -> tuple[PolygonTree, NDArray[np.int64]]:
    old = tree.layout
    own = np.asarray(own)
    new_index = {int(p): i for i, p in enumerate(own)} | {-1: -1}
    columns = np.flatnonzero(np.isin(old.part_of_column, own))
    layout = StateLayout(
        names=tuple(old.names[c] for c in columns),
        lower=old.lower[columns],
        upper=old.upper[columns],
        is_circular=old.is_circular[columns],
        parts=tuple(old.parts[p] for p in own),
        part_of_column=np.array([new_index[int(p)] for p in old.part_of_column[columns]]),
        parent_of_part=np.array([new_index[int(p)] for p in old.parent_of_part[own]]),
    )
    corners = [tree.corners_of(p) for p in own]
    start = np.concatenate([[0], np.cumsum([len(c) for c in corners])])
    new = PolygonTree(layout, tree.offset[own], tree.rest_angle[own], np.concatenate(corners), start)
    return new, columns


def part_frames(tree: PolygonTree, states: Array) -> tuple[Array, Array]:
    """Origins (N, P, 2) px and orientations (N, P) rad of all parts for states (N, D)."""
    N, P = len(states), tree.layout.n_parts
    origin = np.empty((N, P, 2))
    angle = np.empty((N, P))
    for p in range(P):
        c, a, q = tree.first_column[p], tree.angle_column[p], tree.layout.parent_of_part[p]
        if q < 0:
            origin[:, p] = states[:, c : c + 2]
            angle[:, p] = states[:, a]
        else:
            joint = tree.offset[p] + (states[:, c : c + 2] if a > c else 0.0)
            origin[:, p] = origin[:, q] + _turned(joint, angle[:, q])
            angle[:, p] = angle[:, q] + tree.rest_angle[p] + states[:, a]
    return origin, angle


def corner_positions(tree: PolygonTree, states: Array) -> Array:
    """Corners (N, S, 2) px in the picture for states (N, D); a NaN in a state gives NaN below it in the tree."""
    origin, angle = part_frames(tree, np.atleast_2d(states))
    part = np.repeat(np.arange(tree.layout.n_parts), np.diff(tree.corner_start))
    return origin[:, part] + _turned(tree.corners, angle[:, part])


def _turned(vectors: Array, angle: Array) -> Array:
    """Vectors (..., 2) turned by angles (...), both broadcast."""
    c, s = np.cos(angle), np.sin(angle)
    x, y = vectors[..., 0], vectors[..., 1]
    return np.stack([c * x - s * y, s * x + c * y], axis=-1)
