"""The pose of one person over a clip: height, first pose, then filter and refinement frame by frame."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from mocap.body import Body, head_top, height_from_tops, is_upright, landmarks_of
from mocap.body.initial import HeightEstimate
from mocap.data import LANDMARKS, VoxelGrid
from mocap.filters import FILTERS, ParticleState, filter_settings, initial_particles
from mocap.likelihood.colours import Appearance, new_appearance
from mocap.likelihood.voxels import PartScores, part_scores
from mocap.metrics.smoothness import smoothness_scores
from mocap.pipeline.estimate import (
    UNEXPLAINED_M,
    FrameSeries,
    fit_information,
    landmark_covariances,
    point_estimate,
    smooth_motion,
)
from mocap.pipeline.first_pose import (
    FirstPose,
    PoseSearch,
    settle_first_poses,
    try_first_poses,
    walking_velocity,
)
from mocap.pipeline.limbs import Lookout, limb_misfits, recover_limbs
from mocap.pipeline.pose_problem import (
    MIN_VOXELS,
    FrameProblem,
    HullOf,
    PoseTools,
    PreparedHull,
    is_usable,
)
from mocap.pipeline.pose_settings import filter_budget
from mocap.pipeline.repair import repair_limbs
from mocap.pipeline.rescue import Rescue, rescue_pose
from mocap.pipeline.rng import rng_for
from mocap.pipeline.sizing import fit_size, resized_tools
from mocap.threads import worker_threads

Array = NDArray[np.float64]

_OBSERVED_OCCUPANCY = 0.5
_CLEAR_DOUBLE = 0.15  # a part that overlaps others by more, or lies in the hull by less, teaches no colours
_CLEAR_OCCUPANCY = 0.6
_BLIND_STD_M = 0.02
_TRIAL_S = 3.0  # how far each way two starting hypotheses are compared
_TRIAL_STRIDE = 3
_CLEAR_FACING_NATS = 3.0
_SHORT_FRAMES = 10  # a clip too short to compare two starting hypotheses over time
_GONE_S = 0.4  # without a volume, after which a pose is looked for anew
_CROWDED = 0.4  # share of a hull's surface that the body leaves unexplained
_GENTLE_OUTLINES = 1.0
_SIZING_STRIDE_S = 0.1
_N_SIZING_FRAMES = 6
_DECISIVE_NATS = 25.0  # one frame decides alone when its two hypotheses are this far apart


@dataclass(frozen=True, eq=False)
class PersonPoses:
    """The result for one person.

    frames : (T,).  states : (T, D).  landmarks : (T, 15, 3) m.  landmark_covariance : (T, 15, 3, 3) m^2.
    observed : (T, 15) bool.
    log_likelihood, ess_share : (T,), of the poses before they were smoothed.  start_frame : where the first pose was
    found.  first_pose : its name.  series : what the frames gave one by one, before smoothing; None = not kept.
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
    series: FrameSeries | None = None


def estimate_height(grid: VoxelGrid, hull_of: HullOf, frames: Sequence[int]) -> HeightEstimate:
    """Standing height from the heads of a person's hulls, in at most 60 frames spread over the clip."""
    chosen = [frames[i] for i in np.unique(np.linspace(0, len(frames) - 1, 60).astype(int))]
    tops, upright = [], []
    for frame in chosen:
        hull = hull_of(frame)
        if hull is not None and len(hull.voxels) >= MIN_VOXELS:
            centers = grid.centers(hull.voxels)
            tops.append(head_top(centers, grid.voxel_size_m))
            upright.append(is_upright(centers, grid.voxel_size_m, tops[-1]))
    return height_from_tops(np.array(tops), grid.voxel_size_m, np.array(upright, dtype=np.bool_))


@dataclass
class Looks:
    """What has been learnt of a person's colours; kept over both passes of a clip."""

    appearance: Appearance

    def learn(self, frame: FrameProblem, state: Array, scores: PartScores) -> None:
        """Take in a frame under its settled pose: the parts that are in the hull and clear of the others."""
        if frame.colours is not None:
            trusted = (scores.double[0] < _CLEAR_DOUBLE) & (scores.occupied[0] > _CLEAR_OCCUPANCY)
            self.appearance = frame.colours.learnt(state, trusted)


