"""Partitioned sampling with intervals (PSIPF): each part is tried on grids around the particles, the best are kept."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mocap.data.problem import ArticulatedProblem, StateLayout
from mocap.filters.budget import FilterBudget
from mocap.filters.estimate import weighted_mean
from mocap.filters.parts import columns_in, part_scores, require_parts
from mocap.filters.record import Filter
from mocap.filters.resampling import systematic
from mocap.filters.state import FilterInfo, ParticleState
from mocap.filters.timing import Stopwatch
from mocap.filters.weights import effective_sample_size, normalise_log_weights

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

_LEAST_VALUES = 3  # below, in the middle, above: fewer are no interval


@dataclass(frozen=True, eq=False)
class PsipfSettings:
    """Settings of partitioned sampling with intervals.

    n_particles : placements that are scored for every part.  std : (D,) noise of the random walk, m and rad.
    n_kept : distinct particles that go on to the next part and the next frame.
    reach : half an interval in standard deviations. `pose` takes half of the largest speed as standard deviation, so
    that 2 is as far as a joint can get in a frame.
    """

    n_particles: int
    std: Array
    n_kept: int
    reach: float = 2.0

    def __post_init__(self) -> None:
        if not 1 <= self.n_kept <= self.n_particles:
            raise ValueError(f"n_kept must lie in 1 to n_particles = {self.n_particles}, got {self.n_kept}")
        if not self.reach > 0:
            raise ValueError(f"reach must be positive, got {self.reach}")


def psipf_step(
    problem: ArticulatedProblem,
    state: ParticleState,
    settings: PsipfSettings,
    *,
    rng: np.random.Generator,
) -> tuple[ParticleState, FilterInfo]:
    """One frame of partitioned sampling with intervals: part after part, in the order of the layout.

    Around every kept particle the part's columns are tried on a grid, and the placements of highest likelihood are
    kept, of this part and those before it. Equal likelihoods are told apart by chance. No draw from the posterior:
    the particles that come back are the best of the frame, weighted by their likelihood.
    A part that cannot move is scored for the kept particles only.
    `beta` and `ess` have one entry for each part.
    Source: XN 3.1.3. Departs from it where it leaves things open: decision 18.
    """
    layout = problem.layout
    require_parts(problem, state.particles)
    particles, weights = _distinct(state, settings.n_kept)
    total = np.zeros(len(particles))
    watch = Stopwatch()
    done: list[int] = []
    ess, n_part_evaluations, is_degenerate = [], 0, False
    for part in range(layout.n_parts):
        with watch.of("propagation"):
            tried, parents = _candidates(problem, particles, weights, part, settings, rng=rng)
        with watch.of("likelihood"):
            scores, is_silent = part_scores(problem, tried, [part], done)
        n_part_evaluations += len(tried)
        with watch.of("resampling"):
            total = total[parents] + scores[:, 0]
            kept = np.lexsort((rng.random(len(total)), -total))[: settings.n_kept]
            particles, total = tried[kept], total[kept]
            weights, log_mean = normalise_log_weights(total)
        ess.append(effective_sample_size(weights))
        is_degenerate |= is_silent or not np.isfinite(log_mean)
        if not np.isfinite(log_mean):
            total = np.zeros(len(total))
        done.append(part)
    info = FilterInfo(
        estimate=weighted_mean(particles, weights, layout.is_circular),
        best=particles[0].copy(),
        best_log_likelihood=float(total[0]),
        beta=np.ones(layout.n_parts),
        ess=np.array(ess),
        n_evaluations=round(n_part_evaluations / layout.n_parts),
        is_degenerate=is_degenerate,
        seconds=watch.seconds,
    )
    return ParticleState(particles, weights), info


def _distinct(state: ParticleState, n: int) -> tuple[Array, Array]:
    """The n heaviest different particles, with equal weights."""
    _, first = np.unique(state.particles, axis=0, return_index=True)
    kept = first[np.argsort(-state.weights[first], kind="stable")[:n]]
    return state.particles[kept], np.full(len(kept), 1.0 / len(kept))


def _candidates(
    problem: ArticulatedProblem,
    particles: Array,
    weights: Array,
    part: int,
    settings: PsipfSettings,
    *,
    rng: np.random.Generator,
) -> tuple[Array, Indices]:
    """Placements of one part to score, and the particle that each comes from.

    A grid around every particle (M, D), and random steps from particles drawn by their weights up to n_particles.
    """
    layout, m = problem.layout, len(particles)
    moving = movable(layout, part, settings.std)
    if not len(moving):
        return particles, np.arange(m)
    n_gridded, n_values = grid_size(len(moving), settings.n_particles // m)
    offsets = grid_offsets(n_gridded, n_values)
    n_rest = settings.n_particles - m * len(offsets)
    parents = np.concatenate([np.repeat(np.arange(m), len(offsets)), systematic(weights, n_rest, rng=rng)])
    std = np.where(columns_in(layout, [part]), settings.std, 0.0)
    tried = problem.propagate(particles[parents], std, rng=rng)
    # Each particle has its own columns on the grid, so that all of them get there when there is not room for all.
    gridded = np.sort(rng.permuted(np.tile(moving, (m, 1)), axis=1)[:, :n_gridded], axis=1)
    centre, half = np.take_along_axis(particles, gridded, axis=1), settings.reach * settings.std[gridded]
    low = np.maximum(centre - half, layout.lower[gridded])
    high = np.minimum(centre + half, layout.upper[gridded])
    values = low[:, None, :] + offsets * (high - low)[:, None, :]
    rows = np.arange(m * len(offsets))
    tried[rows[:, None], gridded[parents[rows]]] = values.reshape(len(rows), n_gridded)
    return tried, parents


def movable(layout: StateLayout, part: int, std: Array) -> Indices:
    """Columns of a part that have noise and room, (d,)."""
    columns = layout.columns_of(part)
    return columns[(std[columns] > 0) & (layout.lower[columns] < layout.upper[columns])]


def grid_size(n_columns: int, n_placements: int) -> tuple[int, int]:
    """How many columns get a grid and how many values each, for at most n_placements combinations.

    As many columns as can have three values, then as many values as there is room for, an odd number: standing still
    is one of them.
    """
    n_gridded = 0
    while n_gridded < n_columns and _LEAST_VALUES ** (n_gridded + 1) <= n_placements:
        n_gridded += 1
    n_values = 1
    while n_gridded and (n_values + 2) ** n_gridded <= n_placements:
        n_values += 2
    return n_gridded, n_values


def grid_offsets(n_columns: int, n_values: int) -> Array:
    """All combinations of values in the middle of n_values equal cells of [0, 1], (n_values^n_columns, n_columns).

    None, shape (0, 0), without columns.
    """
    if not n_columns:
        return np.empty((0, 0))
    middle = (np.arange(n_values) + 0.5) / n_values
    return np.stack(np.meshgrid(*[middle] * n_columns, indexing="ij"), axis=-1).reshape(-1, n_columns)


def interval_settings(budget: FilterBudget, layout: StateLayout, std: Array) -> PsipfSettings:
    """n_particles * n_layers placements of every part; as many particles are kept as can try 27 each: a joint with
    three angles gets three values in each of them."""
    n = budget.n_evaluations
    return PsipfSettings(n_particles=n, std=std, n_kept=max(n // 27, 1))


PSIPF = Filter("psipf", "PSIPF", psipf_step, interval_settings, is_part_by_part=True)
