"""Scouts for limbs that fit badly: a wide search in one limb's columns while the rest of the body holds still."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from mocap.data.problem import ArticulatedProblem, HeldBodyProblem, StateLayout, limbs_of
from mocap.filters.annealing import layer_scales, next_beta
from mocap.filters.resampling import systematic
from mocap.filters.weights import normalise_log_weights

Array = NDArray[np.float64]
Bonus = Callable[[Array, list[int]], Array]
Value = Callable[[Array], Array]


@dataclass(frozen=True)
class ScoutSettings:
    """When a limb is searched for, and how hard."""

    threshold: float = -7.0
    """A limb is searched for when one of its parts has a lower log-likelihood; good fits lie at -1 to -4."""
    margin: float = 2.0
    """The limb's log-likelihood must rise by this much, or the old pose stays."""
    n_samples: int = 450
    """Poses of the limb drawn over its whole range. Of as many draws twice as many of these find no more (two seeds of
    six sessions, `python -m eval.pose_ablation`)."""
    oversampling: int = 4
    """Draws per sample, where a limb's axis picks among them (`HeldBodyProblem.limb_in_data`)."""
    n_layers: int = 4
    n_particles: int = 100
    std_rad: float = 0.5
    max_limbs: int = 2
    """Limbs searched for in one call, the worst first."""
    n_alternatives: int = 0
    """Other poses of each limb that are handed back, the best ones that differ by more than `apart_rad`."""
    apart_rad: float = 0.4


@dataclass(frozen=True)
class ScoutInfo:
    """tried, accepted : names of the first part of each limb.  alternatives : (A, D) other poses, limb after limb."""

    tried: tuple[str, ...]
    accepted: tuple[str, ...]
    alternatives: Array


def scout_limbs(
    problem: ArticulatedProblem,
    state: Array,
    settings: ScoutSettings,
    *,
    rng: np.random.Generator,
    bonus: Bonus | None = None,
    look_at: Sequence[int] = (),
    is_drawn: NDArray[np.bool_] | None = None,
) -> tuple[Array, ScoutInfo]:
    """Search anew for the limbs of a state (D,) that fit badly; returns the state, improved or unchanged.

    bonus : (particles (N, D), parts of the limb) -> (N,) nats, evidence for a limb beyond the likelihood, such as
    data that nothing explains yet; 0 for the given state.  look_at : limbs, by their first part, that are looked at
    though they fit.  is_drawn : (D,) columns that are searched in, None = all; others stay. Of all limbs looked at,
    those that gain most at first sight are followed. A global likelihood (one column) says nothing about limbs: the
    state comes back unchanged.
    Source: the scout filters of CF 7.4 (DDMA-PF), here as a means of recovery inside any filter.
    """
    layout = problem.layout
    columns_of = partial(_bounded_columns, layout, is_drawn=is_drawn)
    per_part = problem.log_likelihood(state[None])[0]
    if per_part.shape[0] != layout.n_parts:
        return state, ScoutInfo((), (), state[None][:0])
    limbs = [
        limb
        for limb in limbs_of(layout)
        if (limb[0] in look_at or per_part[limb].min() < settings.threshold) and len(columns_of(limb))
    ]

    def judge(held: Array, limb: list[int]) -> Value:
        likelihood = limb_log_likelihood(problem, held, limb)
        return likelihood if bonus is None else lambda x: likelihood(x) + bonus(x, limb)

    screened = [
        _drawn(problem, state, limb, columns_of(limb), settings, judge(state, limb), rng=rng)
        for limb in limbs
    ]
    screened.sort(key=lambda drawn: -drawn.gain)
    tried, accepted = [], []
    alternatives: list[Array] = []
    best = state
    for drawn in screened[: settings.max_limbs]:
        name = layout.parts[drawn.limb[0]]
        tried.append(name)
        value_of = judge(best, drawn.limb)
        if best is not state:
            drawn = _held(drawn, best, value_of)
        every, value = _closed_in(problem, drawn, settings, value_of, rng=rng)
        if settings.n_alternatives:
            alternatives += _distinct(every, value, drawn.columns, settings)
        if value.max() > value_of(best[None])[0] + settings.margin:
            best = every[value.argmax()].copy()
            accepted.append(name)
    others = np.stack(alternatives) if alternatives else state[None][:0]
    return best, ScoutInfo(tuple(tried), tuple(accepted), others)


