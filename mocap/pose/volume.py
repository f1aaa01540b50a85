"""Volumes as evidence: the hull of one person in one frame, its outlines and colours, and what they say of a pose."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, field, replace
from functools import cached_property, partial

import numpy as np
from numpy.typing import NDArray

from mocap.arrays import Image
from mocap.body import (
    Body,
    LookUpTable,
    build_look_up_table,
    head_top,
    height_from_tops,
    is_upright,
    joint_transforms,
    landmarks_of,
    lowest_of,
)
from mocap.body.initial import HeightEstimate
from mocap.body.stretch import resize_body
from mocap.data import LANDMARKS, VoxelGrid
from mocap.data.problem import ResidualProblem, limbs_of
from mocap.filters.refine import RefineSettings, refine
from mocap.filters.scout import Bonus
from mocap.likelihood.colours import Appearance, ColourProblem, PixelRays, new_appearance
from mocap.likelihood.residuals import (
    BodyFit,
    Crops,
    HullSurface,
    OutlineFitSettings,
    OutlineProblem,
    Outlines,
    SurfaceFitSettings,
    SurfaceProblem,
    hull_surface,
)
from mocap.likelihood.residuals.total import SumProblem
from mocap.likelihood.voxels import (
    PackedVolume,
    PartScores,
    VoxelLikelihoodSettings,
    VoxelProblem,
    part_scores,
)
from mocap.pose.deviation import fit_information
from mocap.pose.evidence import FrameEvidence, FrameFit, PersonTools
from mocap.pose.limbs import legs_of
from mocap.pose.method import EvidenceSettings, StartSettings
from mocap.pose.posture import Posture, usual_posture
from mocap.pose.settings import PoseSettings
from mocap.profiling import part
from mocap.threads import in_parallel
from mocap.volume import surface_map
from mocap.volume.surface import (
    OCCUPIED_BIT,
    SURFACE_LEVELS,
    bounds_within,
    fill_beyond,
    mark_unknown,
    subscripts_and_bounds,
)

Array = NDArray[np.float64]

_HALF_SURFACE = (SURFACE_LEVELS + 1) // 2
# A hull that begins higher above the floor is of somebody in the air, or its feet are hidden: those of walks begin at
# up to 7 cm. Frames that reach the floor tell the height where they are so large a share; they are 83 % of `jump`.
_IN_THE_AIR_M, _LEAST_DOWN = 0.08, 0.2


@dataclass(frozen=True, eq=False)
class PersonHull:
    """The voxels of one person in one frame.  voxels : (N,) int32 ascending.  is_surface : (N,) bool.

    outlines : makes the person's outlines in the cameras, or None where there are no masks.
    rays : makes the rays through the person's pixels, or None where there are no pictures.
    crops : makes what cameras show around the person of their pictures of the frame, or None.
    unknown : (U,) int32 ascending, voxels around the person that too few cameras can judge.  n_judges : how many
    cameras can judge points (N, 3) m, (N,), or None when nothing is known of cameras.  is_among_things : something is
    known to hide people.  measured : (N, 3) m, where depth maps have measured the surface of each voxel, NaN = nowhere;
    None without depth maps.
    """

    voxels: NDArray[np.int32]
    is_surface: NDArray[np.bool_]
    outlines: Callable[[], Outlines] | None = None
    rays: Callable[[], PixelRays] | None = None
    crops: Callable[[Sequence[Image]], Crops] | None = None
    unknown: NDArray[np.int32] = field(default_factory=lambda: np.zeros(0, dtype=np.int32))
    n_judges: Callable[[Array], NDArray[np.int64]] | None = None
    is_among_things: bool = False
    measured: NDArray[np.float32] | None = None

    def holds(self, voxels: NDArray[np.int32]) -> NDArray[np.bool_]:
        """Whether voxels of the grid (N,) are in the hull, (N,); one outside the grid, -1, is not."""
        at = np.minimum(np.searchsorted(self.voxels, voxels), len(self.voxels) - 1)
        return np.asarray(self.voxels[at] == voxels)


HullOf = Callable[[int], PersonHull | None]

# Ascending frames -> each of them with the pictures of all cameras.
PicturesOf = Callable[[Sequence[int]], AbstractContextManager[Iterable[tuple[int, Sequence[Image]]]]]


def pack_volume(
    grid: VoxelGrid,
    hull: PersonHull,
    surface_sigma_voxels: float,
    margin_m: float = EvidenceSettings.crop_margin_m,
) -> PackedVolume:
    """The crop that the likelihood reads, with room for particles around the hull and for hidden limbs in the unknown.

    An unknown voxel may be flesh or air, surface or none: a body part may lie there as in a hull, and is not drawn in.
    Of who reaches through the walls or the ceiling of the grid the rest is unknown.
    """
    margin = int(np.ceil(margin_m / grid.voxel_size_m))
    _, first, last = subscripts_and_bounds(hull.voxels, grid)
    unknown, _, _ = subscripts_and_bounds(hull.unknown, grid)
    lower, upper = first - margin, last + margin
    reach = int(np.ceil(EvidenceSettings.hidden_reach_m / grid.voxel_size_m))
    near = bounds_within(unknown, first - reach, last - 1 + reach)
    if near is not None:
        lower, upper = np.minimum(lower, near[0] - 1), np.maximum(upper, near[1] + 1)
    beyond = reach * np.stack([first == 0, last == np.array(grid.shape)])
    beyond[0, 2] = 0  # under the floor there is nothing
    lower, upper = np.minimum(lower, first - beyond[0]), np.maximum(upper, last + beyond[1])
    crop = surface_map(hull.voxels, hull.is_surface, grid, lower, upper, surface_sigma_voxels)
    mark_unknown(crop, lower, unknown, OCCUPIED_BIT | _HALF_SURFACE)
    if beyond.any():
        fill_beyond(crop[1:-1, 1:-1, 1:-1], lower + 1, grid, OCCUPIED_BIT | _HALF_SURFACE)
    return PackedVolume(crop, lower, grid, beyond)


@dataclass(frozen=True, eq=False)
class PreparedHull:
    """A hull with all that is made of it before a pose is looked for."""

    hull: PersonHull
    volume: PackedVolume
    surface: HullSurface
    outlines: Outlines | None
    rays: PixelRays | None


@dataclass(frozen=True, eq=False)
class VolumeTools(PersonTools):
    """What stays the same for one person over a clip of volumes."""

    table: LookUpTable
    grid: VoxelGrid
    likelihood: VoxelLikelihoodSettings
    surface_fit: SurfaceFitSettings
    outline_fit: OutlineFitSettings

    @property
    def is_searched(self) -> NDArray[np.bool_]:
        """(D,) what searches draw: not how feet and hands turn, which refinements set where there are any."""
        return ~(self.body.is_fine & self.settings.refine)

    @property
    def prior_std(self) -> Array:
        """(D,) how far a refinement may be expected to move, m and rad: its weak prior."""
        numbers = self.settings.method.evidence
        return np.where(self.body.is_position, numbers.refine_std_m, numbers.refine_std_rad)

    @cached_property
    def flesh_of_landmarks(self) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float32]]:
        """The flesh of landmarks: whose it is (K,), and its points (K, 3) m in the frame of their joint (K,).

        It is what lies around them in the rest pose, where limbs are apart. A foot's and a hand's is all that is on
        their joint, since their landmarks lie on the skin, and theirs alone: an ankle shows without the foot.
        """
        body, table = self.body, self.table
        rest = np.zeros((1, body.layout.n_columns))
        R, t = joint_transforms(body, rest)
        joint = np.repeat(table.joint, np.diff(table.start))
        flesh = np.einsum("nij,nj->ni", R[0, joint], table.points) + t[0, joint]
        marks = landmarks_of(body, rest)[0]
        near = max(self.settings.method.evidence.observed_near * body.height_m, table.spacing_m)
        is_own = np.linalg.norm(marks[:, None] - flesh, axis=2) < near
        is_further = np.arange(len(marks)) >= len(LANDMARKS)
        is_own[is_further] = joint == body.landmark_joint[is_further, None]
        is_own[~is_further] &= ~is_own[is_further].any(axis=0)
        landmark, point = np.nonzero(is_own)
        return landmark, joint[point], table.points[point]

    def refining(self, n_iterations: int | None = None) -> RefineSettings:
        """How poses are refined.  n_iterations : None = as many as usual."""
        numbers = self.settings.method.evidence
        n = numbers.refine_iterations if n_iterations is None else n_iterations
        return RefineSettings(self.prior_std, n_iterations=n, reach=numbers.refine_reach)

    def prepared(self, hull: PersonHull) -> PreparedHull:
        """What of a frame depends on nothing but its hull."""
        settings = self.settings
        margin_m = settings.method.evidence.crop_margin_m
        with part("volume and surface"):
            volume = pack_volume(self.grid, hull, settings.surface_sigma_voxels, margin_m)
            surface = hull_surface(hull.voxels, hull.is_surface, self.grid, volume)
            if hull.measured is not None:
                surface = surface.at(hull.measured[hull.is_surface], self.surface_fit.measured_weight)
        with_outlines = hull.outlines is not None and settings.outline_weight > 0
        with part("outlines"):
            outlines = hull.outlines() if hull.outlines is not None and with_outlines else None
        with_colours = hull.rays is not None and settings.colour_weight > 0
        with part("colours"):
            rays = hull.rays() if hull.rays is not None and with_colours else None
        return PreparedHull(hull, volume, surface, outlines, rays)

    def frame(self, hull: PersonHull | PreparedHull, appearance: Appearance | None = None) -> VolumeEvidence:
        """What poses are judged by in the frame of a hull.  appearance : what is known of the person's colours."""
        known = hull if isinstance(hull, PreparedHull) else self.prepared(hull)
        exact = replace(self.likelihood, kind="exact", device="cpu")
        return VolumeEvidence(
            tools=self,
            hull=known,
            voxels=VoxelProblem(self.body, self.table, known.volume, exact, n_threads=self.n_threads),
            surface=SurfaceProblem(self.body, self.table, known.surface, self.surface_fit),
            outlines=None
            if known.outlines is None
            else OutlineProblem(self.body, self.table, known.outlines, self.outline_fit),
            colours=None
            if known.rays is None or appearance is None
            else ColourProblem(self.body, known.rays, appearance),
        )

    def resized(self, factor: float, radii: float | Array | None = None) -> VolumeTools:
        """The tools with a body of another size.  radii : their factor, or one of each kind of segment, (G,); None = as
        the lengths."""
        return self.with_body(resize_body(self.body, factor, factor if radii is None else radii))

    @property
    def without_floor(self) -> VolumeTools:
        """The tools for a floor that has no say."""
        return replace(self, surface_fit=replace(self.surface_fit, floor_gain=0.0))

    def with_body(self, body: Body) -> VolumeTools:
        """The tools with another body."""
        table = build_look_up_table(body, self.grid.voxel_size_m * self.settings.table_density)
        return replace(self, body=body, table=table)


