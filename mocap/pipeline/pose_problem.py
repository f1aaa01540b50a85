"""What a pose is judged by in one frame: the volume of one person, its problems, and their common evidence."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from mocap.body import Body, LookUpTable, load_body_model, scale_body
from mocap.data import VoxelGrid
from mocap.filters.refine import RefineSettings
from mocap.likelihood.colours import Appearance, ColourProblem, PixelRays
from mocap.likelihood.residuals import (
    BodyFit,
    HullSurface,
    OutlineFitSettings,
    OutlineProblem,
    Outlines,
    SurfaceFitSettings,
    SurfaceProblem,
    hull_surface,
)
from mocap.likelihood.voxels import PackedVolume, VoxelLikelihoodSettings, VoxelProblem
from mocap.pipeline.config import LikelihoodConfig, PoseConfig
from mocap.pipeline.posture import Posture, usual_posture
from mocap.threads import in_parallel
from mocap.volume import surface_map

Array = NDArray[np.float64]

CROP_MARGIN_M = 0.3  # how far beyond the hull particles may meet themselves
MIN_VOXELS = 200  # fewer (1.6 litres at 2 cm) are no body: the pose is carried on instead
# Nats per square metre of mean surface cost: the lost arm of a person, a tenth of the surface, is worth about 7.
NATS_PER_M2 = 90_000.0


@dataclass(frozen=True, eq=False)
class PersonHull:
    """The voxels of one person in one frame.  voxels : (N,) int32 ascending.  is_surface : (N,) bool.

    outlines : makes the person's outlines in the cameras, or None where there are no masks.
    rays : makes the rays through the person's pixels, or None where there are no pictures.
    """

    voxels: NDArray[np.int32]
    is_surface: NDArray[np.bool_]
    outlines: Callable[[], Outlines] | None = None
    rays: Callable[[], PixelRays] | None = None


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
class PreparedHull:
    """A hull with all that is made of it before a pose is looked for."""

    hull: PersonHull
    volume: PackedVolume
    surface: HullSurface
    outlines: Outlines | None
    rays: PixelRays | None


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
    outline_fit: OutlineFitSettings
    n_threads: int

    @property
    def noise_std(self) -> Array:
        """(D,) standard deviation per frame: half of the largest expected movement (CF 3.2.2)."""
        return 0.5 * self.body.max_speed / self.fps * self.pose.noise_scale

    def refine_settings(self, n_iterations: int = 12) -> RefineSettings:
        """Settings of the refinement, with a weak prior at the filter's estimate."""
        is_position = np.arange(self.body.layout.n_columns) < 3
        return RefineSettings(prior_std=np.where(is_position, 0.1, 0.5), n_iterations=n_iterations)

    def prepared(self, hull: PersonHull) -> PreparedHull:
        """What of a frame depends on nothing but its hull."""
        volume = pack_volume(self.grid, hull, self.pose.surface_sigma_voxels)
        surface = hull_surface(hull.voxels, hull.is_surface, self.grid, volume)
        with_outlines = hull.outlines is not None and self.pose.outline_weight > 0
        outlines = hull.outlines() if hull.outlines is not None and with_outlines else None
        with_colours = hull.rays is not None and self.pose.colour_weight > 0
        rays = hull.rays() if hull.rays is not None and with_colours else None
        return PreparedHull(hull, volume, surface, outlines, rays)

    def frame(self, hull: PersonHull | PreparedHull, appearance: Appearance | None = None) -> FrameProblem:
        """What poses are judged by in the frame of a hull.  appearance : what is known of the person's colours."""
        known = hull if isinstance(hull, PreparedHull) else self.prepared(hull)
        exact = replace(self.likelihood, kind="exact")
        return FrameProblem(
            tools=self,
            voxels=VoxelProblem(self.body, self.table, known.volume, exact, n_threads=self.n_threads),
            surface=SurfaceProblem(self.body, self.table, known.surface, self.fit),
            outlines=None
            if known.outlines is None
            else OutlineProblem(self.body, self.table, known.outlines, self.outline_fit),
            colours=None
            if known.rays is None or appearance is None
            else ColourProblem(self.body, known.rays, appearance),
        )


