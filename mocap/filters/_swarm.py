"""The search of a swarm, over the whole state or part after part: what the swarm filters share."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mocap.data.problem import ArticulatedProblem, StateLayout
from mocap.filters.budget import FilterBudget
from mocap.filters.estimate import weighted_mean
from mocap.filters.parts import part_scores, require_parts
from mocap.filters.resampling import RESAMPLING
from mocap.filters.state import FilterInfo, ParticleState
from mocap.filters.timing import Stopwatch
from mocap.filters.weights import effective_sample_size, normalise_log_weights
from mocap.geometry.rigid import wrap_angle

Array = NDArray[np.float64]
Indices = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class SwarmSettings:
    """Settings of the swarm filters.

    n_iterations : moves after the first draw, M; every particle is scored n_iterations + 1 times. std : (D,) noise of
    the first draw, m and rad ("P_(0)").
    """

    n_particles: int
    n_iterations: int
    std: Array
    covariance_factor: float = 0.5
    """Factor on the covariance of the sampling noise from iteration to iteration (alpha_0)."""
    beta_0: float = 0.5
    beta_max: float = 3.0
    beta_min: float = 1.0
    """Annealing of the attraction, XN 6.2: from about beta_0 beta_max down to beta_0 beta_min."""
    attraction: float = 2.0
    """Constant attraction of the canonical swarms PSO and HPSO (XN 6.1.1)."""
    inertia: float = 0.5
    """Share of the velocity that is kept, where there is a velocity: PSO, HPSO and CHAPSOPF."""
    resampling: str = "systematic"

    def __post_init__(self) -> None:
        if self.n_particles < 2 or self.n_iterations < 0:
            raise ValueError(
                f"n_particles >= 2 and n_iterations >= 0, got {self.n_particles} and {self.n_iterations}"
            )
        if self.resampling not in RESAMPLING:
            raise ValueError(f"resampling {self.resampling!r} is none of {', '.join(RESAMPLING)}")
        if not 0 < self.beta_0 <= 1 or not 0 < self.beta_min < self.beta_max:
            raise ValueError(
                "0 < beta_0 <= 1 and 0 < beta_min < beta_max, got "
                f"{self.beta_0}, {self.beta_min} and {self.beta_max}"
            )
        if not 0 < self.covariance_factor < 1:
            raise ValueError(f"covariance_factor must lie in (0, 1), got {self.covariance_factor}")


def annealed_attraction(settings: SwarmSettings, m: int) -> float:
    """beta_1 = beta_2 of iteration m = 1..M.  Source: XN Eq. 6.3."""
    ratio = settings.beta_max / settings.beta_min
    return settings.beta_0 * settings.beta_max * ratio ** (-m / settings.n_iterations)


def constant_attraction(settings: SwarmSettings, m: int) -> float:
    """Attraction of the canonical swarm.  Source: XN Eq. 3.6."""
    return settings.attraction


@dataclass(frozen=True)
class Swarm:
    """What tells the swarm filters apart.

    has_velocity : moves keep a share of the last one; else they get sampling noise that shrinks.
    is_estimate_best : the estimate is the best particle; else the weighted mean.
    is_carried_on : every particle starts from its own last place; else places are drawn by weight.
    is_settled : of swarms part by part: all particles go on from the best placement of a part; else each from its own.
    is_drawn : of swarms part by part: particles are drawn by the weights of a part before the next one is searched,
    as in partitioned sampling, and the last part's weights are those that come back; else weights are the product over
    all parts.
    """

    attraction: Callable[[SwarmSettings, int], float]
    has_velocity: bool
    is_estimate_best: bool
    is_carried_on: bool
    is_settled: bool = False
    is_drawn: bool = False


def fly(
    problem: ArticulatedProblem,
    score: Callable[[Array], Array],
    x: Array,
    columns: Indices,
    settings: SwarmSettings,
    kind: Swarm,
    *,
    rng: np.random.Generator,
) -> tuple[Array, Array]:
    """A swarm's search over some columns: the best state of every particle (N, D) and its score (N,).

    score : states (N, D) -> (N,) nats.  x : (N, D), where the particles were.  columns : (C,), those that move. The
    noise goes through the problem's own propagation, which knows the bounds; pull and velocity end at the
    bounds, and differences of circular columns are wrapped.
    Source: XN Alg. 3.4, Eq. 3.6-3.9, 6.1-6.2; departs from them: the noise "r_0 P" and the first velocity have mean
    zero (reading guide 21).
    """
    layout = problem.layout
    std = np.zeros(layout.n_columns)
    std[columns] = settings.std[columns]
    lower, upper, is_circular = (a[columns] for a in (layout.lower, layout.upper, layout.is_circular))

    def difference(a: Array, b: Array) -> Array:
        d = a[..., columns] - b[..., columns]
        return np.where(is_circular, wrap_angle(d), d)

    x = problem.propagate(x, std, rng=rng)
    value = score(x)
    best, best_value = x, value
    size = (len(x), len(columns))
    velocity = (2.0 * rng.random(size) - 1.0) * std[columns] if kind.has_velocity else np.zeros(size)
    for m in range(1, settings.n_iterations + 1):
        leader = best[int(np.argmax(best_value))]
        pull = rng.random(size) * difference(best, x) + rng.random(size) * difference(leader, x)
        velocity = settings.inertia * velocity + kind.attraction(settings, m) * pull
        wished = x[:, columns] + velocity
        moved = x.copy()
        moved[:, columns] = np.clip(wished, lower, upper)
        if kind.has_velocity:
            velocity = np.where(
                moved[:, columns] == wished, velocity, 0.0
            )  # a wall stops what flies against it
            x = moved
        else:
            velocity = np.zeros(size)
            x = problem.propagate(moved, std * settings.covariance_factor ** (0.5 * (m - 1)), rng=rng)
        value = score(x)
        is_better = value > best_value
        best = np.where(is_better[:, None], x, best)
        best_value = np.where(is_better, value, best_value)
    return best, best_value


def _start(state: ParticleState, settings: SwarmSettings, kind: Swarm, *, rng: np.random.Generator) -> Array:
    n = settings.n_particles
    if kind.is_carried_on and len(state.weights) == n:
        return state.particles
    return state.particles[RESAMPLING[settings.resampling](state.weights, n, rng=rng)]


def _finish(
    problem: ArticulatedProblem,
    particles: Array,
    weights: Array,
    score: Array,
    settings: SwarmSettings,
    kind: Swarm,
    is_degenerate: bool,
    watch: Stopwatch,
) -> tuple[ParticleState, FilterInfo]:
    """score : (N,) log-likelihood of the whole state, every part as it was scored when it was placed."""
    top = int(np.argmax(score))
    best = particles[top].copy()
    mean = weighted_mean(particles, weights, problem.layout.is_circular)
    info = FilterInfo(
        estimate=best.copy() if kind.is_estimate_best else mean,
        best=best,
        best_log_likelihood=float(score[top]),
        beta=np.ones(1),
        ess=np.array([effective_sample_size(weights)]),
        n_evaluations=settings.n_particles * (settings.n_iterations + 1),
        is_degenerate=is_degenerate,
        seconds=watch.seconds,
    )
    return ParticleState(particles, weights), info


def whole_step(
    problem: ArticulatedProblem,
    state: ParticleState,
    settings: SwarmSettings,
    kind: Swarm,
    *,
    rng: np.random.Generator,
) -> tuple[ParticleState, FilterInfo]:
    """A swarm over the whole state."""
    watch = Stopwatch()

    def score(x: Array) -> Array:
        with watch.of("likelihood"):
            total = problem.log_likelihood(x).sum(axis=1)
        return np.where(np.isnan(total), -np.inf, total)

    start = _start(state, settings, kind, rng=rng)
    everything = np.arange(problem.layout.n_columns)
    best, value = fly(problem, score, start, everything, settings, kind, rng=rng)
    weights, log_mean = normalise_log_weights(value)
    return _finish(problem, best, weights, value, settings, kind, not np.isfinite(log_mean), watch)


def part_step(
    problem: ArticulatedProblem,
    state: ParticleState,
    settings: SwarmSettings,
    kind: Swarm,
    *,
    rng: np.random.Generator,
) -> tuple[ParticleState, FilterInfo]:
    """A swarm for every part, in the order of the layout."""
    watch = Stopwatch()
    require_parts(problem, state.particles)
    x = _start(state, settings, kind, rng=rng)
    total, weights = np.zeros(settings.n_particles), np.empty(0)
    is_degenerate = False
    for part in range(problem.layout.n_parts):

        def score(candidates: Array, part: int = part) -> Array:
            nonlocal is_degenerate
            with watch.of("likelihood"):
                scores, is_silent = part_scores(problem, candidates, [part], list(range(part)))
            is_degenerate |= is_silent
            return scores[:, 0]

        if kind.is_drawn and part:
            with watch.of("resampling"):
                ancestors = RESAMPLING[settings.resampling](weights, settings.n_particles, rng=rng)
            x, total = x[ancestors], total[ancestors]
        columns = problem.layout.columns_of(part)
        x, value = fly(problem, score, x, columns, settings, kind, rng=rng)
        if kind.is_settled:
            top = int(np.argmax(value))
            x, value = x.copy(), np.full(len(value), value[top])
            x[:, columns] = x[top, columns]
        total = total + value
        weights, log_mean = normalise_log_weights(value if kind.is_drawn else total)
        is_degenerate |= not np.isfinite(log_mean)
    return _finish(problem, x, weights, total, settings, kind, is_degenerate, watch)


def swarm_settings(budget: FilterBudget, layout: StateLayout, std: Array) -> SwarmSettings:
    """One draw and n_layers - 1 moves of n_particles, but at least one move: a swarm of one layer is two of half."""
    n_iterations = max(budget.n_layers - 1, 1)
    return SwarmSettings(
        n_particles=max(budget.n_evaluations // (n_iterations + 1), 2),
        n_iterations=n_iterations,
        std=std,
        covariance_factor=budget.survival_rate,
        resampling=budget.resampling,
    )