@dataclass(frozen=True, eq=False)
class FramePose:
    """The pose of one frame.  row : index into the person's frames; information, spread, misfit, unexplained and
    blind_std as in `FrameSeries`, the rest as in `PersonPoses`.
    """

    row: int
    state: Array
    landmarks: Array
    information: Array
    spread: Array
    misfit: Array
    unexplained: float
    blind_std: float
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
    looks: Looks | None = None,
) -> Iterator[FramePose]:
    """Run the filter over rows `order` of a person's frames, from the pose `first` (D,) in the first of them.

    frames : (T,).  xyz : (T, 3) m, track.  A frame without a usable hull carries the pose on with growing uncertainty
    and observed = False.  looks : what is known of the person's colours, kept up to date; None = do without.
    """
    step = FILTERS[tools.pose.filter].step
    settings = filter_settings(
        filter_budget(tools.pose, tools.body.layout), tools.body.layout, tools.noise_std
    )
    particles: ParticleState | None = None
    estimate = first
    last_xyz = xyz[order[0]] if len(order) else np.zeros(3)
    last_row: int | None = None
    blind_std, n_blind = 0.0, 0
    nothing = np.zeros((tools.body.layout.n_columns,) * 2)
    rescue = Rescue()
    lookout = Lookout()
    for i, seen in _hulls_ahead(tools, frames, hull_of, order):
        if seen is None:
            blind_std += float(tools.noise_std[0])
            n_blind += 1
            yield FramePose(
                row=i,
                state=estimate,
                landmarks=landmarks_of(tools.body, estimate[None])[0],
                information=nothing,
                spread=np.zeros((len(LANDMARKS), 3, 3)),
                misfit=np.zeros(tools.body.layout.n_parts),
                unexplained=0.0,
                blind_std=float(np.hypot(_BLIND_STD_M, blind_std)),
                observed=np.zeros(len(LANDMARKS), dtype=np.bool_),
                log_likelihood=float("nan"),
                evidence=float("nan"),
                ess_share=float("nan"),
            )
            continue
        frame = tools.frame(seen, None if looks is None else looks.appearance)
        problem = frame.search
        if particles is None:
            particles = initial_particles(problem, estimate, settings.n_particles)
        shift = xyz[i] - last_xyz
        if tools.pose.follow_track:
            moved = particles.particles.copy()
            moved[:, :3] += shift
            particles = replace(particles, particles=moved)
        last_xyz = xyz[i]
        # Frames in which the person was not tracked have no rows.
        n_away = 0 if last_row is None else abs(int(frames[i] - frames[last_row])) - abs(i - last_row)
        last_row = i
        previous = None if blind_std > 0 or n_away > 0 else estimate
        has_returned = n_blind + n_away >= max(2, round(_GONE_S * tools.fps))
        blind_std, n_blind = 0.0, 0
        rng = rng_for(seed, stage, person, int(frames[i]))
        particles, info = step(problem, particles, settings, rng=rng)
        estimate = point_estimate(tools.body, particles, info, tools.pose.estimate)
        spread = _landmark_covariance(tools.body, particles, estimate)
        if tools.pose.refine:
            starts = [estimate]
            if previous is not None:
                carried = previous.copy()
                carried[:3] += shift
                starts.append(carried)
            candidates = [estimate, *frame.all_refined(starts)]
            values = frame.evidence(candidates)
            estimate, value = candidates[int(values.argmax())], float(values.max())
        else:
            value = float(frame.evidence([estimate])[0])
        if tools.pose.scouts:
            per_part = frame.voxels.log_likelihood(estimate[None])[0]
            look_at = lookout.due(value, limb_misfits(tools.body.layout, per_part))
            found = recover_limbs(frame, estimate, previous, look_at=look_at, max_limbs=2, rng=rng)
            found_value = value if found is estimate else float(frame.evidence([found])[0])
            lookout.note(found_value - value, look_at)
            estimate, value = found, found_value
        if tools.pose.scouts and (has_returned or rescue.is_due(i, value)):
            velocity = walking_velocity(frames, xyz, i, tools.fps)
            search = PoseSearch(
                tools, seen, int(frames[i]), velocity, None if looks is None else looks.appearance
            )
            # Who was away may stand and face anyhow: all that is known is where.
            saved = (
                settle_first_poses(search, try_first_poses(search, rng=rng), rng=rng)[0].state
                if has_returned
                else rescue_pose(search, estimate, rescue.best_state, rng=rng)
            )
            lost_judged, saved_judged = search.judge([estimate, saved])
            if rescue.settle(i, lost_judged, saved_judged) or (has_returned and saved_judged > lost_judged):
                estimate, value = saved, float(frame.evidence([saved])[0])
                particles = initial_particles(problem, estimate, settings.n_particles)
        rescue.note(estimate, value)
        if tools.pose.refine or tools.pose.scouts:
            particles = _feed_back(particles, estimate, tools.pose.feedback_share)
        scores = part_scores(tools.body, tools.table, problem.volume, estimate[None])
        if looks is not None:
            looks.learn(frame, estimate, scores)
        fit = _fit_of(frame, estimate)
        yield FramePose(
            row=i,
            state=estimate,
            landmarks=landmarks_of(tools.body, estimate[None])[0],
            information=fit.information,
            spread=spread + (0.5 * tools.grid.voxel_size_m) ** 2 * np.eye(3),
            misfit=fit.misfit,
            unexplained=fit.unexplained,
            blind_std=0.0,
            observed=_observed_landmarks(tools.body, scores.occupied[0], info.observed_parts),
            log_likelihood=fit.log_likelihood,
            evidence=value,
            ess_share=float(info.ess[-1]) / len(particles.weights),
        )


