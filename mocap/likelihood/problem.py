"""The articulated problem of a voxel body in one frame."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mocap.body.flesh import LookUpTable
from mocap.body.model import Body
from mocap.data.problem import StateLayout
from mocap.data.propagation import truncated_gaussian_step
from mocap.likelihood.voxels import (
    PackedVolume,
    VoxelLikelihoodSettings,
    factorised_log_likelihood,
    global_log_likelihood,
    part_scores,
)

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class VoxelProblem:
    """A body against the packed volume of one frame: implements `ArticulatedProblem`."""

    body: Body
    table: LookUpTable
    volume: PackedVolume
    settings: VoxelLikelihoodSettings
    n_threads: int = 1

    @property
    def layout(self) -> StateLayout:
        return self.body.layout

    def propagate(self, particles: Array, std: Array, *, rng: np.random.Generator) -> Array:
        return truncated_gaussian_step(particles, std, self.layout.lower, self.layout.upper, rng=rng)

    def log_likelihood(self, particles: Array) -> Array:
        scores = part_scores(self.body, self.table, self.volume, particles, n_threads=self.n_threads)
        if self.settings.factorised:
            return factorised_log_likelihood(scores, self.body, self.settings)
        return global_log_likelihood(scores, self.table, self.settings)
