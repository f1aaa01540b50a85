"""Scouts for limbs that fit badly: a wide search in one limb's columns while the rest of the body holds still."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mocap.data.problem import ArticulatedProblem, StateLayout
from mocap.filters.annealing import annealed, layer_scales, next_beta
from mocap.filters.resampling import systematic
from mocap.filters.weights import normalise_log_weights

Array = NDArray[np.float64]


@dataclass(frozen=True)
class ScoutSettings:
    """When a limb is searched for, and how hard."""

    threshold: float = -7.0
    """A limb is searched for when one of its parts has a lower log-likelihood; good fits lie at -1 to -4."""
    margin: float = 2.0
    """The body's log-likelihood must rise by this much, or the old pose stays."""
    n_samples: int = 300
    """Poses of the limb drawn over its whole range."""
    n_layers: int = 4
    n_particles: int = 100
    std_rad: float = 0.5
    max_limbs: int = 2
    """Limbs searched for in one call, the worst first."""


@dataclass(frozen=True)
class ScoutInfo:
    """tried, accepted : names of the first part of each limb."""

    tried: tuple[str, ...]
    accepted: tuple[str, ...]


def limbs_of(layout: StateLayout) -> list[list[int]]:
    """Limbs as lists of parts: every child of the root part with all that hangs on it."""
    limb_of: dict[int, int] = {}
    for part in range(1, layout.n_parts):
        parent = int(layout.parent_of_part[part])
        limb_of[part] = part if parent == 0 else limb_of[parent]
    return [[p for p, limb in limb_of.items() if limb == first] for first in sorted(set(limb_of.values()))]


def scout_limbs(
    problem: ArticulatedProblem, state: Array, settings: ScoutSettings, *, rng: np.random.Generator
) -> tuple[Array, ScoutInfo]:
    """Search anew for the limbs of a state (D,) that fit badly; returns the state, improved or unchanged.

    A global likelihood (one column) says nothing about limbs: the state comes back unchanged.
    Source: the scout filters of CF 7.4 (DDMA-PF), here as a means of recovery inside any filter.
    """
    layout = problem.layout
    per_part = problem.log_likelihood(state[None])[0]
    if per_part.shape[0] != layout.n_parts:
        return state, ScoutInfo((), ())
    limbs = limbs_of(layout)
    worst = sorted(limbs, key=lambda limb: float(per_part[limb].min()))[: settings.max_limbs]
    tried, accepted = [], []
    best, best_value = state, float(per_part.sum())
    for limb in worst:
        if per_part[limb].min() >= settings.threshold:
            break
        columns = np.flatnonzero(np.isin(layout.part_of_column, limb))
        columns = columns[np.isfinite(layout.lower[columns]) & np.isfinite(layout.upper[columns])]
        if len(columns) == 0:
            continue
        name = layout.parts[limb[0]]
        tried.append(name)
        particles = np.tile(best, (settings.n_samples, 1))
        low, high = layout.lower[columns], layout.upper[columns]
        particles[:, columns] = low + rng.random((settings.n_samples, len(columns))) * (high - low)
        value = problem.log_likelihood(particles).sum(axis=1)
        candidate, reached = particles[value.argmax()], float(value.max())
        std = np.zeros(layout.n_columns)
        for scale in layer_scales(settings.n_layers, 0.5):
            weights, _ = normalise_log_weights(annealed(value, next_beta(value, 0.3)))
            std[columns] = settings.std_rad * scale
            particles = particles[systematic(weights, settings.n_particles, rng=rng)]
            particles = problem.propagate(particles, std, rng=rng)
            value = problem.log_likelihood(particles).sum(axis=1)
            if value.max() > reached:
                candidate, reached = particles[value.argmax()], float(value.max())
        if reached > best_value + settings.margin:
            best, best_value = candidate.copy(), reached
            accepted.append(name)
    return best, ScoutInfo(tuple(tried), tuple(accepted))