def _hulls_ahead(
    tools: PoseTools, frames: NDArray[np.int64], hull_of: HullOf, order: Sequence[int]
) -> Iterator[tuple[int, PreparedHull | None]]:
    """Rows in order with their hulls, None where it is not usable; with several threads the next one is made ready
    while a frame is worked on.
    """

    def prepare(row: int) -> PreparedHull | None:
        hull = hull_of(int(frames[row]))
        return None if hull is None or not is_usable(hull) else tools.prepared(hull)

    if tools.n_threads <= 1:
        yield from ((row, prepare(row)) for row in order)
        return
    pool = worker_threads(tools.n_threads)
    rows = list(order)
    coming = [pool.submit(prepare, row) for row in rows[:1]]
    for k, row in enumerate(rows):
        coming += [pool.submit(prepare, after) for after in rows[k + 1 : k + 2]]
        yield row, coming.pop(0).result()


@dataclass(frozen=True, eq=False)
class _Fit:
    """How one state fits its frame; information, misfit and unexplained as in `FrameSeries`."""

    information: Array
    misfit: Array
    unexplained: float
    log_likelihood: float


def _fit_of(frame: FrameProblem, state: Array) -> _Fit:
    layout = frame.tools.body.layout
    per_part = frame.voxels.log_likelihood(state[None])[0]
    information = np.zeros((layout.n_columns, layout.n_columns))
    if frame.tools.pose.refine:
        cost, normal_matrix, _ = frame.fit.normal_equations(state)
        information = fit_information(cost, normal_matrix, frame.surface.n_points)
    # A global likelihood says nothing of parts: its misfit is shared out.
    shared = np.broadcast_to(per_part / (layout.n_parts / len(per_part)), layout.n_parts)
    return _Fit(
        information=information,
        misfit=np.maximum(-shared, 0.0),
        unexplained=frame.surface.unexplained_share(state, UNEXPLAINED_M),
        log_likelihood=float(per_part.sum()),
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


@dataclass(frozen=True, eq=False)
class Start:
    """A person ready to be followed.  trial : (K,) mean evidence of the starting hypotheses that were compared.
    n_usable : frames with a usable hull.
    """

    tools: PoseTools
    height: HeightEstimate
    first: FirstPose
    trial: Array
    n_usable: int


def start_person(
    person: int,
    frames: NDArray[np.int64],
    xyz: Array,
    hull_of: HullOf,
    tools: PoseTools,
    height: HeightEstimate,
    *,
    seed: int,
    is_size_fitted: bool = False,
) -> Start:
    """First pose and size of one person; the arguments and errors are those of `follow_person`."""
    usable = [i for i in range(len(frames)) if is_usable(hull_of(int(frames[i])))]
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
            velocity = walking_velocity(frames, xyz, i, tools.fps)
            search = PoseSearch(searching, searching.prepared(hull), frame, velocity)
            tried = try_first_poses(search, rng=rng_for(seed, "first-pose", person, frame))
            searches.append((search, tried))
    search, tried = max(searches, key=lambda entry: entry[1][0].log_likelihood)
    is_crowded = search.problem.surface.unexplained_share(tried[0].state, UNEXPLAINED_M) > _CROWDED
    if is_crowded and tools.pose.outline_weight > _GENTLE_OUTLINES:
        # The silhouettes hold more than the person, a chair perhaps: their outlines are not all his.
        gentle = {"outline_weight": _GENTLE_OUTLINES}
        tools = replace(tools, pose=tools.pose.model_copy(update=gentle))
        searching = replace(searching, pose=searching.pose.model_copy(update=gentle))
        search = replace(search, tools=searching)
    hypotheses = settle_first_poses(search, tried, rng=rng_for(seed, "settle", person, search.frame))
    best, trial = choose_hypothesis(tools, person, frames, xyz, hull_of, hypotheses, seed=seed)
    if is_size_fitted and not is_crowded:  # a larger body would explain the chair as well
        tools, height, best = _sized(tools, person, frames, xyz, hull_of, height, best, seed=seed)
    return Start(tools, height, best, trial, len(usable))


def follow_person(
    person: int,
    frames: NDArray[np.int64],
    xyz: Array,
    hull_of: HullOf,
    tools: PoseTools,
    height: HeightEstimate,
    *,
    seed: int,
    is_size_fitted: bool = False,
    progress: Callable[[int], None] | None = None,
) -> PersonPoses:
    """Poses of one person over the frames of its track.

    frames : (T,) ascending.  xyz : (T, 3) m, track.  hull_of : frame -> the person's voxels, or None.
    The first pose is looked for in a few frames of the first two seconds; the filter runs from the best of them to
    the end, and back to the beginning.
    is_size_fitted : `height` is only the highest place of the head; the size is fitted to some frames around the first
    pose, and the height changes with it.
    Raises ValueError when no frame has a usable hull.
    """
    found = start_person(
        person, frames, xyz, hull_of, tools, height, seed=seed, is_size_fitted=is_size_fitted
    )
    tools, height, best, trial = found.tools, found.height, found.first, found.trial
    start = int(np.searchsorted(frames, best.frame))
    T, D, M = len(frames), tools.body.layout.n_columns, len(LANDMARKS)
    series = FrameSeries(
        states=np.empty((T, D)),
        information=np.empty((T, D, D)),
        spread=np.empty((T, M, 3, 3)),
        misfit=np.empty((T, tools.body.layout.n_parts)),
        unexplained=np.empty(T),
        blind_std=np.empty(T),
    )
    observed = np.zeros((T, M), dtype=np.bool_)
    log_likelihood, ess_share = np.full(T, np.nan), np.full(T, np.nan)
    looks = Looks(new_appearance(tools.body)) if tools.pose.refine else None
    for stage, order in (("pose", range(start, T)), ("pose-backwards", range(start, -1, -1))):
        for pose in filter_frames(
            tools, person, frames, xyz, hull_of, order, best.state, seed=seed, stage=stage, looks=looks
        ):
            i = pose.row
            if i == start and stage != "pose":
                continue  # the start was settled on the way forward
            series.states[i], series.information[i], series.spread[i] = (
                pose.state,
                pose.information,
                pose.spread,
            )
            series.misfit[i], series.blind_std[i] = pose.misfit, pose.blind_std
            series.unexplained[i] = pose.unexplained
            observed[i] = pose.observed
            log_likelihood[i], ess_share[i] = pose.log_likelihood, pose.ess_share
            if progress is not None:
                progress(1)
    if tools.pose.repair and looks is not None:
        colours = looks.appearance

        def frame_of(row: int) -> FrameProblem | None:
            hull = hull_of(int(frames[row]))
            return None if hull is None or not is_usable(hull) else tools.frame(hull, colours)

        for i, state in repair_limbs(tools.body, series.states, tools.fps, frame_of).items():
            frame = frame_of(i)
            if frame is not None:
                fit = _fit_of(frame, state)
                series.states[i], series.information[i] = state, fit.information
                series.misfit[i], series.unexplained[i] = fit.misfit, fit.unexplained
                log_likelihood[i] = fit.log_likelihood
                scores = part_scores(tools.body, tools.table, frame.voxels.volume, state[None])
                observed[i] = _observed_landmarks(tools.body, scores.occupied[0], None)
    states = series.states
    if tools.pose.smooth_lag_frames:
        states = smooth_motion(tools.body, series, tools.fps, tools.pose.smooth_lag_frames)
    warnings: list[str] = []
    n_blind = T - found.n_usable
    if n_blind:
        warnings.append(
            f"person {person}: no usable volume in {n_blind} of {T} frames; the last pose was carried on and "
            "its landmarks are marked as not observed"
        )
    n_crowded = int((series.unexplained > _CROWDED).sum())
    if n_crowded:
        warnings.append(
            f"person {person}: in {n_crowded} of {T} frames the body explains less than {100 - 100 * _CROWDED:.0f} % "
            "of the volume, as when others or things are in it or few cameras see the person; poses are uncertain there"
        )
    seldom = _seldom_observed(observed, log_likelihood)
    if seldom:
        warnings.append(
            f"person {person}: {', '.join(seldom)} lie in the volume in less than half of the frames: it has holes "
            "there, or the pose is wrong. Remedy: look at the masks in the report; clothes or skin of the colour of "
            "the background leave holes"
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
        landmarks=landmarks_of(tools.body, states),
        landmark_covariance=landmark_covariances(tools.body, series, is_refined=tools.pose.refine),
        observed=observed,
        log_likelihood=log_likelihood,
        ess_share=ess_share,
        start_frame=best.frame,
        first_pose=best.label,
        warnings=tuple(warnings),
        series=series,
    )


def _sized(
    tools: PoseTools,
    person: int,
    frames: NDArray[np.int64],
    xyz: Array,
    hull_of: HullOf,
    height: HeightEstimate,
    first: FirstPose,
    *,
    seed: int,
) -> tuple[PoseTools, HeightEstimate, FirstPose]:
    """Tools, height and first pose of a person whose size is fitted to a few frames around the first pose."""
    start = int(np.searchsorted(frames, first.frame))
    stride = max(1, round(_SIZING_STRIDE_S * tools.fps))
    quick = replace(
        tools,
        fps=tools.fps / stride,
        pose=tools.pose.model_copy(
            update={"n_layers": 4, "n_particles": 200, "refine": True, "scouts": False}
        ),
    )
    reach = stride * _N_SIZING_FRAMES
    seen = [
        pose
        for order in (
            range(start, min(len(frames), start + reach), stride),
            range(start - stride, max(-1, start - reach), -stride),
        )
        for pose in filter_frames(
            quick, person, frames, xyz, hull_of, order, first.state, seed=seed, stage="sizing"
        )
        if np.isfinite(pose.evidence)
    ]
    if not seen:
        return tools, height, first
    # The frames that are explained best: a limb that is lost says nothing of the size.
    seen = sorted(seen, key=lambda pose: -pose.evidence)[:_N_SIZING_FRAMES]
    problems, states = [], []
    for pose in seen:
        hull = hull_of(int(frames[pose.row]))
        if hull is not None:
            problems.append(tools.frame(hull))
            states.append(pose.state)
    fit = fit_size(problems, states, is_head_seen=height.is_measured)
    sized = resized_tools(tools, fit.factor)
    hull = hull_of(first.frame)
    state = first.state if hull is None else sized.frame(hull).refined(first.state)
    height = replace(height, height_m=sized.body.height_m)
    return sized, height, replace(first, state=state)


def motion_numbers(poses: PersonPoses, fps: float) -> dict[str, float | None]:
    """How much the landmarks tremble (m/s^3, None for a clip of fewer than four frames) and how much was observed."""
    jitter = smoothness_scores(poses.landmarks, poses.landmarks, poses.frames, fps).jitter_estimate_m_s3
    return {
        "jitter_m_s3": None if jitter is None else round(jitter, 1),
        "observed_percent": round(100.0 * float(poses.observed.mean()), 1),
    }


def _seldom_observed(observed: NDArray[np.bool_], log_likelihood: Array) -> list[str]:
    """Landmarks that were observed (T, 15) in less than half of the frames that had a usable volume."""
    usable = np.isfinite(log_likelihood)
    if not usable.any():
        return []
    return [name for name, share in zip(LANDMARKS, observed[usable].mean(axis=0), strict=True) if share < 0.5]


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
