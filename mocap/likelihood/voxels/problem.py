"""The articulated problem of a voxel body in one frame."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from mocap.arrays import Array
from mocap.body.flesh import LookUpTable
from mocap.body.kinematics import cones_of_particles, cones_on
from mocap.body.model import Body
from mocap.data.problem import StateLayout
from mocap.data.propagation import truncated_gaussian_step
from mocap.likelihood.voxels._exact_kernels import MAX_LIMB_PARTS, axes_in_volume
from mocap.likelihood.voxels.device import device_part_scores
from mocap.likelihood.voxels.exact import (
    PackedVolume,
    PartScores,
    VoxelLikelihoodSettings,
    factorised_log_likelihood,
    global_log_likelihood,
    held_body,
    part_scores,
)
from mocap.likelihood.voxels.fast import fast_part_scores


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

    def log_likelihood(
        self, particles: Array, parts: Sequence[int] | None = None, given: Sequence[int] = ()
    ) -> Array:
        """Log-likelihoods of particles (N, D): one column per part asked for (all for None), or one for a global
        likelihood, pooled over these parts.  given : parts that take up room but are not scored."""
        n_points = self.settings.n_points if self.settings.kind == "fast" else None
        return self.judged(self._scores(particles, parts, given, n_points), parts)

    def _scores(
        self,
        particles: Array,
        parts: Sequence[int] | None,
        given: Sequence[int] = (),
        n_points: int | None = None,
    ) -> PartScores:
        """Scores of particles (N, D) by whom they are to be made.  n_points : of the fast kind, None = exact."""
        args = self.body, self.table, self.volume, particles
        if self.settings.device == "cuda":
            return device_part_scores(*args, n_points=n_points, parts=parts, given=given)
        if n_points is None:
            return part_scores(*args, parts=parts, given=given, n_threads=self.n_threads)
        return fast_part_scores(*args, n_points=n_points, parts=parts, given=given, n_threads=self.n_threads)

    def judged(self, scores: PartScores, parts: Sequence[int] | None = None) -> Array:
        """The log-likelihoods of particles with these scores.  parts : those of the scores' columns, None = all."""
        if self.settings.factorised:
            return factorised_log_likelihood(scores, self.body, self.settings, parts)
        return global_log_likelihood(scores, self.table, self.settings, parts)

    def limb_log_likelihood(self, held: Array, limb: Sequence[int]) -> Callable[[Array], Array]:
        """Log-likelihood (N,) of a limb's parts for particles (N, D) that differ in them from the state held (D,):
        the sum of `log_likelihood` with the other parts given, at the limb's price. Always exact: a limb is cheap."""
        if not self.settings.factorised or len(limb) > MAX_LIMB_PARTS:
            rest = [p for p in range(self.layout.n_parts) if p not in limb]
            return lambda particles: self.log_likelihood(particles, limb, rest).sum(axis=1)
        fixed = held_body(self.body, self.table, self.volume, held, limb)
        return lambda particles: factorised_log_likelihood(
            fixed.scores(particles), self.body, self.settings, limb
        ).sum(axis=1)

    def limb_in_data(self, particles: Array, limb: Sequence[int]) -> Array:
        """Share of the points in the middle and at the end of a limb's cones that lie in occupied voxels, of particles
        (N, D): (N,)."""
        start, end = cones_of_particles(self.body, particles, cones_on(self.body, limb))
        share = np.empty(len(particles))
        axes_in_volume(
            start, end, self.volume.crop, self.volume.lower_m, float(self.volume.grid.voxel_size_m), share
        )
        return share

    def occupancy(self, particles: Array, parts: Sequence[int] | None = None, *, own: bool = False) -> Array:
        """Share of flesh in occupied voxels, of particles (N, D): (N, P'), one column per part asked for.

        own : without what lies in voxels of another part as well, at least 0; all of that counts as occupied, which
        it nearly always is.
        Source: CF Eq. 6.15.
        """
        scores = self._scores(particles, parts)
        return np.maximum(scores.occupied - scores.double, 0.0) if own else scores.occupied
