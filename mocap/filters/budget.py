"""Equal budgets: what a frame may cost and how to spend it, in plain values that every filter can read."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Protocol

from mocap.data.hierarchy import Hierarchy
from mocap.filters.limb_settings import LimbSettings


class FilterSettings(Protocol):
    """What all settings have in common: the number of particles to start with."""

    @property
    def n_particles(self) -> int: ...


@dataclass(frozen=True)
class FilterBudget:
    """Which filter, and n_particles * n_layers evaluations of the whole state for each of its frames.

    An evaluation of one part counts as its share, 1 / P.  name : a key of `FILTERS`.
    The fields after `resampling` are read by filters over scalable bodies and by those that drop limbs only.
    Raises ValueError for impossible numbers.
    Source: XN 4.4.4 (equal numbers of likelihood evaluations, reading guide 23).
    """

    name: str
    n_particles: int
    n_layers: int
    survival_rate: float = 0.5
    """Target ESS / N of every annealing layer, and the factor on the noise covariance from layer to layer (CF 3.2)."""
    resampling: str = "systematic"
    hierarchy: Hierarchy | None = None
    """The models, coarse to fine; None = by depth in the tree of parts."""
    level_particles: tuple[int, ...] = ()
    """Particles of each model; none = as many as the evaluations pay for."""
    level_layers: int = 2
    """Annealing layers of each model (CF 7.5.1)."""
    structural_rate: float = 0.8
    """Factor on the noise covariance from model to model (CF 7.5.1)."""
    crossing: str = "mirror"
    """Who gives columns to whom between models, a key of `CROSSING` (CF 7.3.2.3)."""
    limbs: LimbSettings = field(default_factory=LimbSettings)
    """Limbs that may be lost, and when they are."""

    def __post_init__(self) -> None:
        if self.n_particles < 2 or self.n_layers < 1:
            raise ValueError(
                f"n_layers >= 1 and n_particles >= 2, got {self.n_layers} and {self.n_particles}"
            )

    @property
    def n_evaluations(self) -> int:
        """Evaluations of the whole state per frame."""
        return self.n_particles * self.n_layers
