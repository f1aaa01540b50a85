"""Other readings of what the sources leave open: likelihoods, states and filters of eval.decomposition_regimes only."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mocap.data.problem import ArticulatedProblem, StateLayout
from mocap.filters import FILTERS, Filter, FilterInfo, ParticleState, Step
from mocap.filters._swarm import SwarmSettings
from mocap.filters.hapsopf import hapsopf_printed_step
from mocap.filters.partitioned import Partial, PartitionedSettings, partitioned_step
from mocap.filters.parts import part_sets
from mocap.filters.pfcr import combine_parts
from mocap.filters.psapf import PsapfSettings, psapf_step, sbapf_step
from mocap.filters.resampling import systematic
from mocap.filters.weights import normalise_log_weights
from mocap.polygons.likelihood import PolygonProblem, polygon_scores
from mocap.polygons.tree import PolygonTree

Array = NDArray[np.float64]

_LEAST_OVERLAP = 1e-12


class LogDistanceProblem(PolygonProblem):
    """The Bhattacharyya distance as Bhattacharyya (XN's reference [10]) has it, d = -ln of the overlap.

    Near the truth d^2 is flat, far from it steep; with d^2 = 1 - overlap, as in Pérez (XN's [75]), it is neither.
    """

    def log_likelihood(
        self, particles: Array, parts: Sequence[int] | None = None, given: Sequence[int] = ()
    ) -> Array:
        squared, uncovered = polygon_scores(self.tree, self.bins, self.reference, particles, parts)
        is_finite = np.isfinite(squared)
        overlap = np.clip(1.0 - np.where(is_finite, squared, 1.0), _LEAST_OVERLAP, 1.0)
        cost = self.settings.lambda_colour * np.log(overlap) ** 2
        cost += self.settings.lambda_silhouette * np.where(is_finite, uncovered, 0.0)
        return np.where(is_finite, -cost, -np.inf)


@dataclass(frozen=True, eq=False)
class AbsoluteAngles:
    """A problem whose angles are those of the parts in the picture, less their rest: a parent that turns does not
    turn what hangs on it.

    to_relative : (D, D), takes such a state to one with angles against the parent.
    """

    problem: ArticulatedProblem
    to_relative: Array

    @property
    def layout(self) -> StateLayout:
        return self.problem.layout

    def propagate(self, particles: Array, std: Array, *, rng: np.random.Generator) -> Array:
        return self.problem.propagate(particles, std, rng=rng)

    def log_likelihood(
        self, particles: Array, parts: Sequence[int] | None = None, given: Sequence[int] = ()
    ) -> Array:
        return self.problem.log_likelihood(particles @ self.to_relative.T, parts, given)


def to_relative(tree: PolygonTree) -> Array:
    """(D, D): a state with the parts' angles in the picture, less their rest, to one with angles against the parent."""
    layout = tree.layout
    out = np.eye(layout.n_columns)
    for part in range(layout.n_parts):
        parent = int(layout.parent_of_part[part])
        if parent >= 0:
            is_root = layout.parent_of_part[parent] < 0
            turns = tree.first_column[parent] + (2 if is_root else 0)
            out[tree.first_column[part], turns] = -1.0
    return out


def combine_carried(
    layout: StateLayout, partial: Partial, parts: list[int], *, scheme: str, rng: np.random.Generator
) -> Partial:
    """Combinatorial resampling whose weights wait: no set draws by them, the frame's estimate uses all of them.

    XN 5.2.2 puts it in the place of exchange and resampling, so the weights it keeps may be meant to be carried only.
    """
    drawn = combine_parts(layout, partial, parts, scheme=scheme, rng=rng)
    if parts != part_sets(layout)[-1]:
        return drawn
    weights, _ = normalise_log_weights(drawn.scores.sum(axis=1))
    return drawn.with_weights(weights)


def pfcr_carried_step(
    problem: ArticulatedProblem,
    state: ParticleState,
    settings: PartitionedSettings,
    *,
    rng: np.random.Generator,
) -> tuple[ParticleState, FilterInfo]:
    """PFCR whose particles carry the product of their drawn weights over the sets, without a second draw."""
    sets = part_sets(problem.layout)
    return partitioned_step(problem, state, settings, sets, rng=rng, recombination=combine_carried)


def _smoothing(step: Step[PsapfSettings]) -> Step[PsapfSettings]:
    """An annealed filter whose exponents stay at or below 1."""

    def capped(
        problem: ArticulatedProblem,
        state: ParticleState,
        settings: PsapfSettings,
        *,
        rng: np.random.Generator,
    ) -> tuple[ParticleState, FilterInfo]:
        return step(problem, state, replace(settings, beta_max=1.0), rng=rng)

    return capped


def hapsopf_frame_drawn_step(
    problem: ArticulatedProblem, state: ParticleState, settings: SwarmSettings, *, rng: np.random.Generator
) -> tuple[ParticleState, FilterInfo]:
    """HAPSOPF as printed whose particles are drawn by their weights before every frame, as in a particle filter.

    XN Alg. 6.1 lets each start from its own last best.
    """
    n = settings.n_particles
    particles = state.particles[systematic(state.weights, n, rng=rng)]
    return hapsopf_printed_step(problem, ParticleState(particles, np.full(n, 1.0 / n)), settings, rng=rng)


def hapsopf_narrow_step(
    problem: ArticulatedProblem, state: ParticleState, settings: SwarmSettings, *, rng: np.random.Generator
) -> tuple[ParticleState, FilterInfo]:
    """HAPSOPF as printed whose noise shrinks faster: alpha_0, which XN 6.1.2 leaves open, is 0.1 instead of 0.5."""
    return hapsopf_printed_step(problem, state, replace(settings, covariance_factor=0.1), rng=rng)


def _read_otherwise(base: str, name: str, label: str, step: Step[Any]) -> Filter[Any]:
    return replace(FILTERS[base], name=name, label=label, step=step)


READINGS: dict[str, Filter[Any]] = {
    one.name: one
    for one in (
        _read_otherwise("pfcr", "pfcr-carried", "PFCR, weights carried", pfcr_carried_step),
        _read_otherwise("psapf", "psapf-smooth", "APF, beta <= 1", _smoothing(psapf_step)),
        _read_otherwise("sbapf", "sbapf-smooth", "SBAPF, beta <= 1", _smoothing(sbapf_step)),
        _read_otherwise(
            "hapsopf-printed",
            "hapsopf-frame-drawn",
            "HAPSOPF as printed, drawn every frame",
            hapsopf_frame_drawn_step,
        ),
        _read_otherwise(
            "hapsopf-printed", "hapsopf-narrow", "HAPSOPF as printed, alpha_0 = 0.1", hapsopf_narrow_step
        ),
    )
}


def filter_named(name: str) -> Filter[Any]:
    """A filter of FILTERS, or another reading of one."""
    return READINGS[name] if name in READINGS else FILTERS[name]
