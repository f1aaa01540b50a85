"""The pose of one person over a clip: height, first pose, then filter and refinement frame by frame."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from mocap.body import (
    Body,
    LookUpTable,
    candidate_states,
    head_top,
    height_from_tops,
    landmarks_of,
    load_body_model,
    scale_body,
)
from mocap.body.initial import HeightEstimate
from mocap.data import VoxelGrid
from mocap.filters import (
    FILTERS,
    ApfSettings,
    ParticleState,
    RefineSettings,
    apf_step,
    initial_particles,
    refine,
)
from mocap.likelihood import (
    PackedVolume,
    SurfaceFitSettings,
    SurfaceProblem,
    VoxelLikelihoodSettings,
    VoxelProblem,
    hull_surface,
    part_scores,
)
from mocap.pipeline.config import LikelihoodConfig, PoseConfig
from mocap.pipeline.rng import rng_for
from mocap.volume import surface_map

Array = NDArray[np.float64]

CROP_MARGIN_M = 0.4  # how far beyond the hull particles may meet themselves
MIN_VOXELS = 200  # fewer (1.6 litres at 2 cm) are no body: the pose is carried on instead
_SEARCH_STD_M = 0.06
_SEARCH_STD_RAD = 0.2
_SEARCH_COPIES = 8
_FACING_NATS = 8.0  # cost of facing against the direction of walking, CF 6.3.3 takes it as a certainty
_MOVING_M = 0.15
_OBSERVED_OCCUPANCY = 0.5


@dataclass(frozen=True, eq=False)
class PersonHull:
    """The voxels of one person in one frame.  voxels : (N,) int32 ascending.  is_surface : (N,) bool."""

    voxels: NDArray[np.int32]
    is_surface: NDArray[np.bool_]


HullOf = Callable[[int], PersonHull | None]


@dataclass(frozen=True, eq=False)
class PersonPoses:
    """The result for one person.

    frames : (T,).  states : (T, D).  landmarks, landmark_std : (T, 15, 3) m.  observed : (T, 15) bool.
    log_likelihood, ess_share : (T,).  start_frame : where the first pose was found.  first_pose : its name.
    n_evaluations : likelihood evaluations per frame.
    """

    person: int
    body: Body
    height: HeightEstimate
    frames: NDArray[np.int64]
    states: Array
    landmarks: Array
    landmark_std: Array
    observed: NDArray[np.bool_]
    log_likelihood: Array
    ess_share: Array
    start_frame: int
    first_pose: str
    warnings: tuple[str, ...] = field(default=())


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

    @property
    def refine_settings(self) -> RefineSettings:
        is_position = np.arange(self.body.layout.n_columns) < 3
        return RefineSettings(prior_std=np.where(is_position, 0.1, 0.5))

    def problems(self, hull: PersonHull) -> tuple[VoxelProblem, SurfaceProblem]:
        volume = pack_volume(self.grid, hull, self.pose.surface_sigma_voxels)
        surface = hull_surface(hull.voxels, hull.is_surface, self.grid, volume)
        return (
            VoxelProblem(self.body, self.table, volume, self.likelihood, n_threads=self.n_threads),
            SurfaceProblem(self.body, self.table, surface, self.fit),
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


def estimate_height(grid: VoxelGrid, hull_of: HullOf, frames: Sequence[int]) -> HeightEstimate:
    """Standing height from the heads of a person's hulls, in at most 60 frames spread over the clip."""
    chosen = [frames[i] for i in np.unique(np.linspace(0, len(frames) - 1, 60).astype(int))]
    tops = []
    for frame in chosen:
        hull = hull_of(frame)
        if hull is not None and len(hull.voxels) >= MIN_VOXELS:
            tops.append(head_top(grid.centers(hull.voxels), grid.voxel_size_m))
    return height_from_tops(np.array(tops), grid.voxel_size_m)


@dataclass(frozen=True, eq=False)
class FirstPose:
    """A starting pose.  state : (D,); label names the kind it grew from."""

    frame: int
    state: Array
    label: str
    log_likelihood: float


