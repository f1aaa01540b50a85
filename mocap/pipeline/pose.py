"""The pose of one person over a clip: height, first pose, then filter and refinement frame by frame."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial

import numpy as np
from numpy.typing import NDArray

from mocap.body import (
    Body,
    LookUpTable,
    candidate_states,
    head_top,
    height_from_tops,
    joint_transforms,
    landmarks_of,
    load_body_model,
    scale_body,
)
from mocap.body.initial import HeightEstimate
from mocap.data import LANDMARKS, VoxelGrid
from mocap.filters import (
    FILTERS,
    ApfSettings,
    ParticleState,
    RefineSettings,
    ScoutSettings,
    apf_step,
    initial_particles,
    refine,
    scout_limbs,
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

CROP_MARGIN_M = 0.3  # how far beyond the hull particles may meet themselves
MIN_VOXELS = 200  # fewer (1.6 litres at 2 cm) are no body: the pose is carried on instead
_SEARCH_STD_M = 0.06
_SEARCH_STD_RAD = 0.2
_SEARCH_COPIES = 8
_FACING_NATS = 8.0  # cost of facing against the direction of walking, CF 6.3.3 takes it as a certainty
_WALKING_M_S = 0.3
_OBSERVED_OCCUPANCY = 0.5
# Nats per square metre of mean surface cost: the lost arm of a person, a tenth of the surface, is worth about 7.
_NATS_PER_M2 = 90_000.0
_UNEXPLAINED_M = 0.05
_UNEXPLAINED_SHARE = 0.025  # of the hull's surface points; loose clothes reach 0.01, a lost forearm 0.04
_LOOK_EVERY = 3
_SCOUT_ZEAL = 4.0
_LOST_NATS = 12.0
_RESCUE_MARGIN_NATS = 4.0
_RESCUE_AFTER = 8
_RESCUE_MEMORY = 90
_BLIND_STD_M = 0.02
_TRIAL_S = 3.0  # how far each way two starting hypotheses are compared
_TRIAL_STRIDE = 3
_CLEAR_FACING_NATS = 3.0
_SHORT_FRAMES = 10  # a clip too short to compare two starting hypotheses over time
_DECISIVE_NATS = 25.0  # one frame decides alone when its two hypotheses are this far apart


@dataclass(frozen=True, eq=False)
class PersonHull:
    """The voxels of one person in one frame.  voxels : (N,) int32 ascending.  is_surface : (N,) bool."""

    voxels: NDArray[np.int32]
    is_surface: NDArray[np.bool_]


HullOf = Callable[[int], PersonHull | None]


@dataclass(frozen=True, eq=False)
class PersonPoses:
    """The result for one person.

    frames : (T,).  states : (T, D).  landmarks : (T, 15, 3) m.  landmark_covariance : (T, 15, 3, 3) m^2.
    observed : (T, 15) bool.
    log_likelihood, ess_share : (T,).  start_frame : where the first pose was found.  first_pose : its name.
    """

    person: int
    body: Body
    height: HeightEstimate
    frames: NDArray[np.int64]
    states: Array
    landmarks: Array
    landmark_covariance: Array
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


def evidence(problem: VoxelProblem, surface: SurfaceProblem, states: Sequence[Array]) -> Array:
    """How well states explain the hull, (K,): the likelihood asks whether the body lies in the hull, the surface
    whether the hull is explained by the body. In nats.
    """
    inside = problem.log_likelihood(np.stack(states)).sum(axis=1)
    return inside - _surface_nats(surface, states)


def _surface_nats(surface: SurfaceProblem, states: Sequence[Array]) -> Array:
    """The surface cost of states in nats, (K,), whatever the number of hull points."""
    cost = np.array([surface.normal_equations(s)[0] for s in states])
    return _NATS_PER_M2 * cost / max(surface.n_points, 1)


def recover_limbs(
    tools: PoseTools,
    problem: VoxelProblem,
    surface: SurfaceProblem,
    state: Array,
    *,
    look_at_hull: bool,
    max_limbs: int,
    rng: np.random.Generator,
) -> Array:
    """A state (D,) with limbs searched for anew that fit badly or leave a piece of the hull unexplained.

    look_at_hull : also search when much of the hull's surface is unexplained though every limb fits. The state comes
    back unchanged unless the evidence grows.
    """
    settings = ScoutSettings(max_limbs=max_limbs)
    lost = surface.unexplained(state, _UNEXPLAINED_M)
    bonus = None
    if look_at_hull and len(lost) > _UNEXPLAINED_SHARE * surface.n_points:
        bonus = partial(_explained_nats, tools.body, lost, len(lost) / surface.n_points)
    found, scouted = scout_limbs(problem, state, settings, rng=rng, bonus=bonus)
    if not scouted.accepted:
        return state
    refined, _ = refine(surface, found, tools.refine_settings())
    candidates = [state, found, refined]
    return candidates[int(evidence(problem, surface, candidates).argmax())]


def _explained_nats(body: Body, lost: Array, lost_share: float, particles: Array, limb: list[int]) -> Array:
    """Evidence of the lost hull points (U, 3) that a limb of each particle would explain, (N,)."""
    some = lost[:: max(1, len(lost) // 24)]
    rows = np.flatnonzero(np.isin(body.cones.part, limb))
    R, t = joint_transforms(body, particles)
    joint = body.cones.joint[rows]
    start = np.einsum("nkrc,kc->nkr", R[:, joint], body.cones.start[rows]) + t[:, joint]
    axis = np.einsum("nkrc,kc->nkr", R[:, joint], body.cones.end[rows] - body.cones.start[rows])
    offset = some[None, None] - start[:, :, None]
    along = np.einsum("nkuc,nkc->nku", offset, axis) / np.maximum((axis**2).sum(axis=2), 1e-12)[:, :, None]
    foot = np.clip(along, 0.0, 1.0)[..., None] * axis[:, :, None]
    reach = body.cones.radii[rows].mean(axis=1) + _UNEXPLAINED_M
    near = (((offset - foot) ** 2).sum(axis=3) < (reach**2)[None, :, None]).any(axis=1)
    # A lost point costs the surface term its robust limit, scale^2 / 2. The search overstates it: what it finds is
    # judged by the evidence itself.
    per_share = _SCOUT_ZEAL * _NATS_PER_M2 * 0.5 * SurfaceFitSettings().scale_m ** 2
    return per_share * lost_share * near.mean(axis=1)


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


@dataclass(frozen=True, eq=False)
class PoseSearch:
    """The search for a first pose in one frame: what it is judged by.

    walking_xy : (2,) velocity of the person around this frame, m/s, or None; when the person walks, facing the other
    way costs likelihood.
    """

    tools: PoseTools
    hull: PersonHull
    frame: int
    walking_xy: Array | None

    @cached_property
    def problems(self) -> tuple[VoxelProblem, SurfaceProblem]:
        return self.tools.problems(self.hull)

    @cached_property
    def coarse(self) -> SurfaceProblem:
        """A cheap surface problem for brief attempts."""
        settings = SurfaceFitSettings(n_hull_points=400, n_flesh_points=150)
        return SurfaceProblem(self.tools.body, self.tools.table, self.problems[1].hull, settings)

    @property
    def heading(self) -> float | None:
        """Direction of walking, rad, or None for a person who stays."""
        if self.walking_xy is None or float(np.hypot(*self.walking_xy)) <= _WALKING_M_S:
            return None
        return float(np.arctan2(self.walking_xy[1], self.walking_xy[0]))

    @property
    def std(self) -> Array:
        is_position = np.arange(self.tools.body.layout.n_columns) < 3
        return np.where(is_position, _SEARCH_STD_M, _SEARCH_STD_RAD)

    def score(self, states: Array) -> Array:
        """Log-likelihood of states (N, D) with the prior on the direction, (N,)."""
        value = self.problems[0].log_likelihood(states).sum(axis=1)
        yaw, heading = _yaw_column(self.tools.body), self.heading
        if yaw is not None and heading is not None:
            value -= _FACING_NATS * (1.0 - np.cos(states[:, yaw] - heading))
        return value

    def judge(self, states: Sequence[Array]) -> Array:
        """The evidence of states with the prior on the direction, (K,) nats."""
        return self.score(np.stack(states)) - _surface_nats(self.problems[1], states)

    def with_limbs_recovered(self, found: FirstPose, *, rng: np.random.Generator) -> FirstPose:
        """The same pose after scouts have looked for limbs that fit badly or that the hull shows elsewhere."""
        problem, surface = self.problems
        state = recover_limbs(
            self.tools, problem, surface, found.state, look_at_hull=True, max_limbs=4, rng=rng
        )
        value = float(self.judge([state])[0])
        return FirstPose(found.frame, state, found.label, value) if value > found.log_likelihood else found

    def attempt(
        self,
        start: ParticleState,
        label: str,
        settings: ApfSettings,
        *,
        is_brief: bool,
        rng: np.random.Generator,
    ) -> FirstPose:
        """A short filter from some particles, refined."""
        problem, surface = self.problems
        _, info = apf_step(problem, start, settings, rng=rng)
        if is_brief:
            surface = self.coarse
        refining = self.tools.refine_settings(5 if is_brief else 12)
        found = [info.estimate, refine(surface, info.estimate, refining)[0]]
        values = self.score(np.stack(found)) - _surface_nats(surface, found)
        top = int(values.argmax())
        return FirstPose(self.frame, found[top], label, float(values[top]))


def try_first_poses(search: PoseSearch, *, rng: np.random.Generator) -> list[FirstPose]:
    """Many kinds of poses in all directions, the promising ones followed briefly, best first.

    Source: CF 6.3.3; departs from it: the volume decides, the displacement is a prior.
    """
    body = search.tools.body
    yaws: Array = np.arange(16, dtype=np.float64) * (2 * np.pi / 16) + (search.heading or 0.0)
    centers = search.tools.grid.centers(search.hull.voxels)
    candidates, labels = candidate_states(body, centers, yaws)
    copies = np.repeat(candidates, _SEARCH_COPIES, axis=0)
    copies = search.problems[0].propagate(copies, search.std, rng=rng)
    copies[::_SEARCH_COPIES] = candidates
    value = search.score(copies).reshape(len(candidates), _SEARCH_COPIES)
    copies = copies.reshape(len(candidates), _SEARCH_COPIES, -1)
    equal = np.full(_SEARCH_COPIES, 1.0 / _SEARCH_COPIES)
    brief = ApfSettings(n_layers=4, n_particles=80, std=search.std, alpha=0.5)
    tried = [
        search.attempt(ParticleState(copies[k], equal), labels[k], brief, is_brief=True, rng=rng)
        for k in np.argsort(-value.max(axis=1), kind="stable")[: 4 * search.tools.pose.n_first_poses]
    ]
    return sorted(tried, key=lambda found: -found.log_likelihood)


def settle_first_poses(
    search: PoseSearch, tried: Sequence[FirstPose], *, rng: np.random.Generator
) -> list[FirstPose]:
    """The best pose after following the best starts to the end, and the best one that faces the other way."""
    yaw = _yaw_column(search.tools.body)
    chosen = list(tried[: search.tools.pose.n_first_poses])
    if yaw is not None:
        # A person from behind has the silhouette of one from the front: follow the best of the other half too.
        behind = [f for f in tried if np.cos(f.state[yaw] - tried[0].state[yaw]) < 0]
        chosen += [f for f in behind[:3] if f not in chosen]
    thorough = ApfSettings(n_layers=8, n_particles=200, std=search.std, alpha=0.6)
    problem = search.problems[0]
    found = [
        search.attempt(initial_particles(problem, f.state, 2), f.label, thorough, is_brief=False, rng=rng)
        for f in chosen
    ]
    found.sort(key=lambda f: -f.log_likelihood)
    if yaw is not None:
        ahead = [f for f in found if np.cos(f.state[yaw] - found[0].state[yaw]) >= 0]
        other = [f for f in found if np.cos(f.state[yaw] - found[0].state[yaw]) < 0]
        found = [*ahead[:2], *other[:1]]
    recovered = [search.with_limbs_recovered(f, rng=rng) for f in found[:3]]
    recovered.sort(key=lambda f: -f.log_likelihood)
    if yaw is None:
        return recovered[:1]
    other = [f for f in recovered if np.cos(f.state[yaw] - recovered[0].state[yaw]) < 0]
    return [recovered[0], *other[:1]]


def _yaw_column(body: Body) -> int | None:
    columns = np.flatnonzero(body.layout.is_circular)
    return int(columns[0]) if len(columns) else None


def _walking(frames: NDArray[np.int64], xyz: Array, i: int, fps: float) -> Array | None:
    """Mean velocity on the floor over about half a second around row i, (2,) m/s."""
    reach = max(1, round(0.25 * fps))
    a, b = max(0, i - reach), min(len(frames) - 1, i + reach)
    if a == b:
        return None
    return (xyz[b, :2] - xyz[a, :2]) * fps / float(frames[b] - frames[a])


@dataclass(frozen=True, eq=False)
class FramePose:
    """The pose of one frame.  row : index into the person's frames; the rest as in `PersonPoses`."""

    row: int
    state: Array
    landmarks: Array
    landmark_covariance: Array
    observed: NDArray[np.bool_]
    log_likelihood: float
    evidence: float
    ess_share: float


