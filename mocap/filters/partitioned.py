"""Partitioned steps: resample, propagate, score, recombine, set after set; what filters part after part share."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mocap.data.problem import ArticulatedProblem, StateLayout
from mocap.filters._kernels import exchange_kernel
from mocap.filters.annealing import BETA_MAX, annealed, layer_scales, next_beta
from mocap.filters.budget import FilterBudget
from mocap.filters.estimate import weighted_mean
from mocap.filters.parts import columns_in, owners, part_scores, require_parts
from mocap.filters.resampling import RESAMPLING
from mocap.filters.state import FilterInfo, ParticleState
from mocap.filters.swapping import placements
from mocap.filters.timing import Stopwatch
from mocap.filters.weights import effective_sample_size, normalise_log_weights

Array = NDArray[np.float64]
Indices = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class PartitionedSettings:
    """Settings of the filters that place part after part.

    n_particles : each is scored once for every part.  std : (D,) noise of the random walk, m and rad.
    """

    n_particles: int
    std: Array
    resampling: str = "systematic"

    def __post_init__(self) -> None:
        if self.n_particles < 2:
            raise ValueError(f"n_particles must be at least 2, got {self.n_particles}")
        if self.resampling not in RESAMPLING:
            raise ValueError(f"resampling {self.resampling!r} is none of {', '.join(RESAMPLING)}")


@dataclass(frozen=True, eq=False)
class Partial:
    """Particles of which some parts are placed in the new frame and the rest is still as it was.

    particles : (N, D).  weights : (N,), normalised.  scores : (N, P) log-likelihoods of the placed parts, else 0.
    placed : (N, P) placement numbers; equal numbers of a part mean equal placements of it.
    """

    particles: Array
    weights: Array
    scores: Array
    placed: Indices

    def take(self, ancestors: Indices) -> Partial:
        """The particles of some indices (n,), with equal weights."""
        n = len(ancestors)
        return Partial(
            self.particles[ancestors], np.full(n, 1.0 / n), self.scores[ancestors], self.placed[ancestors]
        )

    def with_weights(self, weights: Array) -> Partial:
        """The same particles with other weights (N,)."""
        return Partial(self.particles, weights, self.scores, self.placed)

    def with_parts_of(
        self, donor: Partial, layout: StateLayout, parts: list[int], sources: Indices
    ) -> Partial:
        """Particle i with part k, and all that hangs on it, from the donor's particle sources[i, k].

        sources : (N, K).
        """
        owner = owners(layout, parts)
        placed_parts = np.where(np.isin(np.arange(layout.n_parts), parts), owner, -1)

        def exchanged(base: NDArray[np.generic], given: NDArray[np.generic], owner: Indices) -> NDArray[Any]:
            out = np.empty_like(base)
            exchange_kernel(base, given, sources, owner, out)
            return out

        return Partial(
            exchanged(self.particles, donor.particles, owner[layout.part_of_column]),
            self.weights,
            exchanged(self.scores, donor.scores, placed_parts),
            exchanged(self.placed, donor.placed, placed_parts),
        )


@dataclass
class _Tally:
    """What a step notes down on its way."""

    betas: list[float] = field(default_factory=list)
    ess: list[float] = field(default_factory=list)
    n_part_evaluations: int = 0
    is_degenerate: bool = False
    watch: Stopwatch = field(default_factory=Stopwatch)

    def layer(self, beta: float, weights: Array) -> None:
        self.betas.append(beta)
        self.ess.append(effective_sample_size(weights))


def partitioned_settings(budget: FilterBudget, layout: StateLayout, std: Array) -> PartitionedSettings:
    """Every particle is scored once per part, which makes one evaluation: n_particles * n_layers particles."""
    return PartitionedSettings(n_particles=budget.n_evaluations, std=std, resampling=budget.resampling)


# (layout, particles with the weights of a set, parts of the set, resampling scheme, rng) -> particles
Recombination = Callable[..., Partial]


def partitioned_step(
    problem: ArticulatedProblem,
    state: ParticleState,
    settings: PartitionedSettings,
    sets: list[list[int]],
    *,
    rng: np.random.Generator,
    recombination: Recombination | None = None,
    counts_as: str = "swapping",
    n_layers: int = 1,
    survival_rate: float = 0.5,
    beta_max: float = BETA_MAX,
) -> tuple[ParticleState, FilterInfo]:
    """One frame: for every set of parts resample, propagate its columns, score it, and recombine.

    sets : indices of the parts that are processed together, parents before children. recombination : exchanges
    parts between the weighted particles of a set; counts_as : the name of its time in `seconds`. n_layers,
    survival_rate, beta_max : annealing inside every set; the last layer's weights are the likelihood itself. The
    particles come back weighted: the next frame resamples them.
    `beta` and `ess` have one entry for each layer of each set; `best` counts every part as it was scored when placed.
    Source: XN Alg. 3.1, Eq. 3.1, 4.2-4.3.
    """
    layout, n = problem.layout, settings.n_particles
    require_parts(problem, state.particles)
    resample = RESAMPLING[settings.resampling]
    tally = _Tally()
    nothing = np.zeros((len(state.weights), layout.n_parts))
    partial = Partial(state.particles, state.weights, nothing, nothing.astype(np.int64))
    done: list[int] = []
    for parts in sets:
        scales = layer_scales(n_layers, survival_rate)
        for layer, scale in enumerate(scales):
            with tally.watch.of("resampling"):
                partial = partial.take(resample(partial.weights, n, rng=rng))
            partial = _placed(problem, partial, parts, done, settings.std * scale, tally, rng=rng)
            survival = survival_rate if layer + 1 < n_layers else None
            partial = _weighed(partial, parts, survival, beta_max, tally)
        if recombination is not None:
            with tally.watch.of(counts_as):
                partial = recombination(layout, partial, parts, scheme=settings.resampling, rng=rng)
        done = done + parts
    total = partial.scores.sum(axis=1)
    top = int(np.argmax(total))
    info = FilterInfo(
        estimate=weighted_mean(partial.particles, partial.weights, layout.is_circular),
        best=partial.particles[top].copy(),
        best_log_likelihood=float(total[top]),
        beta=np.array(tally.betas),
        ess=np.array(tally.ess),
        n_evaluations=round(tally.n_part_evaluations / layout.n_parts),
        is_degenerate=tally.is_degenerate,
        seconds=tally.watch.seconds,
    )
    return ParticleState(partial.particles, partial.weights), info


def _placed(
    problem: ArticulatedProblem,
    partial: Partial,
    parts: list[int],
    done: list[int],
    std: Array,
    tally: _Tally,
    *,
    rng: np.random.Generator,
) -> Partial:
    """Particles after one propagation and scoring of a set of parts, given those done before."""
    std = np.where(columns_in(problem.layout, parts), std, 0.0)
    with tally.watch.of("propagation"):
        moved = problem.propagate(partial.particles, std, rng=rng)
        placed = placements(problem.layout, partial.placed, moved, parts, std > 0)
    with tally.watch.of("likelihood"):
        scores = partial.scores.copy()
        scores[:, parts], is_silent = part_scores(problem, moved, parts, done)
    tally.n_part_evaluations += len(moved) * len(parts)
    tally.is_degenerate |= is_silent
    return Partial(moved, partial.weights, scores, placed)


def _weighed(
    partial: Partial, parts: list[int], survival: float | None, beta_max: float, tally: _Tally
) -> Partial:
    """Particles with the weights of a set, annealed to a survival rate or, with None, as they are."""
    log_set = partial.scores[:, parts].sum(axis=1)
    beta = 1.0 if survival is None else next_beta(log_set, survival, beta_max=beta_max)
    weights, log_mean = normalise_log_weights(annealed(log_set, beta))
    tally.is_degenerate |= not np.isfinite(log_mean)
    tally.layer(beta, weights)
    return partial.with_weights(weights)