@dataclass(frozen=True, eq=False)
class _Drawn:
    """Poses of one limb drawn over its whole range.  columns : those drawn.  particles : (N, D).  value : (N,) nats.
    gain : the best one's."""

    limb: list[int]
    columns: NDArray[np.int64]
    particles: Array
    value: Array
    gain: float = 0.0


def _drawn(
    problem: ArticulatedProblem,
    state: Array,
    limb: list[int],
    columns: NDArray[np.int64],
    settings: ScoutSettings,
    value_of: Value,
    *,
    rng: np.random.Generator,
) -> _Drawn:
    """A limb of a state (D,) drawn anew; where the problem can say cheaply which draws lie in the data, the best of
    more draws."""
    layout = problem.layout
    coarse = problem if isinstance(problem, HeldBodyProblem) else None
    n_drawn = settings.n_samples * (1 if coarse is None else settings.oversampling)
    particles = np.tile(state, (n_drawn, 1))
    low, high = layout.lower[columns], layout.upper[columns]
    particles[:, columns] = low + rng.random((n_drawn, len(columns))) * (high - low)
    if coarse is not None:
        in_data = coarse.limb_in_data(particles, limb)
        particles = particles[np.argsort(-in_data, kind="stable")[: settings.n_samples]]
    value = value_of(particles)
    return _Drawn(limb, columns, particles, value, float(value.max() - value_of(state[None])[0]))


def _held(drawn: _Drawn, best: Array, value_of: Value) -> _Drawn:
    """The same draws on another state (D,): what an earlier limb has found holds for this one too."""
    particles = np.tile(best, (len(drawn.particles), 1))
    particles[:, drawn.columns] = drawn.particles[:, drawn.columns]
    return replace(drawn, particles=particles, value=value_of(particles))


def _closed_in(
    problem: ArticulatedProblem,
    drawn: _Drawn,
    settings: ScoutSettings,
    value_of: Value,
    *,
    rng: np.random.Generator,
) -> tuple[Array, Array]:
    """All particles (M, D) of a few layers with falling noise around the draws that fit, and their values (M,)."""
    columns = drawn.columns
    particles, value = drawn.particles, drawn.value
    seen, seen_value = [particles], [value]
    std = np.zeros(problem.layout.n_columns)
    for scale in layer_scales(settings.n_layers, 0.5):
        weights, _ = normalise_log_weights(next_beta(value, 0.3) * value)
        std[columns] = settings.std_rad * scale
        particles = particles[systematic(weights, settings.n_particles, rng=rng)]
        particles = problem.propagate(particles, std, rng=rng)
        value = value_of(particles)
        seen.append(particles)
        seen_value.append(value)
    return np.concatenate(seen), np.concatenate(seen_value)


def limb_log_likelihood(
    problem: ArticulatedProblem, held: Array, limb: list[int]
) -> Callable[[Array], Array]:
    """(N, D) particles that differ from a state (D,) in a limb's columns only -> (N,) log-likelihood of the limb."""
    if isinstance(problem, HeldBodyProblem):
        return problem.limb_log_likelihood(held, limb)
    rest = [p for p in range(problem.layout.n_parts) if p not in limb]
    return lambda particles: problem.log_likelihood(particles, limb, rest).sum(axis=1)


def _distinct(
    particles: Array, value: Array, columns: NDArray[np.int64], settings: ScoutSettings
) -> list[Array]:
    """The best particles that differ from each other in a limb's columns."""
    angles, left = particles[:, columns], np.argsort(-value, kind="stable")
    chosen: list[Array] = []
    while len(left) and len(chosen) < settings.n_alternatives:
        best = left[0]
        chosen.append(particles[best])
        left = left[np.abs(angles[left] - angles[best]).max(axis=1) > settings.apart_rad]
    return chosen


def _bounded_columns(
    layout: StateLayout, limb: list[int], is_drawn: NDArray[np.bool_] | None
) -> NDArray[np.int64]:
    columns = layout.columns_of(limb)
    if is_drawn is not None:
        columns = columns[is_drawn[columns]]
    return columns[np.isfinite(layout.lower[columns]) & np.isfinite(layout.upper[columns])]