def filter_frames(
    tools: PoseTools,
    person: int,
    frames: NDArray[np.int64],
    xyz: Array,
    hull_of: HullOf,
    order: Sequence[int],
    first: Array,
    *,
    seed: int,
    stage: str,
) -> Iterator[FramePose]:
    """Run the filter over rows `order` of a person's frames, from the pose `first` (D,) in the first of them.

    frames : (T,).  xyz : (T, 3) m, track.  A frame without a usable hull carries the pose on with growing uncertainty
    and observed = False.
    """
    step = FILTERS[tools.pose.filter]
    settings = ApfSettings(
        n_layers=tools.pose.n_layers,
        n_particles=tools.pose.n_particles,
        std=tools.noise_std,
        alpha=tools.pose.survival_rate,
        resampling=tools.pose.resampling,
    )
    particles: ParticleState | None = None
    estimate = first
    last_xyz = xyz[order[0]] if len(order) else np.zeros(3)
    blind_std = 0.0
    rescue = Rescue()
    for i in order:
        hull = hull_of(int(frames[i]))
        if hull is None or len(hull.voxels) < MIN_VOXELS:
            blind_std += float(tools.noise_std[0])
            yield FramePose(
                row=i,
                state=estimate,
                landmarks=landmarks_of(tools.body, estimate[None])[0],
                landmark_covariance=np.tile(
                    (_BLIND_STD_M**2 + blind_std**2) * np.eye(3), (len(LANDMARKS), 1, 1)
                ),
                observed=np.zeros(len(LANDMARKS), dtype=np.bool_),
                log_likelihood=float("nan"),
                evidence=float("nan"),
                ess_share=float("nan"),
            )
            continue
        problem, surface = tools.problems(hull)
        if particles is None:
            particles = initial_particles(problem, estimate, settings.n_particles)
        if tools.pose.follow_track:
            moved = particles.particles.copy()
            moved[:, :3] += xyz[i] - last_xyz
            particles = ParticleState(moved, particles.weights)
        last_xyz = xyz[i]
        blind_std = 0.0
        rng = rng_for(seed, stage, person, int(frames[i]))
        particles, info = step(problem, particles, settings, rng=rng)
        spread = _landmark_covariance(tools.body, particles, info.estimate)
        estimate = info.estimate
        if tools.pose.refine:
            refined, _ = refine(surface, info.estimate, tools.refine_settings())
            candidates = [info.estimate, refined]
            estimate = candidates[int(evidence(problem, surface, candidates).argmax())]
        if tools.pose.scouts:
            estimate = recover_limbs(
                tools,
                problem,
                surface,
                estimate,
                look_at_hull=int(frames[i]) % _LOOK_EVERY == 0,
                max_limbs=3,
                rng=rng,
            )
        value = float(evidence(problem, surface, [estimate])[0])
        if tools.pose.scouts and rescue.is_due(i, value):
            search = PoseSearch(tools, hull, int(frames[i]), _walking(frames, xyz, i, tools.fps))
            saved = rescue_pose(search, estimate, rescue.best_state, rng=rng)
            lost_judged, saved_judged = search.judge([estimate, saved])
            if rescue.settle(i, lost_judged, saved_judged):
                estimate, value = saved, float(evidence(problem, surface, [saved])[0])
                particles = initial_particles(problem, estimate, settings.n_particles)
        rescue.note(estimate, value)
        if tools.pose.refine or tools.pose.scouts:
            particles = _feed_back(particles, estimate, tools.pose.feedback_share)
        scores = part_scores(tools.body, tools.table, problem.volume, estimate[None])
        yield FramePose(
            row=i,
            state=estimate,
            landmarks=landmarks_of(tools.body, estimate[None])[0],
            landmark_covariance=spread + (0.5 * tools.grid.voxel_size_m) ** 2 * np.eye(3),
            observed=_observed_landmarks(tools.body, scores.occupied[0]),
            log_likelihood=float(problem.log_likelihood(estimate[None]).sum()),
            evidence=value,
            ess_share=float(info.ess[-1]) / len(particles.weights),
        )


