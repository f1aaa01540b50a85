"""Layers: the particles of every annealing layer in a frame, for whoever wants to see how a filter works."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mocap.data import StateLayout
from mocap.data.problem import ArticulatedProblem
from mocap.filters import FILTERS, initial_particles
from mocap.pose.evidence import FrameEvidence

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Layer:
    """The particles (N, D) of one layer as they are judged, and their log-likelihoods (N,)."""

    particles: Array
    log_likelihood: Array


class _Noted:
    """A problem that notes what it is asked for. Implements `ArticulatedProblem`."""

    def __init__(self, problem: ArticulatedProblem) -> None:
        self._problem = problem
        self.layers: list[Layer] = []

    @property
    def layout(self) -> StateLayout:
        return self._problem.layout

    def propagate(self, particles: Array, std: Array, *, rng: np.random.Generator) -> Array:
        return self._problem.propagate(particles, std, rng=rng)

    def log_likelihood(
        self, particles: Array, parts: Sequence[int] | None = None, given: Sequence[int] = ()
    ) -> Array:
        found = self._problem.log_likelihood(particles, parts, given)
        self.layers.append(Layer(particles.copy(), found.sum(axis=1)))
        return found


def layers_from(evidence: FrameEvidence, before: Array, *, rng: np.random.Generator) -> list[Layer]:
    """What the filter does in a frame when it comes from one pose (D,): the particles of every layer, first to last.

    A layer is a question to the likelihood; a filter that goes part by part asks more often. Raises ValueError for a
    filter that needs more of a problem than a likelihood.
    """
    tools, noted = evidence.tools, _Noted(evidence.search)
    settings = tools.filter_settings()
    start = initial_particles(noted, before, settings.n_particles)
    FILTERS[tools.settings.filter.name].step(noted, start, settings, rng=rng)
    return noted.layers
