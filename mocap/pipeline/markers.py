"""The pose of one person over a clip from marker detections: first pose, fit of body and markers, filter, smoothing."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mocap.body import Body, cones_of, landmarks_of, load_body_model, neutral_state, scale_body
from mocap.body.initial import DEFAULT_HEIGHT_M, HeightEstimate
from mocap.body.kinematics import point_jacobian
from mocap.body.markers import load_marker_set, marker_positions, place_markers
from mocap.data import LANDMARKS
from mocap.filters import FILTERS, initial_particles
from mocap.filters.smoother import smooth_states
from mocap.likelihood.markers import BundleSettings, MarkerFitProblem, bundle_markers
from mocap.pipeline.config import Config
from mocap.pipeline.marker_beam import BeamPath, follow_beam
from mocap.pipeline.marker_problem import MIN_MATCHED_MARKERS, WIDE, Fit, MarkerTools, ObservationOf
from mocap.pipeline.marker_start import (
    MIN_POINTS,
    PointsOf,
    Start,
    find_starts,
    height_from_points,
    points_of_frames,
    steady_points,
)
from mocap.pipeline.pose import PersonPoses
from mocap.pipeline.rng import rng_for

Array = NDArray[np.float64]

PERSON = 1
_N_LOOKS = 12  # frames, spread over the clip, that height and number of persons are read from
_START_S = 2.0
_N_START_LOOKS = 12  # frames of these seconds that are looked at
_TRIAL_FRAMES = 25  # that candidate first poses are followed for before one is taken
_CLEAR_NATS = 3.0  # per frame, between the best first pose and one that faces another way
_FACING_COSINE = 0.5
_ROUGH_SLACK_M = (0.03, 0.01)  # of markers that are not fitted yet: before the first fit, before the second
_FIT_S = 6.0  # how far from the start, each way, body and markers are fitted
_OTHER_PERSON_M = 1.2
_OTHER_POINTS = 6
_OTHER_SHARE = 0.3
# Half of the largest expected acceleration of the smoother's random walk, m/s^2 and rad/s^2.
_ACCELERATION_M_S2 = 5.0
_ACCELERATION_RAD_S2 = 30.0
_MODEL_STD_M = 0.010  # what markers do not tell of a joint: it lies somewhere under the skin
_NEAR_LANDMARK_M = 0.16
_GOOD_SHARE = 0.9
_BUNDLE_REACH_M = 0.12


@dataclass(frozen=True, eq=False)
class Prepared:
    """A person ready to be followed: body and markers fitted to it, and a first pose.

    state : (D,) in frame `frame`.  label : the kind of pose it grew from.  points : frame -> steady points (K, 3) m.
    """

    tools: MarkerTools
    frame: int
    state: Array
    label: str
    height: HeightEstimate
    points: dict[int, Array]
    warnings: tuple[str, ...]


def prepare_person(
    frames: range,
    observation_of: ObservationOf,
    fps: float,
    config: Config,
    *,
    height_m: float | None,
    seed: int,
    progress: Callable[[int, int], None] | None = None,
) -> Prepared | None:
    """First pose, segment lengths and marker offsets of the person who wears the markers; None when there is nobody.

    observation_of : frame -> its detections.  height_m : standing height, None = from the markers.
    The first pose is found in the first seconds by following candidates for a while; body and markers are fitted to
    spread frames, twice. progress : called as progress(done, total).
    """
    looks = [frames[i] for i in np.unique(np.linspace(0, len(frames) - 1, _N_LOOKS).astype(int))]
    points_of = points_of_frames(observation_of)
    points = {f: steady_points(points_of, f, frames) for f in looks}
    height = _height(height_m, list(points.values()))
    body = scale_body(load_body_model(config.body_model("markers")), height.height_m)
    markers = place_markers(load_marker_set(config.body.marker_set), body)
    is_fitted = config.body.marker_offsets == "fit"
    rounds = _ROUGH_SLACK_M if is_fitted else ()
    tools = MarkerTools(body, markers, fps, config.pose, config.markers, rounds[0] if rounds else 0.0)
    first = _first_pose(tools, frames, observation_of, points_of, seed=seed)
    if first is None:
        return None
    reach = round(_FIT_S * fps)
    window = range(max(frames.start, first.frame - reach), min(frames.stop, first.frame + reach + 1))
    n_total = len(rounds) * (len(window) + 1)
    done = 0

    def tick() -> None:
        nonlocal done
        done += 1
        if progress is not None:
            progress(done, n_total)

    state = first.state
    for k, slack in enumerate(rounds):
        tools = replace(tools, extra_slack_m=slack)
        path = _both_ways(
            tools, observation_of, window, first.frame, state, f"markers-{k}", seed=seed, tick=tick
        )
        tools, state = _fitted(tools, observation_of, window, path, first.frame, config.markers.fit_frames)
    warnings = list(first.warnings)
    if is_fitted:
        height = HeightEstimate(tools.body.height_m, True)
    elif not height.is_measured:
        warnings.append(
            f"person {PERSON}: the standing height could not be read from the markers; {height.height_m:.2f} m was "
            "taken. Remedy: set person_height_m in session.toml"
        )
    tools = replace(tools, extra_slack_m=0.0)
    return Prepared(tools, first.frame, state, first.label, height, points, tuple(warnings))


def follow_markers(
    frames: range,
    observation_of: ObservationOf,
    fps: float,
    config: Config,
    *,
    height_m: float | None,
    seed: int,
    progress: Callable[[int, int], None] | None = None,
) -> PersonPoses | None:
    """Poses of the person who wears the markers, in all frames; None when no pose explains the detections.

    The arguments are those of `prepare_person`, which comes first; then the poses are followed from the first one to
    the end and back to the beginning.
    """
    person = prepare_person(
        frames, observation_of, fps, config, height_m=height_m, seed=seed, progress=progress
    )
    if person is None:
        return None
    return follow_prepared(frames, observation_of, person, seed=seed, progress=progress)


def follow_prepared(
    frames: range,
    observation_of: ObservationOf,
    person: Prepared,
    *,
    seed: int,
    progress: Callable[[int, int], None] | None = None,
) -> PersonPoses:
    """Poses of a prepared person from its first pose to the end and back to the beginning, with the settings in its
    tools: several hypotheses refined and smoothed, or without `pose.refine` the filter alone."""
    n_total = len(frames) + 1
    done = 0

    def tick() -> None:
        nonlocal done
        done += 1
        if progress is not None:
            progress(done, n_total)

    tools = person.tools
    if tools.pose.refine:
        path = _both_ways(
            tools, observation_of, frames, person.frame, person.state, "pose", seed=seed, tick=tick
        )
        walk = _Walk(
            path.states, path.ess_share, tuple(f.problem if f and f.is_seen else None for f in path.fits)
        )
    else:
        walk = _filtered(tools, observation_of, frames, person.frame, person.state, seed=seed, tick=tick)
    warnings = [*person.warnings, *_other_persons(tools.body, frames, walk.states, person.points)]
    n_blind = int((~walk.is_seen).sum())
    if n_blind:
        warnings.append(
            f"person {PERSON}: too few detections in {n_blind} of {len(frames)} frames; the pose was carried on there "
            "and its landmarks are marked as not observed"
        )
    return _result(tools, observation_of, frames, walk, person, tuple(warnings))


def _height(given: float | None, points: Sequence[Array]) -> HeightEstimate:
    if given is not None:
        return HeightEstimate(given, True)
    found = height_from_points(points)
    return HeightEstimate(DEFAULT_HEIGHT_M, False) if found is None else HeightEstimate(found, True)


@dataclass(frozen=True, eq=False)
class _First:
    """The first pose.  label : the kind it grew from."""

    frame: int
    state: Array
    label: str
    warnings: tuple[str, ...]


def _first_pose(
    tools: MarkerTools, frames: range, observation_of: ObservationOf, points_of: PointsOf, *, seed: int
) -> _First | None:
    """The candidate that explains some frames around its own best; None when no frame shows enough points."""
    usable: list[tuple[int, Array]] = []
    stride = max(1, round(_START_S * tools.fps / _N_START_LOOKS))
    for frame in frames[::stride]:
        if usable and frame - usable[0][0] > _START_S * tools.fps:
            break
        points = steady_points(points_of, frame, frames)
        if len(points) >= MIN_POINTS:
            usable.append((frame, points))
    if not usable:
        return None
    # Frames with many points first, but apart from each other.
    chosen: list[tuple[int, Array]] = []
    apart = _START_S * tools.fps / (2 * tools.pose.n_start_frames)
    for frame, points in sorted(usable, key=lambda entry: -len(entry[1])):
        if all(abs(frame - other) >= apart for other, _ in chosen):
            chosen.append((frame, points))
        if len(chosen) == tools.pose.n_start_frames:
            break
    quick = replace(
        tools,
        pose=tools.pose.model_copy(
            update={"filter": "apf", "n_layers": 3, "n_particles": 100, "scouts": False}
        ),
    )
    best: tuple[float, Start, BeamPath] | None = None
    for frame, points in chosen:
        start = find_starts(
            tools,
            observation_of(frame),
            points,
            frame,
            n=tools.pose.n_first_poses,
            rng=rng_for(seed, "marker-start", PERSON, frame),
        )
        later = range(frame, min(frames.stop, frame + _TRIAL_FRAMES))
        earlier = range(frame, max(frames.start - 1, frame - _TRIAL_FRAMES), -1)
        path = follow_beam(
            quick,
            observation_of,
            later if len(later) >= len(earlier) else earlier,
            [fit.state for fit in start.fits],
            rng_of=lambda frame: rng_for(seed, "marker-trial", PERSON, frame),
            n_hypotheses=tools.pose.n_first_poses,
        )
        gain = float(path.gain.mean())
        if path.is_seen.any() and (best is None or gain > best[0]):
            best = (gain, start, path)
    if best is None:
        return None
    _, start, path = best
    state = path.states[0]
    nearest = int(np.argmin([np.abs(tools.difference(f.state, state)).sum() for f in start.fits]))
    warnings: tuple[str, ...] = ()
    top = path.ends[0]
    if any(
        not _faces_alike(tools.body, top.state, other.state) and other.score < top.score + _CLEAR_NATS
        for other in path.ends[1:]
    ):
        warnings = (
            f"person {PERSON}: it is not clear which way the person faces (two poses explain the detections almost "
            "equally well); left and right may be exchanged",
        )
    return _First(start.frame, state, start.labels[nearest], warnings)


def _faces_alike(body: Body, a: Array, b: Array) -> bool:
    if "root_yaw" not in body.layout.names:
        return True
    yaw = body.layout.names.index("root_yaw")
    return bool(np.cos(a[yaw] - b[yaw]) > _FACING_COSINE)


def _both_ways(
    tools: MarkerTools,
    observation_of: ObservationOf,
    frames: range,
    start: int,
    state: Array,
    stage: str,
    *,
    seed: int,
    tick: Callable[[], None],
) -> BeamPath:
    """The best path from the start to the end of some frames and back to their beginning, in ascending order."""

    points_of = points_of_frames(observation_of)

    def restart(frame: int) -> Sequence[Fit]:
        points = steady_points(points_of, frame, frames)
        if len(points) < MIN_POINTS:
            return ()
        rng = rng_for(seed, f"{stage}-restart", PERSON, frame)
        return find_starts(
            tools, observation_of(frame), points, frame, n=tools.config.n_hypotheses, rng=rng
        ).fits

    later, earlier = (
        follow_beam(
            tools,
            observation_of,
            order,
            [state],
            rng_of=lambda frame, name=name: rng_for(seed, name, PERSON, frame),  # type: ignore[misc]
            n_hypotheses=tools.config.n_hypotheses,
            restart=restart,
            tick=tick,
        )
        for name, order in (
            (stage, range(start, frames.stop)),
            (f"{stage}-backwards", range(start, frames.start - 1, -1)),
        )
    )
    return BeamPath(
        states=np.concatenate([earlier.states[:0:-1], later.states]),
        fits=(*earlier.fits[:0:-1], *later.fits),
        ess_share=np.concatenate([earlier.ess_share[:0:-1], later.ess_share]),
        ends=later.ends,
    )


def _fitted(
    tools: MarkerTools,
    observation_of: ObservationOf,
    window: range,
    path: BeamPath,
    start: int,
    n_frames: int,
) -> tuple[MarkerTools, Array]:
    """Body and markers fitted to frames of the window, spread evenly, and the pose at the start with them."""
    seen = [i for i in range(len(window)) if path.is_seen[i]]
    if not seen:
        return tools, path.states[start - window.start]
    # Frames whose pose explains little are likely to be wrong in a limb.
    enough = np.median(path.gain[seen]) * _GOOD_SHARE
    good = [i for i in seen if path.gain[i] >= enough]
    rows = sorted({good[k] for k in np.linspace(0, len(good) - 1, n_frames).astype(int)})
    observations = [observation_of(window[i]) for i in rows]
    fit = replace(tools.fit_problem(observations[0]).settings, reach_m=_BUNDLE_REACH_M)
    bundle = bundle_markers(tools.body, tools.markers, observations, path.states[rows], fit, BundleSettings())
    fitted = replace(tools, body=bundle.body, markers=bundle.markers)
    return fitted, fitted.fit(observation_of(start), path.states[start - window.start], WIDE).state


@dataclass(frozen=True, eq=False)
class _Walk:
    """Poses of all frames before they are smoothed.

    states : (T, D).  ess_share : (T,).  matched : T, each frame's fit problem with its matches, None = too little
    seen.  spread : (T, 15, 3, 3) m^2 of the particles, or None.
    """

    states: Array
    ess_share: Array
    matched: tuple[MarkerFitProblem | None, ...]
    spread: Array | None = None

    @property
    def is_seen(self) -> NDArray[np.bool_]:
        return np.array([m is not None for m in self.matched], dtype=np.bool_)


def _filtered(
    tools: MarkerTools,
    observation_of: ObservationOf,
    frames: range,
    start: int,
    state: Array,
    *,
    seed: int,
    tick: Callable[[], None],
) -> _Walk:
    """The filter alone, as published: its estimates both ways from the start.  Source: CF 6.4."""
    T = len(frames)
    states, spread = np.empty((T, len(state))), np.zeros((T, len(LANDMARKS), 3, 3))
    ess_share = np.full(T, np.nan)
    matched: list[MarkerFitProblem | None] = [None] * T
    step = FILTERS[tools.pose.filter].step
    settings = tools.filter_settings()
    for stage, order in (
        ("pose", range(start, frames.stop)),
        ("pose-backwards", range(start, frames.start - 1, -1)),
    ):
        particles, estimate = None, state
        for frame in order:
            i = frame - frames.start
            tick()
            if frame == start and stage != "pose":
                estimate = states[i]
                continue
            observation = observation_of(frame)
            if len(observation.uv) < MIN_MATCHED_MARKERS:
                states[i], particles = estimate, None
                continue
            problem = tools.problem(observation)
            if particles is None:
                particles = initial_particles(problem, estimate, settings.n_particles)
            particles, info = step(problem, particles, settings, rng=rng_for(seed, stage, PERSON, frame))
            states[i] = estimate = info.estimate
            ess_share[i] = float(info.ess[-1]) / len(particles.weights)
            d = landmarks_of(tools.body, particles.particles) - landmarks_of(tools.body, estimate[None])
            spread[i] = np.einsum("n,nlr,nlc->lrc", particles.weights, d, d)
            matched[i] = tools.fit_problem(observation).matched_at(estimate)
    return _Walk(states, ess_share, tuple(matched), spread)


def _result(
    tools: MarkerTools,
    observation_of: ObservationOf,
    frames: range,
    walk: _Walk,
    person: Prepared,
    warnings: tuple[str, ...],
) -> PersonPoses:
    """Smoothed poses with their uncertainty."""
    body, T, D = tools.body, len(frames), tools.body.layout.n_columns
    states = walk.states
    if walk.spread is None:
        information = np.zeros((T, D, D))
        for i, matched in enumerate(walk.matched):
            if matched is not None:
                information[i] = matched.normal_equations(states[i])[1]
        is_position = np.arange(D) < 3
        acceleration = np.where(is_position, _ACCELERATION_M_S2, _ACCELERATION_RAD_S2) / tools.fps**2
        smoothed, covariance = smooth_states(states, information, acceleration, body.layout.is_circular)
        if tools.config.smooth:
            states = np.clip(smoothed, body.layout.lower, body.layout.upper)
        spread = np.empty((T, len(LANDMARKS), 3, 3))
        for i in range(T):
            if not tools.config.smooth and walk.matched[i] is not None:
                covariance[i] = np.linalg.inv(information[i] + np.diag(tools.noise_std**-2.0))
            _, J, _ = point_jacobian(body, states[i], body.landmark_joint, body.landmark_offset)
            spread[i] = np.einsum("lri,ij,lcj->lrc", J, covariance[i], J)
    else:
        spread = walk.spread + _blind_variance(tools, walk.is_seen)[:, None, None, None] * np.eye(3)
    landmarks = landmarks_of(body, states)
    log_likelihood = np.full(T, np.nan)
    for i in np.flatnonzero(walk.is_seen).tolist():
        problem = tools.problem(observation_of(frames[i]))
        log_likelihood[i] = float(problem.log_likelihood(states[i][None]).sum())
    return PersonPoses(
        person=PERSON,
        body=body,
        height=person.height,
        frames=np.array(frames, dtype=np.int64),
        states=states,
        landmarks=landmarks,
        landmark_covariance=spread + _MODEL_STD_M**2 * np.eye(3),
        observed=_observed(tools, walk),
        log_likelihood=log_likelihood,
        ess_share=walk.ess_share,
        start_frame=person.frame,
        first_pose=person.label,
        warnings=warnings,
    )


def _blind_variance(tools: MarkerTools, is_seen: NDArray[np.bool_]) -> Array:
    """Variance that a pose gains with every frame that it is carried on, (T,) m^2."""
    rows = np.arange(len(is_seen))
    seen = np.flatnonzero(is_seen)
    if not len(seen):
        return np.full(len(is_seen), np.inf)
    distance = np.abs(rows[:, None] - seen[None]).min(axis=1)
    return (distance * float(tools.noise_std[0])) ** 2


def _observed(tools: MarkerTools, walk: _Walk) -> NDArray[np.bool_]:
    """A landmark is observed when a marker near it, at rest, is matched in two views or more: (T, 15)."""
    body, markers = tools.body, tools.markers
    rest = neutral_state(body)[None]
    d = np.linalg.norm(landmarks_of(body, rest)[0][:, None] - marker_positions(body, markers, rest), axis=2)
    is_near = d <= np.maximum(_NEAR_LANDMARK_M, d.min(axis=1, keepdims=True))
    out = np.zeros((len(walk.states), len(LANDMARKS)), dtype=np.bool_)
    for i, matched in enumerate(walk.matched):
        if matched is not None and matched.matches is not None:
            out[i] = (is_near & (matched.matches.n_views >= 2)).any(axis=1)
    return out


def _other_persons(body: Body, frames: range, states: Array, points: dict[int, Array]) -> list[str]:
    """A warning when many steady points lie where the person is not."""
    looked = {f: p for f, p in points.items() if len(p)}
    if not looked:
        return []
    n_far = [
        int((np.linalg.norm(p[:, :2] - states[f - frames.start][:2], axis=1) > _OTHER_PERSON_M).sum())
        for f, p in looked.items()
    ]
    if np.mean(np.array(n_far) >= _OTHER_POINTS) < _OTHER_SHARE:
        return []
    return [
        f"more than one person seems to wear markers; only one of them is followed (person {PERSON}). Remedy: record "
        "one person at a time, or use --observation voxels"
    ]


def flesh_centroids(body: Body, states: Array) -> Array:
    """Centre of the flesh of states (T, D), (T, 3) m, world: what `tracks.csv` holds."""
    out = np.empty((len(states), 3))
    for i, state in enumerate(states):
        start, end = cones_of(body, state)
        weight = np.linalg.norm(end - start, axis=1) * (body.cones.radii**2).mean(axis=1)
        out[i] = weight @ (0.5 * (start + end)) / weight.sum()
    return out