@dataclass
class Rescue:
    """When a pose counts as lost: its evidence has fallen far below what this person's poses usually reach.

    best_state is the latest pose that was good; a failed rescue doubles the pause before the next.
    """

    best_state: Array | None = None
    _values: list[float] = field(default_factory=list)
    _next: int | None = None
    _pause: int = 2

    @property
    def usual(self) -> float:
        return float(np.quantile(self._values, 0.6)) if len(self._values) >= _RESCUE_AFTER else -np.inf

    def is_due(self, row: int, value: float) -> bool:
        """Whether row's pose is lost and the last attempt lies far enough back."""
        waited = self._next is None or abs(row - self._next) >= self._pause
        return value < self.usual - _LOST_NATS and waited

    def settle(self, row: int, value: float, saved: float) -> bool:
        """Whether a rescued pose is taken."""
        self._next = row
        is_better = saved > value + _RESCUE_MARGIN_NATS
        self._pause = 2 if is_better else min(2 * self._pause, 32)
        return is_better

    def note(self, state: Array, value: float) -> None:
        if value >= self.usual - 0.5 * _LOST_NATS:
            self.best_state = state
        self._values.append(value)
        del self._values[:-_RESCUE_MEMORY]


def rescue_pose(search: PoseSearch, state: Array, good: Array | None, *, rng: np.random.Generator) -> Array:
    """A new pose for a lost body: from the last good pose and from usual poses, moved to where the body is now.

    Where it is and which way it faces are taken from the lost state (D,), whose trunk and head are kept longest,
    unless the person walks another way.
    """
    body = search.tools.body
    yaw = _yaw_column(body)
    facing = 0.0 if yaw is None else float(state[yaw])
    if search.heading is not None and np.cos(facing - search.heading) < 0.5:
        facing = search.heading
    starts, _ = candidate_states(body, search.tools.grid.centers(search.hull.voxels), np.array([facing]))
    states = [*starts, state]
    if good is not None:
        moved = good.copy()
        moved[:3] = state[:3]
        if yaw is not None:
            moved[yaw] = facing
        states.append(moved)
    problem = search.problems[0]
    brief = ApfSettings(n_layers=4, n_particles=80, std=0.5 * search.std, alpha=0.5)
    thorough = ApfSettings(n_layers=6, n_particles=200, std=0.5 * search.std, alpha=0.6)
    tried = [
        search.attempt(initial_particles(problem, s, 2), "", brief, is_brief=True, rng=rng) for s in states
    ]
    tried.sort(key=lambda found: -found.log_likelihood)
    settled = [
        search.attempt(initial_particles(problem, f.state, 2), "", thorough, is_brief=False, rng=rng)
        for f in tried[:2]
    ]
    best = max(settled, key=lambda found: found.log_likelihood)
    return search.with_limbs_recovered(best, rng=rng).state


