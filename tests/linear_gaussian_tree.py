"""An articulated problem whose posterior is known exactly: a tree of linear joints seen with Gaussian noise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from mocap.data import StateLayout
from mocap.data.propagation import truncated_gaussian_step

Array = NDArray[np.float64]


def tree_layout(
    parents: Sequence[int],
    n_columns: Sequence[int],
    *,
    bound: float = np.inf,
    is_circular: bool = False,
) -> StateLayout:
    """A layout from the parent and the number of columns of every part, all columns with the same bounds."""
    part_of_column = np.repeat(np.arange(len(parents)), n_columns)
    D = len(part_of_column)
    return StateLayout(
        names=tuple(f"column_{c}" for c in range(D)),
        lower=np.full(D, -bound),
        upper=np.full(D, bound),
        is_circular=np.full(D, is_circular),
        parts=tuple(f"part_{p}" for p in range(len(parents))),
        part_of_column=part_of_column,
        parent_of_part=np.array(parents),
    )


def positions_of(layout: StateLayout) -> Array:
    """Matrix H (P, D): a part lies at its parent's position plus the sum of its own columns."""
    H = np.zeros((layout.n_parts, layout.n_columns))
    for part, parent in enumerate(layout.parent_of_part):
        if parent >= 0:
            H[part] = H[parent]
        H[part, layout.columns_of(part)] = 1.0
    return H


@dataclass(eq=False)
class LinearGaussianTree:
    """One frame: z = H x + N(0, noise^2), one measurement per part; x moves by N(0, std^2).

    z : (P,).  silent : parts whose log-likelihood is `silence` for every particle.  is_global : one column for all.
    calls : (number of particles, parts, given) of every scoring.
    """

    layout: StateLayout
    z: Array
    noise: float
    silent: tuple[int, ...] = ()
    silence: float = -np.inf
    is_global: bool = False
    calls: list[tuple[int, tuple[int, ...], tuple[int, ...]]] = field(default_factory=list)

    def propagate(self, particles: Array, std: Array, *, rng: np.random.Generator) -> Array:
        return truncated_gaussian_step(particles, std, self.layout.lower, self.layout.upper, rng=rng)

    def log_likelihood(
        self, particles: Array, parts: Sequence[int] | None = None, given: Sequence[int] = ()
    ) -> Array:
        scored = list(range(self.layout.n_parts)) if parts is None else list(parts)
        self.calls.append((len(particles), tuple(scored), tuple(given)))
        distance = particles @ positions_of(self.layout)[scored].T - self.z[scored]
        value = -0.5 * (distance / self.noise) ** 2
        value[:, np.isin(scored, self.silent)] = self.silence
        return value.sum(axis=1, keepdims=True) if self.is_global else value


def exact_posterior(
    layout: StateLayout, measurements: Array, std: Array, noise: float, start: Array
) -> tuple[Array, Array]:
    """Kalman filter: mean (D,) and covariance (D, D) after measurements (T, P), from a known start (D,)."""
    H = positions_of(layout)
    mean, covariance = start.copy(), np.zeros((len(start), len(start)))
    for z in measurements:
        covariance = covariance + np.diag(std**2)
        S = H @ covariance @ H.T + noise**2 * np.eye(len(z))
        gain = np.linalg.solve(S, H @ covariance).T
        mean = mean + gain @ (z - H @ mean)
        covariance = covariance - gain @ H @ covariance
    return mean, covariance