def find_first_pose(
    tools: PoseTools, hull: PersonHull, frame: int, walking_xy: Array | None, *, rng: np.random.Generator
) -> FirstPose:
    """The best pose in one frame without a track: many kinds of poses in all directions, then short filters.

    walking_xy : (2,) displacement of the person around this frame, m, or None; when the person walks, facing the
    other way costs likelihood.
    Source: CF 6.3.3; departs from it: the volume decides, the displacement is a prior.
    """
    problem, surface = tools.problems(hull)
    layout = tools.body.layout
    yaws: Array = np.arange(16, dtype=np.float64) * (2 * np.pi / 16)
    is_moving = walking_xy is not None and float(np.hypot(*walking_xy)) > _MOVING_M
    heading = float(np.arctan2(walking_xy[1], walking_xy[0])) if walking_xy is not None and is_moving else 0.0
    if is_moving:
        yaws += heading
    candidates, labels = candidate_states(tools.body, tools.grid.centers(hull.voxels), yaws)
    std = np.where(np.arange(layout.n_columns) < 3, _SEARCH_STD_M, _SEARCH_STD_RAD)
    yaw_column = int(np.flatnonzero(layout.is_circular)[0]) if layout.is_circular.any() else None

    def score(states: Array) -> Array:
        value = problem.log_likelihood(states).sum(axis=1)
        if is_moving and yaw_column is not None:
            value -= _FACING_NATS * (1.0 - np.cos(states[:, yaw_column] - heading))
        return value

    copies = problem.propagate(np.repeat(candidates, _SEARCH_COPIES, axis=0), std, rng=rng)
    copies[::_SEARCH_COPIES] = candidates
    first = score(copies).reshape(len(candidates), _SEARCH_COPIES)
    copies = copies.reshape(len(candidates), _SEARCH_COPIES, -1)
    settings = ApfSettings(n_layers=8, n_particles=200, std=std, alpha=0.6)
    best = FirstPose(frame, candidates[0], labels[0], -np.inf)
    for k in np.argsort(-first.max(axis=1))[: tools.pose.n_first_poses]:
        start = ParticleState(copies[k], np.full(_SEARCH_COPIES, 1.0 / _SEARCH_COPIES))
        _, info = apf_step(problem, start, settings, rng=rng)
        refined, _ = refine(surface, info.estimate, tools.refine_settings)
        for state, value in zip(
            (info.estimate, refined), score(np.stack([info.estimate, refined])), strict=True
        ):
            if value > best.log_likelihood:
                best = FirstPose(frame, state, labels[k], float(value))
    return best


def _walking(frames: NDArray[np.int64], xyz: Array, i: int, fps: float) -> Array | None:
    """Displacement on the floor over half a second around row i, (2,) m."""
    reach = max(1, round(0.25 * fps))
    a, b = max(0, i - reach), min(len(frames) - 1, i + reach)
    if a == b:
        return None
    return xyz[b, :2] - xyz[a, :2]


