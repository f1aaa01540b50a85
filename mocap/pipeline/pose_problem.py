"""What a pose is judged by in one frame: the volume of one person, its problems, and their common evidence."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mocap.body import Body, LookUpTable, load_body_model, scale_body
from mocap.data import VoxelGrid
from mocap.filters import RefineSettings
from mocap.likelihood import (
    PackedVolume,
    SurfaceFitSettings,
    SurfaceProblem,
    VoxelLikelihoodSettings,
    VoxelProblem,
    hull_surface,
)
from mocap.pipeline.config import LikelihoodConfig, PoseConfig
from mocap.volume import surface_map

Array = NDArray[np.float64]

CROP_MARGIN_M = 0.3  # how far beyond the hull particles may meet themselves
MIN_VOXELS = 200  # fewer (1.6 litres at 2 cm) are no body: the pose is carried on instead
# Nats per square metre of mean surface cost: the lost arm of a person, a tenth of the surface, is worth about 7.
NATS_PER_M2 = 90_000.0


@dataclass(frozen=True, eq=False)
class PersonHull:
    """The voxels of one person in one frame.  voxels : (N,) int32 ascending.  is_surface : (N,) bool."""

    voxels: NDArray[np.int32]
    is_surface: NDArray[np.bool_]


HullOf = Callable[[int], PersonHull | None]


def pack_volume(grid: VoxelGrid, hull: PersonHull, surface_sigma_voxels: float) -> PackedVolume:
    """The crop that the likelihood reads, with room for particles around the hull."""
    margin = int(np.ceil(CROP_MARGIN_M / grid.voxel_size_m))
    subs = grid.subscripts(hull.voxels)
    lower = subs.min(axis=0) - margin
    upper = subs.max(axis=0) + margin + 1
    crop = surface_map(hull.voxels, hull.is_surface, grid, lower, upper, surface_sigma_voxels)
    return PackedVolume(crop, lower.astype(np.int64), grid)


@dataclass(frozen=True, eq=False)
class PoseTools:
    """What stays the same for one person over a clip."""

    body: Body
    table: LookUpTable
    grid: VoxelGrid
    fps: float
    pose: PoseConfig
    likelihood: VoxelLikelihoodSettings
    fit: SurfaceFitSettings
    n_threads: int

    @property
    def noise_std(self) -> Array:
        """(D,) standard deviation per frame: half of the largest expected movement (CF 3.2.2)."""
        return 0.5 * self.body.max_speed / self.fps * self.pose.noise_scale

    def refine_settings(self, n_iterations: int = 12) -> RefineSettings:
        """Settings of the refinement, with a weak prior at the filter's estimate."""
        is_position = np.arange(self.body.layout.n_columns) < 3
        return RefineSettings(prior_std=np.where(is_position, 0.1, 0.5), n_iterations=n_iterations)

    def problems(self, hull: PersonHull) -> tuple[VoxelProblem, SurfaceProblem]:
        volume = pack_volume(self.grid, hull, self.pose.surface_sigma_voxels)
        surface = hull_surface(hull.voxels, hull.is_surface, self.grid, volume)
        return (
            VoxelProblem(self.body, self.table, volume, self.likelihood, n_threads=self.n_threads),
            SurfaceProblem(self.body, self.table, surface, self.fit),
        )


def make_tools(
    grid: VoxelGrid,
    fps: float,
    height_m: float,
    body_model: str,
    pose: PoseConfig,
    likelihood: LikelihoodConfig,
    n_threads: int,
) -> PoseTools:
    """Body, look-up table and settings of one person."""
    from mocap.body import build_look_up_table

    body = scale_body(load_body_model(body_model), height_m)
    return PoseTools(
        body=body,
        table=build_look_up_table(body, grid.voxel_size_m * pose.table_density),
        grid=grid,
        fps=fps,
        pose=pose,
        likelihood=likelihood_settings(likelihood),
        fit=SurfaceFitSettings(),
        n_threads=n_threads,
    )


def likelihood_settings(config: LikelihoodConfig) -> VoxelLikelihoodSettings:
    """The likelihood's settings from its configuration section."""
    return VoxelLikelihoodSettings(
        variance_out=config.variance_out,
        variance_double=config.variance_double,
        variance_empty=config.variance_empty,
        variance_surface=config.variance_surface,
        factorised=config.factorised,
    )


def evidence(problem: VoxelProblem, surface: SurfaceProblem, states: Sequence[Array]) -> Array:
    """How well states explain the hull, (K,): the likelihood asks whether the body lies in the hull, the surface
    whether the hull is explained by the body. In nats.
    """
    inside = problem.log_likelihood(np.stack(states)).sum(axis=1)
    return inside - surface_nats(surface, states)


def surface_nats(surface: SurfaceProblem, states: Sequence[Array]) -> Array:
    """The surface cost of states in nats, (K,), whatever the number of hull points."""
    cost = np.array([surface.normal_equations(s)[0] for s in states])
    return NATS_PER_M2 * cost / max(surface.n_points, 1)


def is_usable(hull: PersonHull | None) -> bool:
    return hull is not None and len(hull.voxels) >= MIN_VOXELS