@dataclass(frozen=True, eq=False)
class FrameProblem:
    """One person in one frame: the likelihood, which asks whether the body lies in the hull, and the residuals, which
    ask whether hull and outlines are explained by the body.
    """

    tools: PoseTools
    voxels: VoxelProblem
    surface: SurfaceProblem
    outlines: OutlineProblem | None
    colours: ColourProblem | None = None

    @cached_property
    def search(self) -> VoxelProblem:
        """The likelihood that proposes poses, of the kind that is configured; `voxels` judges them, always exact."""
        return replace(self.voxels, settings=self.tools.likelihood)

    @cached_property
    def posture(self) -> Posture:
        """Where limbs usually point."""
        return usual_posture(self.tools.body)

    @cached_property
    def fit(self) -> BodyFit:
        """The residuals of hull surface and outlines together, per hull point."""
        pose = self.tools.pose
        n_outline = self.outlines.n_points if self.outlines is not None else 0
        share = self.surface.n_points / n_outline if n_outline else 0.0
        weights = pose.surface_weight, pose.outline_weight * share
        return BodyFit(self.surface, self.outlines, *weights, 1.0 / NATS_PER_M2)

    @cached_property
    def coarse(self) -> FrameProblem:
        """The same with fewer hull points, without outlines and colours, for brief attempts."""
        settings = replace(self.tools.fit, n_hull_points=400, n_flesh_points=150)
        surface = SurfaceProblem(self.surface.body, self.surface.table, self.surface.hull, settings)
        return replace(self, surface=surface, outlines=None, colours=None)

    def log_likelihood(self, states: Sequence[Array] | Array) -> Array:
        """Log-likelihood of K states, (K,)."""
        return self.voxels.log_likelihood(np.stack(list(states))).sum(axis=1)

    def misfit(self, states: Sequence[Array] | Array) -> Array:
        """What the likelihood does not ask of K states, (K,) nats: the residuals' cost, that of an unusual
        posture, less what the colours say."""
        nats = np.array(in_parallel(self._misfit_of, list(states), self.tools.n_threads))
        if self.tools.pose.posture_nats > 0:
            nats += self.tools.pose.posture_nats * self.posture.departure(np.stack(list(states)))
        return nats

    def _misfit_of(self, state: Array) -> float:
        nats = NATS_PER_M2 * self.fit.normal_equations(state)[0] / max(self.surface.n_points, 1)
        if self.colours is not None:
            nats -= self.tools.pose.colour_weight * float(self.colours.log_ratio(state[None])[0])
        return nats

    def evidence(self, states: Sequence[Array] | Array) -> Array:
        """How well K states explain the frame, (K,), nats."""
        return self.log_likelihood(states) - self.misfit(states)

    def refined(self, state: Array, n_iterations: int = 12) -> Array:
        """A state (D,) moved to a nearby minimum of the residuals."""
        return self.all_refined([state], n_iterations)[0]

    def all_refined(self, states: Sequence[Array], n_iterations: int = 12) -> list[Array]:
        """Each of several states (D,) moved to a nearby minimum of the residuals."""
        if not len(states):
            return []
        settings = self.tools.refine_settings(n_iterations)
        return list(
            self.fit.descended(
                np.stack(list(states)),
                prior_std=settings.prior_std,
                residual_std_m=settings.residual_std_m,
                n_iterations=settings.n_iterations,
                tolerance=settings.tolerance,
                n_threads=self.tools.n_threads,
            )
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
        outline_fit=OutlineFitSettings(),
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
        kind=config.kind,
        n_points=config.n_points,
    )


def is_usable(hull: PersonHull | None) -> bool:
    return hull is not None and len(hull.voxels) >= MIN_VOXELS