def follow_person(
    person: int,
    frames: NDArray[np.int64],
    xyz: Array,
    hull_of: HullOf,
    tools: PoseTools,
    height: HeightEstimate,
    *,
    seed: int,
    progress: Callable[[int], None] | None = None,
) -> PersonPoses:
    """Poses of one person over the frames of its track.

    frames : (T,) ascending.  xyz : (T, 3) m, track.  hull_of : frame -> the person's voxels, or None.
    The first pose is looked for in a few frames of the first two seconds; the filter runs from the best of them to
    the end, and back to the beginning. A frame without a hull carries the pose on, with growing uncertainty and
    observed = False.
    """
    T, D = len(frames), tools.body.layout.n_columns
    warnings: list[str] = []
    usable = [i for i in range(T) if _is_usable(hull_of(int(frames[i])))]
    if not usable:
        raise ValueError(f"person {person} has no frame with a hull")
    window = [i for i in usable if frames[i] - frames[usable[0]] <= 2 * tools.fps]
    picks = np.unique(np.linspace(0, len(window) - 1, tools.pose.n_start_frames).astype(int))
    best: FirstPose | None = None
    for i in (window[p] for p in picks):
        frame = int(frames[i])
        hull = hull_of(frame)
        if hull is None:
            continue
        found = find_first_pose(
            tools,
            hull,
            frame,
            _walking(frames, xyz, i, tools.fps),
            rng=rng_for(seed, "first-pose", person, frame),
        )
        if best is None or found.log_likelihood > best.log_likelihood:
            best = found
    if best is None:
        raise ValueError(f"person {person} has no frame with a hull")
    start = int(np.searchsorted(frames, best.frame))

    states = np.empty((T, D))
    landmarks = np.empty((T, 15, 3))
    std = np.empty((T, 15, 3))
    observed = np.zeros((T, 15), dtype=np.bool_)
    log_likelihood = np.full(T, np.nan)
    ess_share = np.full(T, np.nan)
    step = FILTERS[tools.pose.filter]
    settings = ApfSettings(
        n_layers=tools.pose.n_layers,
        n_particles=tools.pose.n_particles,
        std=tools.noise_std,
        alpha=tools.pose.survival_rate,
        resampling=tools.pose.resampling,
    )

    def run(order: range, stage: str) -> None:
        particles: ParticleState | None = None
        estimate = best.state
        last_xyz = xyz[start]
        blind_std = 0.0
        for i in order:
            frame = int(frames[i])
            hull = hull_of(frame)
            if hull is None or not _is_usable(hull):
                # Nothing to see: carry on, and say so.
                blind_std += float(tools.noise_std[0])
                states[i] = estimate
                landmarks[i] = landmarks_of(tools.body, estimate[None])[0]
                std[i] = np.hypot(0.02, blind_std)
                if progress is not None:
                    progress(1)
                continue
            problem, surface = tools.problems(hull)
            if particles is None:
                particles = initial_particles(problem, estimate, settings.n_particles)
            shift = xyz[i] - last_xyz if tools.pose.follow_track else np.zeros(3)
            last_xyz = xyz[i]
            blind_std = 0.0
            moved = particles.particles.copy()
            moved[:, :3] += shift
            rng = rng_for(seed, stage, person, frame)
            particles, info = step(problem, ParticleState(moved, particles.weights), settings, rng=rng)
            spread = _landmark_std(tools.body, particles, info.estimate)
            estimate = info.estimate
            if tools.pose.refine:
                estimate, _ = refine(surface, info.estimate, tools.refine_settings)
                particles = _feed_back(particles, estimate, tools.pose.feedback_share)
            states[i] = estimate
            landmarks[i] = landmarks_of(tools.body, estimate[None])[0]
            std[i] = np.hypot(spread, 0.5 * tools.grid.voxel_size_m)
            scores = part_scores(tools.body, tools.table, problem.volume, estimate[None])
            observed[i] = _observed_landmarks(tools.body, scores.occupied[0])
            log_likelihood[i] = float(problem.log_likelihood(estimate[None]).sum())
            ess_share[i] = float(info.ess[-1]) / settings.n_particles
            if progress is not None:
                progress(1)

    run(range(start, T), "pose")
    if start > 0:
        run(range(start - 1, -1, -1), "pose-backwards")
    n_blind = T - len(usable)
    if n_blind:
        warnings.append(
            f"person {person}: no usable volume in {n_blind} of {T} frames; the last pose was carried on and "
            "its landmarks are marked as not observed"
        )
    if not height.is_measured:
        warnings.append(
            f"person {person}: the standing height could not be read from the volume; "
            f"{height.height_m:.2f} m was taken. Remedy: set person_height_m in session.toml"
        )
    return PersonPoses(
        person=person,
        body=tools.body,
        height=height,
        frames=frames,
        states=states,
        landmarks=landmarks,
        landmark_std=std,
        observed=observed,
        log_likelihood=log_likelihood,
        ess_share=ess_share,
        start_frame=best.frame,
        first_pose=best.label,
        warnings=tuple(warnings),
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


def _is_usable(hull: PersonHull | None) -> bool:
    return hull is not None and len(hull.voxels) >= MIN_VOXELS


def _landmark_std(body: Body, particles: ParticleState, estimate: Array) -> Array:
    """Spread of the landmarks over the particles around the estimate's, (15, 3) m."""
    points = landmarks_of(body, particles.particles)
    d = points - landmarks_of(body, estimate[None])
    return np.sqrt(np.einsum("n,nlc->lc", particles.weights, d * d))


def _feed_back(particles: ParticleState, estimate: Array, share: float) -> ParticleState:
    """Put the refined pose in the place of the lightest particles, with the given share of the weight."""
    n = len(particles.weights)
    m = round(share * n)
    if m == 0:
        return particles
    lightest = np.argsort(particles.weights, kind="stable")[:m]
    states, weights = particles.particles.copy(), particles.weights.copy()
    weights[lightest] = 0.0
    rest = weights.sum()
    weights *= (1.0 - share) / rest if rest > 0 else 0.0
    states[lightest] = estimate
    weights[lightest] = (share if rest > 0 else 1.0) / m
    return ParticleState(states, weights)


def _observed_landmarks(body: Body, occupied: Array) -> NDArray[np.bool_]:
    """A landmark is observed when the parts at its joint lie in occupied voxels.  occupied : (P,)."""
    part_of_joint = {int(j): int(p) for j, p in zip(body.cones.joint, body.cones.part, strict=True)}
    parts = [part_of_joint.get(int(j), 0) for j in body.landmark_joint]
    return occupied[parts] >= _OBSERVED_OCCUPANCY
