"""The pose of one person over a clip: height, first pose, then filter and refinement frame by frame."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from mocap.body import Body, head_top, height_from_tops, landmarks_of
from mocap.body.initial import HeightEstimate
from mocap.data import LANDMARKS, VoxelGrid
from mocap.filters import FILTERS, ParticleState, initial_particles
from mocap.likelihood import part_scores
from mocap.pipeline.filter_settings import filter_settings
from mocap.pipeline.first_pose import (
    FirstPose,
    PoseSearch,
    settle_first_poses,
    try_first_poses,
    walking_velocity,
)
from mocap.pipeline.limbs import recover_limbs
from mocap.pipeline.pose_problem import MIN_VOXELS, HullOf, PoseTools, is_usable
from mocap.pipeline.rescue import Rescue, rescue_pose
from mocap.pipeline.rng import rng_for

Array = NDArray[np.float64]

_OBSERVED_OCCUPANCY = 0.5
_LOOK_EVERY = 3
_BLIND_STD_M = 0.02
_TRIAL_S = 3.0  # how far each way two starting hypotheses are compared
_TRIAL_STRIDE = 3
_CLEAR_FACING_NATS = 3.0
_SHORT_FRAMES = 10  # a clip too short to compare two starting hypotheses over time
_DECISIVE_NATS = 25.0  # one frame decides alone when its two hypotheses are this far apart


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
    settings = filter_settings(tools.pose, tools.body.layout, tools.noise_std)
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
        frame = tools.frame(hull)
        problem = frame.voxels
        if particles is None:
            particles = initial_particles(problem, estimate, settings.n_particles)
        if tools.pose.follow_track:
            moved = particles.particles.copy()
            moved[:, :3] += xyz[i] - last_xyz
            particles = replace(particles, particles=moved)
        last_xyz = xyz[i]
        previous = None if blind_std > 0 else estimate
        blind_std = 0.0
        rng = rng_for(seed, stage, person, int(frames[i]))
        particles, info = step(problem, particles, settings, rng=rng)
        spread = _landmark_covariance(tools.body, particles, info.estimate)
        estimate = info.estimate
        if tools.pose.refine:
            estimate = frame.best([estimate, frame.refined(estimate)])
        if tools.pose.scouts:
            estimate = recover_limbs(
                frame,
                estimate,
                previous,
                look_at_hull=int(frames[i]) % _LOOK_EVERY == 0,
                max_limbs=3,
                rng=rng,
            )
        value = float(frame.evidence([estimate])[0])
        if tools.pose.scouts and rescue.is_due(i, value):
            search = PoseSearch(tools, hull, int(frames[i]), walking_velocity(frames, xyz, i, tools.fps))
            saved = rescue_pose(search, estimate, rescue.best_state, rng=rng)
            lost_judged, saved_judged = search.judge([estimate, saved])
            if rescue.settle(i, lost_judged, saved_judged):
                estimate, value = saved, float(frame.evidence([saved])[0])
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
            observed=_observed_landmarks(tools.body, scores.occupied[0], info.observed_parts),
            log_likelihood=float(problem.log_likelihood(estimate[None]).sum()),
            evidence=value,
            ess_share=float(info.ess[-1]) / len(particles.weights),
        )


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
    usable = [i for i in range(T) if is_usable(hull_of(int(frames[i])))]
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
            search = PoseSearch(searching, hull, frame, walking_velocity(frames, xyz, i, tools.fps))
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
    return replace(particles, particles=states, weights=weights)


def _observed_landmarks(
    body: Body, occupied: Array, observed_parts: NDArray[np.bool_] | None
) -> NDArray[np.bool_]:
    """A landmark is observed when the part at its joint lies in occupied voxels and the filter has not lost it.

    occupied : (P,).  observed_parts : (P,), None for a filter that does not judge.
    """
    part_of_joint = {int(j): int(p) for j, p in zip(body.cones.joint, body.cones.part, strict=True)}
    parts = [part_of_joint.get(int(j), 0) for j in body.landmark_joint]
    is_observed = occupied[parts] >= _OBSERVED_OCCUPANCY
    return is_observed if observed_parts is None else is_observed & observed_parts[parts]