@dataclass(frozen=True, eq=False)
class VolumeEvidence:
    """One person in one frame of volumes: the likelihood, which asks whether the body lies in the hull, and the
    residuals, which ask whether hull and outlines are explained by the body. Implements `WholeBodyEvidence`.
    """

    tools: VolumeTools
    hull: PreparedHull
    voxels: VoxelProblem
    surface: SurfaceProblem
    outlines: OutlineProblem | None
    colours: ColourProblem | None = None

    @cached_property
    def search(self) -> VoxelProblem:
        """The likelihood that proposes poses, of the kind and on the device that are configured; `voxels` judges them,
        always exact and on the CPU."""
        return replace(self.voxels, settings=self.tools.likelihood)

    @property
    def n_cameras(self) -> int:
        """Cameras with a silhouette of the person; 0 where silhouettes are not looked at."""
        return 0 if self.outlines is None else self.outlines.outlines.n_cameras

    @property
    def grain_m(self) -> float:
        """Half a voxel."""
        return 0.5 * self.tools.grid.voxel_size_m

    @cached_property
    def places(self) -> Array:
        """Centres (N, 3) m of the person's voxels."""
        return self.tools.grid.centers(self.hull.hull.voxels)

    @cached_property
    def posture(self) -> Posture:
        """Where limbs usually point."""
        return usual_posture(self.tools.body)

    @cached_property
    def residuals(self) -> BodyFit:
        """The residuals of hull surface and outlines together, per hull point."""
        settings = self.tools.settings
        n_outline = self.outlines.n_points if self.outlines is not None else 0
        share = self.surface.n_points / n_outline if n_outline else 0.0
        weights = settings.surface_weight, settings.outline_weight * share
        return BodyFit(
            self.surface,
            self.outlines,
            *weights,
            1.0 / settings.method.evidence.nats_per_m2,
            self._usual_std if self.hides_legs else None,
        )

    @cached_property
    def hides_legs(self) -> bool:
        """Whether the hull of somebody upright ends above the floor, and what is below is unknown: legs, unseen.

        Who sits has bent legs, and of those nothing is known.
        """
        own, grid = self.hull.hull, self.tools.grid
        if not len(own.unknown) or not len(own.voxels):
            return False
        numbers, height = self.tools.settings.method.evidence, grid.centers(own.voxels)[:, 2]
        is_upright = height.max() > numbers.upright_share * self.tools.body.height_m
        return bool(is_upright and height.min() > numbers.cut_off_m)

    @property
    def _usual_std(self) -> Array:
        """How far angles usually are from 0, (D,): unseen legs carry the body and do not hide in the hull."""
        body = self.tools.body
        usual, legs = body.usual_std.copy(), legs_of(body)
        if legs is not None:
            columns = np.concatenate([leg.columns for leg in legs])
            usual[columns] = np.minimum(
                usual[columns], self.tools.settings.method.evidence.hidden_leg_std_rad
            )
        return usual

    @property
    def weighted_residuals(self) -> tuple[tuple[float, ResidualProblem], ...]:
        """All that a refinement descends on, in units of the volume's residuals, m^2 summed over the hull's points."""
        return ((1.0, self.residuals),)

    @property
    def m2_per_nat(self) -> float:
        """What a nat of other evidence weighs among the volume's residuals."""
        return max(self.surface.n_points, 1) / self.tools.settings.method.evidence.nats_per_m2

    @cached_property
    def coarse(self) -> VolumeEvidence:
        """The same with fewer hull points, without outlines and colours, for brief attempts."""
        numbers = self.tools.settings.method.evidence
        settings = replace(
            self.tools.surface_fit,
            n_hull_points=numbers.coarse_hull_points,
            n_flesh_points=numbers.coarse_flesh_points,
        )
        surface = SurfaceProblem(self.surface.body, self.surface.table, self.surface.hull, settings)
        return replace(self, surface=surface, outlines=None, colours=None)

    @property
    def on_one_thread(self) -> VolumeEvidence:
        """The same for a caller that is one of several threads."""
        tools = replace(self.tools, n_threads=1)
        return replace(self, tools=tools, voxels=replace(self.voxels, n_threads=1))

    def with_tools(self, tools: VolumeTools) -> VolumeEvidence:
        """The same frame judged by other tools, another body for instance, without colours."""
        body, table = tools.body, tools.table
        old = self.voxels
        return VolumeEvidence(
            tools=tools,
            hull=self.hull,
            voxels=VoxelProblem(body, table, old.volume, old.settings, n_threads=old.n_threads),
            surface=SurfaceProblem(body, table, self.surface.hull, tools.surface_fit),
            outlines=None
            if self.outlines is None
            else OutlineProblem(body, table, self.outlines.outlines, tools.outline_fit),
        )

    def log_likelihood(self, states: Sequence[Array] | Array) -> Array:
        """Log-likelihood of K states, (K,)."""
        return self.voxels.log_likelihood(np.stack(list(states))).sum(axis=1)

    def misfit(self, states: Sequence[Array] | Array) -> Array:
        """What the likelihood does not ask of K states, (K,) nats: the residuals' cost, that of an unusual
        posture, less what the colours say."""
        settings = self.tools.settings
        nats = np.array(in_parallel(self._misfit_of, list(states), self.tools.n_threads))
        if settings.posture_nats > 0:
            nats += settings.posture_nats * self.posture.departure(np.stack(list(states)))
        return nats

    def _misfit_of(self, state: Array) -> float:
        settings = self.tools.settings
        per_m2 = settings.method.evidence.nats_per_m2
        nats = per_m2 * self._normal_equations(state)[0] / max(self.surface.n_points, 1)
        if self.colours is not None:
            nats -= settings.colour_weight * float(self.colours.log_ratio(state[None])[0])
        return nats

    def evidence(self, states: Sequence[Array] | Array) -> Array:
        """How well K states explain the frame, (K,), nats."""
        return self.log_likelihood(states) - self.misfit(states)

    def refined(self, state: Array, n_iterations: int | None = None) -> Array:
        """A state (D,) moved to a nearby minimum of the residuals."""
        return self.all_refined([state], n_iterations)[0]

    def all_refined(self, states: Sequence[Array], n_iterations: int | None = None) -> list[Array]:
        """Each of several states (D,) moved to a nearby minimum of the residuals, with a weak prior at itself."""
        if not len(states):
            return []
        settings = self.tools.refining(n_iterations)
        return list(
            self.residuals.descended(
                np.stack(list(states)),
                prior_std=settings.prior_std,
                residual_std_m=settings.residual_std_m,
                n_iterations=settings.n_iterations,
                tolerance=settings.tolerance,
                reach=settings.reach,
                n_threads=self.tools.n_threads,
            )
        )

    def refined_with(self, state: Array, other: ResidualProblem) -> Array:
        """A state (D,) moved to a nearby minimum of the residuals and of another cost, nats."""
        both = SumProblem((*self.weighted_residuals, (self.m2_per_nat, other)))
        return refine(both, state, self.tools.refining())[0]

    def unexplained_share(self, state: Array) -> float:
        """Share of the hull's surface that lies far from the body."""
        return self.surface.unexplained_share(state, self.tools.settings.method.evidence.unexplained_m)

    def is_crowded(self, state: Array) -> bool:
        """Whether hull and silhouettes hold much else than the body, a chair perhaps."""
        method = self.tools.settings.method
        if self.unexplained_share(state) <= method.start.crowded_share:
            return False
        if self.outlines is None:
            return True
        beside = self.outlines.unexplained_share(state, method.evidence.unexplained_m)
        return beside > method.start.crowded_outline_share

    def limb_misfits(self, state: Array) -> dict[int, float]:
        """How badly each limb fits, by its first part: nats >= 0, of its worst part."""
        layout = self.tools.body.layout
        per_part = self.voxels.judged(self.part_scores(state))[0]
        if len(per_part) != layout.n_parts:
            return {}
        return {limb[0]: max(-float(per_part[limb].min()), 0.0) for limb in limbs_of(layout)}

    def limb_terms(self, state: Array) -> list[Bonus]:
        """What of the hull is unexplained, what the colours say and what is usual."""
        settings = self.tools.settings
        search = settings.method.limb_search
        terms: list[Bonus] = []
        lost = self.surface.unexplained(state, settings.method.evidence.unexplained_m)
        if len(lost) > search.unexplained_share * self.surface.n_points:
            most = round(search.most_unexplained_share * self.surface.n_points)
            terms.append(partial(self._explained_nats, lost[:most]))
        if self.colours is not None:
            terms.append(_ColourNats(self.colours, settings.colour_weight, search.pixel_stride, state))
        if settings.posture_nats > 0:
            terms.append(partial(self._posture_nats, float(self.posture.departure(state[None])[0])))
        return terms

    def _explained_nats(self, lost: Array, particles: Array, limb: list[int]) -> Array:
        """Evidence of the lost hull points (U, 3) that a limb of each particle would explain, (N,)."""
        method = self.tools.settings.method
        some = lost[:: max(1, len(lost) // method.limb_search.n_lost_points)]
        # A lost point costs the surface term its robust limit, scale^2 / 2. The search overstates it: what it finds is
        # judged by the evidence itself.
        per_share = (
            method.limb_search.zeal * method.evidence.nats_per_m2 * 0.5 * self.surface.settings.scale_m**2
        )
        lost_share = len(lost) / self.surface.n_points
        near_m = method.evidence.unexplained_m
        return per_share * lost_share * self.surface.explained_share(some, particles, limb, near_m)

    def _posture_nats(self, departure: float, particles: Array, limb: list[int]) -> Array:
        """What the posture of each particle speaks for it, (N,), against that of the state they were made from."""
        return self.tools.settings.posture_nats * (departure - self.posture.departure(particles))

    def fit(self, state: Array, kept_parts: NDArray[np.bool_] | None = None) -> FrameFit:
        """How a state (D,) fits; a landmark is observed when the part at its joint lies in occupied voxels, and its
        own flesh, the filter has not lost it and enough cameras can judge it."""
        body = self.tools.body
        layout = body.layout
        scores = self.part_scores(state)
        per_part = self.voxels.judged(scores)[0]
        information = np.zeros((layout.n_columns, layout.n_columns))
        if self.tools.settings.refine:
            cost, normal_matrix = self._normal_equations(state)
            correlated = self.tools.settings.method.deviation.correlated
            information = fit_information(cost, normal_matrix, self.surface.n_points, correlated)
        # A global likelihood says nothing of parts: its misfit is shared out.
        shared = np.broadcast_to(per_part / (layout.n_parts / len(per_part)), layout.n_parts)
        parts = body.landmark_parts
        occupancy = scores.occupied[0]
        unseen_std = self._unseen_std(state)
        judged = self._judged(state) & ~self._shared_legs(scores) & (unseen_std == 0.0)
        least = self.tools.settings.method.evidence.observed_occupancy
        observed = judged & (occupancy[parts] >= least) & (self._occupancy_of_landmarks(state) >= least)
        return FrameFit(
            information=information,
            misfit=np.maximum(-shared, 0.0),
            unexplained=self.unexplained_share(state),
            log_likelihood=float(per_part.sum()),
            observed=observed if kept_parts is None else observed & kept_parts[parts],
            judged=judged,
            unseen_std=unseen_std,
        )

    def _occupancy_of_landmarks(self, state: Array) -> Array:
        """Share of the flesh of every landmark that lies in the hull, (M,); 1 where the body has none.

        A part may be seen without its end: an ankle is the end of a shank, and a foot a piece of it.
        """
        landmark, joint, points = self.tools.flesh_of_landmarks
        R, t = joint_transforms(self.tools.body, state[None])
        places = np.einsum("nij,nj->ni", R[0, joint], points) + t[0, joint]
        is_in = self.hull.hull.holds(self.tools.grid.voxels_of(places))
        n = np.bincount(landmark, minlength=len(self.tools.body.landmarks))
        found = np.bincount(landmark, weights=is_in, minlength=len(n))
        return np.where(n > 0, found / np.maximum(n, 1), 1.0)

    def _judged(self, state: Array) -> NDArray[np.bool_]:
        """Whether enough cameras can judge each landmark of a state (D,), (M,): none where nothing is carved."""
        landmarks = landmarks_of(self.tools.body, state[None])[0]
        is_carved = self.tools.grid.is_below_ceiling(landmarks)
        n_judges = self.hull.hull.n_judges
        if n_judges is None:
            return is_carved
        return is_carved & (n_judges(landmarks) >= self.tools.settings.method.evidence.min_judges)

    def _unseen_std(self, state: Array) -> Array:
        """What landmarks of legs that nothing shows may be off, (M,) m: their distance from the hip times an angle."""
        body = self.tools.body
        std = np.zeros(len(body.landmarks))
        legs = legs_of(body) if self.hides_legs else None
        if legs is not None:
            places = landmarks_of(body, state[None])[0]
            for side, leg in zip(("left", "right"), legs, strict=True):
                arms = places[leg.landmarks] - places[body.landmarks.index(f"{side}_hip")]
                angle = self.tools.settings.method.evidence.hidden_leg_std_rad
                std[leg.landmarks] = angle * np.linalg.norm(arms, axis=1)
        return std

    def _shared_legs(self, scores: PartScores) -> NDArray[np.bool_]:
        """Landmarks of legs, (M,), that lie in each other: among furniture one of them is seen and both are taken for
        it."""
        body = self.tools.body
        is_shared = np.zeros(len(body.landmarks), dtype=np.bool_)
        legs = legs_of(body) if self.hull.hull.is_among_things else None
        if legs is not None:
            own = np.concatenate([leg.landmarks for leg in legs])
            share = self.tools.settings.method.evidence.shared_leg
            is_shared[own] = scores.double[0][body.landmark_parts[own]] > share
        return is_shared

    def part_scores(self, state: Array) -> PartScores:
        """Shares of every part's flesh of one state (D,)."""
        key = state.tobytes()
        if key not in self._scores:
            volume = self.voxels.volume
            self._scores[key] = part_scores(self.tools.body, self.tools.table, volume, state[None])
        return self._scores[key]

    def _normal_equations(self, state: Array) -> tuple[float, Array]:
        """Cost and Gauss-Newton matrix of the residuals at a state (D,)."""
        key = state.tobytes()
        if key not in self._costs:
            self._costs[key] = self.residuals.normal_equations(state)[:2]
        return self._costs[key]

    # A frame's pose is asked about again by whoever judges it: by its bytes, what was found of it.
    @cached_property
    def _scores(self) -> dict[bytes, PartScores]:
        return {}

    @cached_property
    def _costs(self) -> dict[bytes, tuple[float, Array]]:
        return {}


@dataclass
class _ColourNats:
    """What the colours say for a limb of each particle, (N,), against the state (D,) they were made from."""

    colours: ColourProblem
    weight: float
    pixel_stride: int
    state: Array
    _of_limb: dict[int, Callable[[Array], Array]] = field(default_factory=dict)

    def __call__(self, particles: Array, limb: list[int]) -> Array:
        if limb[0] not in self._of_limb:
            self._of_limb[limb[0]] = self.colours.limb_log_ratio(self.state, limb, self.pixel_stride)
        return self.weight * self._of_limb[limb[0]](particles)


@dataclass(eq=False)
class VolumeObservation:
    """The hulls of one person over a clip. Implements `Observation`.

    appearance : what has been learnt of the person's colours; None = colours have no say.  pictures_of : reads the
    pictures once more; None where there are none.
    """

    tools: VolumeTools
    hull_of: HullOf
    appearance: Appearance | None = None
    pictures_of: PicturesOf | None = None

    def learning(self) -> VolumeObservation:
        """The same, with colours that are learnt while the person is followed."""
        return replace(self, appearance=new_appearance(self.tools.body))

    def knowing(self, counts: NDArray[np.float32]) -> VolumeObservation:
        """The same with more known of the person's colours, counted as in `Appearance`; without colours the same."""
        if self.appearance is None:
            return self
        return replace(self, appearance=replace(self.appearance, counts=self.appearance.counts + counts))

    def with_tools(self, tools: VolumeTools) -> VolumeObservation:
        """The same hulls judged by other tools, without colours."""
        return replace(self, tools=tools, appearance=None)

    def prepare(self, frame: int) -> PreparedHull | None:
        """The hull of a frame, None where there is none or too little of one."""
        with part("hull"):
            hull = self.hull_of(frame)
        if hull is None or len(hull.voxels) < self.tools.settings.method.evidence.min_voxels:
            return None
        with part("prepare"):
            return self.tools.prepared(hull)

    def is_usable(self, frame: int) -> bool:
        """Whether a frame has a hull that can hold a person."""
        hull = self.hull_of(frame)
        return hull is not None and len(hull.voxels) >= self.tools.settings.method.evidence.min_voxels

    def evidence(self, prepared: PreparedHull) -> VolumeEvidence:
        """What poses are judged by in a prepared frame."""
        return self.tools.frame(prepared, self.appearance)

    def learn(self, evidence: FrameEvidence, state: Array) -> None:
        """Take in the colours of a frame: of the parts that are in the hull and clear of the others."""
        if not isinstance(evidence, VolumeEvidence) or evidence.colours is None:
            return
        numbers = self.tools.settings.method.evidence
        scores = evidence.part_scores(state)
        trusted = (scores.double[0] < numbers.colour_max_double) & (
            scores.occupied[0] > numbers.colour_min_occupancy
        )
        self.appearance = evidence.colours.learnt(state, trusted)


def volume_tools(
    body: Body,
    grid: VoxelGrid,
    fps: float,
    settings: PoseSettings,
    likelihood: VoxelLikelihoodSettings,
    n_threads: int,
) -> VolumeTools:
    """Tools of one person of a body's size, with the body's look-up table on a grid."""
    return VolumeTools(
        body=body,
        fps=fps,
        settings=settings,
        n_threads=n_threads,
        table=build_look_up_table(body, grid.voxel_size_m * settings.table_density),
        grid=grid,
        likelihood=likelihood,
        surface_fit=SurfaceFitSettings(),
        outline_fit=OutlineFitSettings(),
    )


def estimate_height(
    grid: VoxelGrid,
    hull_of: HullOf,
    frames: Sequence[int],
    *,
    n_frames: int = StartSettings.height_frames,
    min_voxels: int = EvidenceSettings.min_voxels,
) -> HeightEstimate:
    """Standing height from the heads of a person's hulls, in at most n_frames frames spread over the clip.

    Frames in which the hull reaches the floor count, as long as there are some: who jumps holds his head higher.
    """
    chosen = [frames[i] for i in np.unique(np.linspace(0, len(frames) - 1, n_frames).astype(int))]
    tops, upright, bottoms = [], [], []
    for frame in chosen:
        hull = hull_of(frame)
        if hull is not None and len(hull.voxels) >= min_voxels:
            centers = grid.centers(hull.voxels)
            tops.append(head_top(centers, grid.voxel_size_m))
            upright.append(is_upright(centers, grid.voxel_size_m, tops[-1]))
            bottoms.append(lowest_of(centers))
    is_down = np.array(bottoms) < _IN_THE_AIR_M
    if not is_down.sum() >= _LEAST_DOWN * len(bottoms):
        is_down[:] = True  # furniture or the pictures' edge hides the feet
    heads = np.array(tops)[is_down]
    return height_from_tops(heads, grid.voxel_size_m, np.array(upright, dtype=np.bool_)[is_down])
