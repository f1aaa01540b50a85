"""Scalable models: which columns and parts of a state a coarser model has, as names, and as indices of a layout."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from mocap.arrays import Array, Indices
from mocap.data.problem import StateLayout


@dataclass(frozen=True)
class Level:
    """One model of an inclusive hierarchy.

    columns : names of the columns that it adds to the models before it.  parts : names of all parts that it scores.
    Source: CF Eq. 7.6-7.7 (the mapping f is the identity).
    """

    name: str
    columns: tuple[str, ...]
    parts: tuple[str, ...]


@dataclass(frozen=True)
class Hierarchy:
    """An inclusive scalable model: H_1, H_2, ..., H_M, each a refinement of the one before.

    pinned : value of a column in the models that do not have it yet; 0 for columns that are not named (a body's rest
    pose, in which limbs are straight). A column that no level adds stays pinned.
    Source: CF Eq. 7.1-7.2.
    """

    name: str
    levels: tuple[Level, ...]
    pinned: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Limb:
    """A limb of a unitive scalable model: parts that are present or absent together, in units from the trunk outwards.

    A unit can only be present when the units before it are.
    Source: CF Eq. 7.3, Figure 7.11.
    """

    name: str
    units: tuple[tuple[str, ...], ...]


@dataclass(frozen=True, eq=False)
class LevelIndices:
    """A level on a layout.  added : (K,) columns it adds.  has : (D,) bool, all columns it has.  parts : it scores."""

    name: str
    added: Indices
    has: NDArray[np.bool_]
    parts: tuple[int, ...]


@dataclass(frozen=True, eq=False)
class LevelsOf:
    """A hierarchy on a layout.  levels : coarse to fine.  pinned : (D,) value of every column where it is absent."""

    levels: tuple[LevelIndices, ...]
    pinned: Array

    @property
    def dimensions(self) -> tuple[int, ...]:
        """Columns that each level adds.  Source: CF Eq. 7.8."""
        return tuple(len(level.added) for level in self.levels)


@dataclass(frozen=True, eq=False)
class LimbIndices:
    """A limb on a layout: for each unit its parts and the columns that move them first."""

    name: str
    parts: tuple[tuple[int, ...], ...]
    columns: tuple[Indices, ...]


def levels_on(hierarchy: Hierarchy, layout: StateLayout) -> LevelsOf:
    """Indices of a hierarchy's names.

    Pinned values are moved inside their column's bounds. Raises ValueError for an unknown name, a column that comes
    twice, a level that adds nothing, or one that drops a part of the level before.
    Source: CF Eq. 7.4-7.8.
    """
    if not hierarchy.levels:
        raise ValueError(f"hierarchy {hierarchy.name!r} has no levels")
    levels: list[LevelIndices] = []
    for level in hierarchy.levels:
        where = f"hierarchy {hierarchy.name!r}, level {level.name!r}"
        levels.append(_level_on(level, layout, levels[-1] if levels else None, where))
    pinned = np.zeros(layout.n_columns)
    for name, value in hierarchy.pinned.items():
        pinned[_index(layout.names, name, "column", f"hierarchy {hierarchy.name!r}, pinned")] = value
    return LevelsOf(tuple(levels), np.clip(pinned, layout.lower, layout.upper))


def _level_on(level: Level, layout: StateLayout, before: LevelIndices | None, where: str) -> LevelIndices:
    """Indices of one level.  before : the next coarser one.  where : names the level in errors."""
    added = np.array([_index(layout.names, c, "column", where) for c in level.columns], dtype=np.int64)
    parts = {_index(layout.parts, p, "part", where) for p in level.parts}
    has = np.zeros(layout.n_columns, dtype=np.bool_) if before is None else before.has.copy()
    if not len(added):
        raise ValueError(f"{where}: adds no column")
    if len(np.unique(added)) < len(added) or has[added].any():
        raise ValueError(f"{where}: a column is added twice")
    known: set[int] = set() if before is None else set(before.parts)
    if not parts or len(parts) < len(level.parts) or not known <= parts:
        raise ValueError(
            f"{where}: parts must be named once and include those of the level before, got {list(level.parts)}"
        )
    has[added] = True
    return LevelIndices(level.name, added, has, tuple(sorted(parts)))


def limbs_on(limbs: Sequence[Limb], layout: StateLayout) -> tuple[LimbIndices, ...]:
    """Indices of the limbs' names.

    Raises ValueError for an unknown part, a part that comes twice, the root part, or an empty unit.
    """
    seen: set[int] = set()
    found = []
    for limb in limbs:
        where = f"limb {limb.name!r}"
        units = [tuple(_index(layout.parts, p, "part", where) for p in unit) for unit in limb.units]
        if not units or not all(units):
            raise ValueError(f"{where}: every unit needs a part")
        for part in (p for unit in units for p in unit):
            if part == 0:
                raise ValueError(f"{where}: the root part {layout.parts[0]!r} is always present")
            if part in seen:
                raise ValueError(f"{where}: part {layout.parts[part]!r} comes twice")
            seen.add(part)
        columns = tuple(layout.columns_of(unit) for unit in units)
        found.append(LimbIndices(limb.name, tuple(units), columns))
    return tuple(found)


def depth_hierarchy(layout: StateLayout) -> Hierarchy:
    """The hierarchy that a tree of parts suggests: each level adds the parts one joint further from the root.

    For a body this is model 2 of CF Figure 7.7. Parts without columns of their own join the level before.
    """
    depth = np.zeros(layout.n_parts, dtype=np.int64)
    for part, parent in enumerate(layout.parent_of_part):
        if parent >= 0:
            depth[part] = depth[parent] + 1
    levels: list[Level] = []
    columns: list[str] = []
    for d in range(int(depth.max(initial=-1)) + 1):
        columns += [layout.names[c] for c in np.flatnonzero(depth[layout.part_of_column] == d)]
        parts = tuple(layout.parts[p] for p in np.flatnonzero(depth <= d))
        if columns:
            levels.append(Level(f"depth_{d}", tuple(columns), parts))
            columns = []
        elif levels:
            levels[-1] = Level(levels[-1].name, levels[-1].columns, parts)
    return Hierarchy("depth", tuple(levels))


def tree_limbs(layout: StateLayout) -> tuple[Limb, ...]:
    """Every branch of the tree of parts as one limb that is there or not; for layouts without a limb model."""
    branch: dict[int, int] = {}
    for part, parent in enumerate(layout.parent_of_part.tolist()):
        if parent >= 0:
            branch[part] = branch.get(parent, part)
    return tuple(
        Limb(layout.parts[first], (tuple(layout.parts[p] for p in branch if branch[p] == first),))
        for first in dict.fromkeys(branch.values())
    )


def _index(names: tuple[str, ...], name: str, what: str, where: str) -> int:
    if name not in names:
        raise ValueError(f"{where}: unknown {what} {name!r}; there are {', '.join(names)}")
    return names.index(name)