def choose_hypothesis(
    tools: PoseTools,
    person: int,
    frames: NDArray[np.int64],
    xyz: Array,
    hull_of: HullOf,
    hypotheses: Sequence[FirstPose],
    *,
    seed: int,
) -> tuple[FirstPose, Array]:
    """The hypothesis that explains the seconds around its start best, and the mean log-likelihood of each, (K,).

    Each is followed over every third frame with few particles. Front and back look alike in one frame; knees and
    elbows that bend tell them apart over time.
    """
    settled = np.array([h.log_likelihood for h in hypotheses])
    if len(frames) < _SHORT_FRAMES:
        return hypotheses[0], settled
    if len(hypotheses) == 1 or settled[0] > settled[1] + _DECISIVE_NATS:
        return hypotheses[0], settled[:1]
    quick = replace(
        tools,
        fps=tools.fps / _TRIAL_STRIDE,
        pose=tools.pose.model_copy(
            update={"n_layers": 4, "n_particles": 200, "refine": True, "scouts": False}
        ),
    )
    reach = round(_TRIAL_S * tools.fps)
    values = []
    for hypothesis in hypotheses:
        start = int(np.searchsorted(frames, hypothesis.frame))
        later = range(start, min(len(frames), start + reach), _TRIAL_STRIDE)
        earlier = range(start, max(-1, start - reach), -_TRIAL_STRIDE)
        reached = [
            pose.evidence
            for order in (later, earlier)
            for pose in filter_frames(
                quick, person, frames, xyz, hull_of, order, hypothesis.state, seed=seed, stage="trial"
            )
        ]
        values.append(float(np.nanmean(reached)))
    return hypotheses[int(np.argmax(values))], np.array(values)


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
    the end, and back to the beginning.
    Raises ValueError when no frame has a usable hull.
    """
    T, D, M = len(frames), tools.body.layout.n_columns, len(LANDMARKS)
    usable = [i for i in range(T) if _is_usable(hull_of(int(frames[i])))]
    if not usable:
        raise ValueError(f"person {person} has no frame with a usable hull")
    searching = tools
    if len(usable) < _SHORT_FRAMES:
        # No motion will tell front from back: look harder.
        harder = tools.pose.model_copy(update={"n_first_poses": 3 * tools.pose.n_first_poses})
        searching = replace(tools, pose=harder)
    window = [i for i in usable if frames[i] - frames[usable[0]] <= 2 * tools.fps]
    picks = np.unique(np.linspace(0, len(window) - 1, tools.pose.n_start_frames).astype(int))
    searches = []
    for i in (window[p] for p in picks):
        frame = int(frames[i])
        hull = hull_of(frame)
        if hull is not None:
            search = PoseSearch(searching, hull, frame, _walking(frames, xyz, i, tools.fps))
            tried = try_first_poses(search, rng=rng_for(seed, "first-pose", person, frame))
            searches.append((search, tried))
    search, tried = max(searches, key=lambda entry: entry[1][0].log_likelihood)
    hypotheses = settle_first_poses(search, tried, rng=rng_for(seed, "settle", person, search.frame))
    best, trial = choose_hypothesis(tools, person, frames, xyz, hull_of, hypotheses, seed=seed)
    start = int(np.searchsorted(frames, best.frame))

    states = np.empty((T, D))
    landmarks, covariance = np.empty((T, M, 3)), np.empty((T, M, 3, 3))
    observed = np.zeros((T, M), dtype=np.bool_)
    log_likelihood, ess_share = np.full(T, np.nan), np.full(T, np.nan)
    for stage, order in (("pose", range(start, T)), ("pose-backwards", range(start, -1, -1))):
        for pose in filter_frames(
            tools, person, frames, xyz, hull_of, order, best.state, seed=seed, stage=stage
        ):
            i = pose.row
            if i == start and stage != "pose":
                continue  # the start was settled on the way forward
            states[i], landmarks[i], covariance[i] = pose.state, pose.landmarks, pose.landmark_covariance
            observed[i] = pose.observed
            log_likelihood[i], ess_share[i] = pose.log_likelihood, pose.ess_share
            if progress is not None:
                progress(1)
    warnings: list[str] = []
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
    if len(trial) > 1 and abs(trial[0] - trial[1]) < _CLEAR_FACING_NATS:
        warnings.append(
            f"person {person}: it is not clear which way the person faces (two poses explain the volumes "
            "almost equally well); left and right may be exchanged"
        )
    return PersonPoses(
        person=person,
        body=tools.body,
        height=height,
        frames=frames,
        states=states,
        landmarks=landmarks,
        landmark_covariance=covariance,
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


def _landmark_covariance(body: Body, particles: ParticleState, estimate: Array) -> Array:
    """Spread of the landmarks over the particles around the estimate's, (15, 3, 3) m^2."""
    d = landmarks_of(body, particles.particles) - landmarks_of(body, estimate[None])
    return np.einsum("n,nlr,nlc->lrc", particles.weights, d, d)


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
