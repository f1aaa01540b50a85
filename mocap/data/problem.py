"""The articulated problem: what every pose filter sees, and all that it sees."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from mocap.arrays import Array


@dataclass(frozen=True, eq=False)
class StateLayout:
    """Columns of the state and the tree of parts they belong to.

    names : D column names.  lower, upper : (D,) bounds (infinite where there are none).
    is_circular : (D,) bool, columns that are angles without bounds, defined modulo 2 pi.
    parts : P part names, parents first.  part_of_column : (D,) index of the part that a column moves first.
    parent_of_part : (P,) index, -1 for a root; several objects in one state have several.
    """

    names: tuple[str, ...]
    lower: Array
    upper: Array
    is_circular: NDArray[np.bool_]
    parts: tuple[str, ...]
    part_of_column: NDArray[np.int64]
    parent_of_part: NDArray[np.int64]

    def __post_init__(self) -> None:
        D, P = len(self.names), len(self.parts)
        for name, shape in (
            ("lower", (D,)),
            ("upper", (D,)),
            ("is_circular", (D,)),
            ("part_of_column", (D,)),
            ("parent_of_part", (P,)),
        ):
            if getattr(self, name).shape != shape:
                raise ValueError(f"{name} has shape {getattr(self, name).shape}, expected {shape}")
        if not np.all(self.lower <= self.upper):
            raise ValueError("a lower bound lies above its upper bound")
        if np.any(self.parent_of_part < -1) or np.any(self.parent_of_part >= np.arange(P)):
            raise ValueError("parts must form a tree with parents listed before their children")

    @property
    def n_columns(self) -> int:
        return len(self.names)

    @property
    def n_parts(self) -> int:
        return len(self.parts)

    def columns_of(self, parts: int | Sequence[int]) -> NDArray[np.int64]:
        """Columns that belong to one part, or to any of several, ascending."""
        if isinstance(parts, int):
            return self._columns_of_each[parts]
        return np.flatnonzero(np.isin(self.part_of_column, parts))

    @cached_property
    def _columns_of_each(self) -> list[NDArray[np.int64]]:
        """The columns of every part; filters ask for them at every step."""
        columns = [np.flatnonzero(self.part_of_column == part) for part in range(self.n_parts)]
        for own in columns:
            own.setflags(write=False)
        return columns


def limbs_of(layout: StateLayout) -> list[list[int]]:
    """Limbs as lists of parts: every child of the root part with all that hangs on it."""
    limb_of: dict[int, int] = {}
    for part in range(1, layout.n_parts):
        parent = int(layout.parent_of_part[part])
        limb_of[part] = part if parent == 0 else limb_of[parent]
    return [[p for p, limb in limb_of.items() if limb == first] for first in sorted(set(limb_of.values()))]


class ArticulatedProblem(Protocol):
    """A state space with a motion model and a likelihood that knows its parts.

    Everything a filter needs and nothing else: no body, no image, no clock.
    """

    @property
    def layout(self) -> StateLayout: ...

    def propagate(self, particles: Array, std: Array, *, rng: np.random.Generator) -> Array:
        """A random-walk step inside the bounds.  particles : (N, D); std : (D,). Returns (N, D)."""
        ...

    def log_likelihood(
        self, particles: Array, parts: Sequence[int] | None = None, given: Sequence[int] = ()
    ) -> Array:
        """Per-part log-likelihoods of particles (N, D), one column per part.

        parts : which parts to score, in the order of the columns; None = all, (N, P), or (N, 1) for a global
        likelihood.  given : parts that are placed but not scored; they take up room where parts meet.
        """
        ...


@runtime_checkable
class OccupancyProblem(Protocol):
    """A problem over voxels, which can also say how much of a part lies where there is data."""

    def occupancy(self, particles: Array, parts: Sequence[int] | None = None, *, own: bool = False) -> Array:
        """Share of flesh in occupied voxels, of particles (N, D): (N, P'), one column per part asked for.

        parts : all parts that are placed; None = all.  own : only what no other placed part holds too.
        """
        ...


@runtime_checkable
class HeldBodyProblem(Protocol):
    """A problem that can judge one limb at the limb's price while the rest of the body holds still."""

    def limb_log_likelihood(self, held: Array, limb: Sequence[int]) -> Callable[[Array], Array]:
        """A function of particles (N, D) that differ from the state held (D,) in a limb's columns only: (N,), the sum
        of their `log_likelihood(particles, limb, given=all others)`."""
        ...

    def limb_in_data(self, particles: Array, limb: Sequence[int]) -> Array:
        """Which share of a limb's axis lies where there is data, of particles (N, D): (N,), cheap and coarse."""
        ...


class ResidualProblem(Protocol):
    """A problem that also offers second-order information to a refinement."""

    @property
    def layout(self) -> StateLayout: ...

    def normal_equations(self, state: Array) -> tuple[float, Array, Array]:
        """Robust cost, Gauss-Newton matrix (D, D) and gradient (D,) at a state (D,)."""
        ...
