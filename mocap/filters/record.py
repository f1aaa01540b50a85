"""A filter's record: its name, its step, how a budget becomes its settings, and what it needs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from mocap.data.problem import ArticulatedProblem, StateLayout
from mocap.filters.budget import FilterBudget, FilterSettings
from mocap.filters.state import FilterInfo, ParticleState

Array = NDArray[np.float64]

_Settings = TypeVar("_Settings", bound=FilterSettings)
_Settings_contra = TypeVar("_Settings_contra", contravariant=True)


class Step(Protocol[_Settings_contra]):
    """One frame of a filter, a pure function of what it gets.

    problem : the evidence of the frame.  state : particles of the frame before, any number of them.
    Returns the particles of this frame and what is to be said about it.
    """

    def __call__(
        self,
        problem: ArticulatedProblem,
        state: ParticleState,
        settings: _Settings_contra,
        /,
        *,
        rng: np.random.Generator,
    ) -> tuple[ParticleState, FilterInfo]: ...


@dataclass(frozen=True)
class Filter(Generic[_Settings]):
    """All that the rest of the package has to know of a filter.

    name : as on the command line.  label : as in the tables of XN, where it has the filter.
    settings_from_budget : (budget, layout, std) -> settings; std (D,) is the noise of one frame, m and rad. It raises
    ValueError when something of the budget does not fit the layout.
    is_part_by_part : needs one log-likelihood for each part, so not a global one.
    uses_hierarchy : over a scalable body.  uses_limbs : drops limbs that have no data.
    """

    name: str
    label: str
    step: Step[_Settings]
    settings_from_budget: Callable[[FilterBudget, StateLayout, Array], _Settings]
    is_part_by_part: bool = False
    uses_hierarchy: bool = False
    uses_limbs: bool = False
