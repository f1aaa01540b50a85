"""The pose of one person over a clip of detections: start, fit of body and markers, both directions, smoothing."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mocap.body import Body, cones_of, landmarks_of
from mocap.body.initial import DEFAULT_HEIGHT_M, HeightEstimate
from mocap.body.kinematics import point_jacobian
from mocap.filters.smoother import smooth_states
from mocap.likelihood.markers import BundleSettings, bundle_markers
from mocap.pose.beam import BeamPath, follow_beam
from mocap.pose.deviation import FrameSeries, within_limits
from mocap.pose.evidence import PersonClip
from mocap.pose.follow import FramePose, both_ways, follow_pose, unbroken
from mocap.pose.marker import Fit, MarkerClipObservation, MarkerTools, ObservationOf, observed_landmarks
from mocap.pose.marker_start import (
    MarkerStart,
    PointsOf,
    find_starts,
    height_from_points,
    points_of_frames,
    steady_points,
)
from mocap.pose.method import MarkerStartSettings
from mocap.pose.result import FollowedPerson, PersonPoses
from mocap.rng import rng_for

Array = NDArray[np.float64]

PERSON = 1  # one wears markers; edits by hand may make another of him


@dataclass(frozen=True, eq=False)
class Prepared:
    """A person ready to be followed: body and markers fitted to it, and a first pose.

    state : (D,) in frame `frame`.  label : the kind of pose it grew from.  is_facing_open : a pose that faces another
    way explains the detections almost as well.  points : frame -> steady points (K, 3) m.
    """

    tools: MarkerTools
    frame: int
    state: Array
    label: str
    height: HeightEstimate
    is_facing_open: bool
    points: dict[int, Array]
    person: int = PERSON


def prepare_person(
    frames: range,
    observation_of: ObservationOf,
    tools_of: Callable[[float], MarkerTools],
    *,
    height_m: float | None,
    seed: int,
    is_fitted: bool = True,
    progress: Callable[[int, int], None] | None = None,
    person: int = PERSON,
) -> Prepared | None:
    """First pose, segment lengths and marker offsets of the person who wears the markers; None when there is nobody.

    observation_of : frame -> its detections.  tools_of : standing height, m -> body and markers of that size.
    height_m : standing height, None = from the markers.  is_fitted : fit segment lengths and marker offsets to the
    person; otherwise they stay as the tools give them.
    The first pose is found in the first seconds by following candidates for a while; body and markers are fitted to
    spread frames, twice. progress : called as progress(done, total).
    """
    numbers = tools_of(DEFAULT_HEIGHT_M).settings.method.marker_start
    looks = [frames[i] for i in np.unique(np.linspace(0, len(frames) - 1, numbers.n_looks).astype(int))]
    points_of = points_of_frames(observation_of, numbers.max_error_px)
    points = {f: steady_points(points_of, f, frames, numbers.steady_m) for f in looks}
    height = _height(height_m, list(points.values()), numbers)
    rounds = numbers.rough_slack_m if is_fitted else ()
    tools = replace(tools_of(height.height_m), extra_slack_m=rounds[0] if rounds else 0.0)
    first = _first_pose(tools, frames, observation_of, points_of, seed=seed, person=person)
    if first is None:
        return None
    reach = round(numbers.fit_s * tools.fps)
    window = range(max(frames.start, first.frame - reach), min(frames.stop, first.frame + reach + 1))
    tick = _ticker(len(rounds) * (len(window) + 1), progress)
    state = first.state
    for k, slack in enumerate(rounds):
        tools = replace(tools, extra_slack_m=slack)
        path = _beam_both_ways(
            _clip(window, MarkerClipObservation(tools, observation_of), person),
            first.frame,
            state,
            f"markers-{k}",
            seed=seed,
            tick=tick,
        )
        tools, state = _fitted(tools, observation_of, window, path, first.frame)
    if is_fitted:
        height = HeightEstimate(tools.body.height_m, True)
    tools = replace(tools, extra_slack_m=0.0)
    return Prepared(tools, first.frame, state, first.label, height, first.is_facing_open, points, person)


def _ticker(n_total: int, progress: Callable[[int, int], None] | None) -> Callable[[], None]:
    """A function that reports one more step of n_total each time it is called."""
    done = 0

    def tick() -> None:
        nonlocal done
        done += 1
        if progress is not None:
            progress(done, n_total)

    return tick


def follow_markers(
    frames: range,
    observation_of: ObservationOf,
    tools_of: Callable[[float], MarkerTools],
    *,
    height_m: float | None,
    seed: int,
    is_fitted: bool = True,
    progress: Callable[[int, int], None] | None = None,
    person: int = PERSON,
) -> FollowedPerson | None:
    """The person who wears the markers in all frames; None when no pose explains the detections. `finish_markers` makes
    poses of it.

    The arguments are those of `prepare_person`, which comes first; then the poses are followed from the first one to
    the end and back to the beginning.
    """
    prepared = prepare_person(
        frames,
        observation_of,
        tools_of,
        height_m=height_m,
        seed=seed,
        is_fitted=is_fitted,
        progress=progress,
        person=person,
    )
    if prepared is None:
        return None
    return follow_prepared(frames, observation_of, prepared, seed=seed, progress=progress)


def follow_prepared(
    frames: range,
    observation_of: ObservationOf,
    prepared: Prepared,
    *,
    seed: int,
    progress: Callable[[int, int], None] | None = None,
) -> FollowedPerson:
    """A prepared person from its first pose to the end and back to the beginning, with the settings in its tools:
    several hypotheses refined, or without `pose.refine` the filter alone."""
    tools = prepared.tools
    observation = MarkerClipObservation(tools, observation_of)
    clip = _clip(frames, observation, prepared.person)
    if tools.settings.refine:
        tick = _ticker(len(frames) + 1, progress)
        path = _beam_both_ways(clip, prepared.frame, prepared.state, "pose", seed=seed, tick=tick)
        walk = _walk_of_beam(tools, path)
    else:
        walk = _filtered(clip, prepared, seed=seed, tick=_ticker(len(frames), progress))
    series = FrameSeries.of_length(len(frames), tools.body)
    series.states[:], series.observed[:], series.ess_share[:] = walk.states, walk.observed, walk.ess_share
    if walk.spread is not None:
        series.fit_covariance[:] = walk.spread
    series.log_likelihood[:] = np.nan
    for row in np.flatnonzero(walk.is_seen).tolist():
        problem = tools.problem(observation_of(frames[row]))
        series.log_likelihood[row] = float(problem.log_likelihood(walk.states[row][None]).sum())
    return FollowedPerson(
        person=prepared.person,
        tools=tools,
        height=prepared.height,
        frames=clip.frames,
        series=series,
        is_facing_open=prepared.is_facing_open,
        n_usable=int(walk.is_seen.sum()),
        start_frame=prepared.frame,
        first_pose=prepared.label,
        information=walk.information,
        warnings=tuple(_other_persons(prepared, frames, walk.states)),
    )


def _height(given: float | None, points: Sequence[Array], numbers: MarkerStartSettings) -> HeightEstimate:
    if given is not None:
        return HeightEstimate(given, True)
    found = height_from_points(points, numbers.min_points)
    return HeightEstimate(DEFAULT_HEIGHT_M, False) if found is None else HeightEstimate(found, True)


@dataclass(frozen=True, eq=False)
class _First:
    """The first pose.  label : the kind it grew from.  is_facing_open : as in `Prepared`."""

    frame: int
    state: Array
    label: str
    is_facing_open: bool


def _first_pose(
    tools: MarkerTools,
    frames: range,
    observation_of: ObservationOf,
    points_of: PointsOf,
    *,
    seed: int,
    person: int,
) -> _First | None:
    """The candidate that explains some frames around its own best; None when no frame shows enough points."""
    numbers, settings = tools.settings.method.marker_start, tools.settings
    brisk = tools.brisk(numbers.trial_layers, numbers.trial_particles)
    brisk = replace(
        brisk, settings=replace(brisk.settings, filter=replace(brisk.settings.filter, name="apf"))
    )
    clip = _clip(frames, MarkerClipObservation(brisk, observation_of), person)
    best: tuple[float, MarkerStart, BeamPath] | None = None
    for frame, points in _start_frames(tools, frames, points_of):
        start = find_starts(
            tools,
            observation_of(frame),
            points,
            frame,
            n=settings.n_first_poses,
            rng=rng_for(seed, "marker-start", person, frame),
        )
        row = frame - frames.start
        later = range(row, min(len(frames), row + numbers.trial_frames))
        earlier = range(row, max(-1, row - numbers.trial_frames), -1)
        path = follow_beam(
            clip,
            later if len(later) >= len(earlier) else earlier,
            [fit.state for fit in start.fits],
            rng_of=lambda frame: rng_for(seed, "marker-trial", person, frame),
            n_hypotheses=settings.n_first_poses,
        )
        gain = float(path.gain.mean())
        if path.is_seen.any() and (best is None or gain > best[0]):
            best = (gain, start, path)
    if best is None:
        return None
    _, start, path = best
    state = path.states[0]
    nearest = int(np.argmin([np.abs(tools.difference(f.state, state)).sum() for f in start.fits]))
    is_facing_open = _is_facing_open(tools.body, path, numbers)
    return _First(start.frame, state, start.labels[nearest], is_facing_open)


def _is_facing_open(body: Body, path: BeamPath, numbers: MarkerStartSettings) -> bool:
    """Whether a pose that faces another way explains the detections almost as well as the best one."""
    top = path.ends[0]
    return any(
        not _faces_alike(body, top.state, other.state, numbers.facing_cosine)
        and other.score < top.score + numbers.clear_nats
        for other in path.ends[1:]
    )


def _start_frames(tools: MarkerTools, frames: range, points_of: PointsOf) -> list[tuple[int, Array]]:
    """Frames of the first seconds with many steady points, but apart from each other, and their points (K, 3) m."""
    numbers, settings = tools.settings.method.marker_start, tools.settings
    window = numbers.window_s * tools.fps
    usable: list[tuple[int, Array]] = []
    for frame in frames[:: max(1, round(window / numbers.n_window_looks))]:
        if usable and frame - usable[0][0] > window:
            break
        points = steady_points(points_of, frame, frames, numbers.steady_m)
        if len(points) >= numbers.min_points:
            usable.append((frame, points))
    chosen: list[tuple[int, Array]] = []
    apart = window / (2 * settings.n_start_frames)
    for frame, points in sorted(usable, key=lambda entry: -len(entry[1])):
        if all(abs(frame - other) >= apart for other, _ in chosen):
            chosen.append((frame, points))
        if len(chosen) == settings.n_start_frames:
            break
    return chosen


@dataclass(frozen=True, eq=False)
class MarkerClip(PersonClip):
    """A person seen by detections."""

    observation: MarkerClipObservation

    @property
    def span(self) -> range:
        """The frames, which follow each other."""
        return range(int(self.frames[0]), int(self.frames[-1]) + 1)


def _clip(frames: range, observation: MarkerClipObservation, person: int) -> MarkerClip:
    return MarkerClip(person, np.array(frames, dtype=np.int64), None, observation)


def _faces_alike(body: Body, a: Array, b: Array, cosine: float) -> bool:
    yaw = body.yaw_column
    return yaw is None or bool(np.cos(a[yaw] - b[yaw]) > cosine)


def _beam_both_ways(
    clip: MarkerClip,
    start: int,
    state: Array,
    stage: str,
    *,
    seed: int,
    tick: Callable[[], None],
) -> BeamPath:
    """The best path from the start to the end of some frames and back to their beginning, in ascending order."""
    tools, observation_of = clip.observation.tools, clip.observation.observation_of
    frames, person = clip.span, clip.person
    numbers = tools.settings.method.marker_start
    points_of = points_of_frames(observation_of, numbers.max_error_px)

    def restart(frame: int) -> Sequence[Fit]:
        points = steady_points(points_of, frame, frames, numbers.steady_m)
        if len(points) < numbers.min_points:
            return ()
        rng = rng_for(seed, f"{stage}-restart", person, frame)
        n = tools.judged_by.n_hypotheses
        return find_starts(tools, observation_of(frame), points, frame, n=n, rng=rng).fits

    later, earlier = (
        follow_beam(
            clip,
            order,
            [state],
            rng_of=lambda frame, name=f"{stage}{way}": rng_for(seed, name, person, frame),  # type: ignore[misc]
            n_hypotheses=tools.judged_by.n_hypotheses,
            restart=restart,
            tick=tick,
        )
        for way, order in both_ways(len(frames), start - frames.start)
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
) -> tuple[MarkerTools, Array]:
    """Body and markers fitted to frames of the window, spread evenly, and the pose at the start with them."""
    numbers, n_frames = tools.settings.method.marker_start, tools.judged_by.fit_frames
    seen = [i for i in range(len(window)) if path.is_seen[i]]
    if not seen:
        return tools, path.states[start - window.start]
    # Frames whose pose explains little are likely to be wrong in a limb.
    enough = np.median(path.gain[seen]) * numbers.good_share
    good = [i for i in seen if path.gain[i] >= enough]
    rows = sorted({good[k] for k in np.linspace(0, len(good) - 1, n_frames).astype(int)})
    observations = [observation_of(window[i]) for i in rows]
    fit = replace(tools.fit_problem(observations[0]).settings, reach_m=numbers.bundle_reach_m)
    bundle = bundle_markers(tools.body, tools.markers, observations, path.states[rows], fit, BundleSettings())
    fitted = replace(tools, body=bundle.body, markers=bundle.markers)
    return fitted, fitted.fit(observation_of(start), path.states[start - window.start], tools.wide).state


@dataclass(frozen=True, eq=False)
class _Walk:
    """Poses of all frames before they are smoothed.

    states : (T, D).  ess_share : (T,).  is_seen : (T,).  observed : (T, 15).  information : (T, D, D) of refined poses,
    0 where nothing is seen, or None.  spread : (T, M, 3, 3) m^2 of the particles, or None.
    """

    states: Array
    ess_share: Array
    is_seen: NDArray[np.bool_]
    observed: NDArray[np.bool_]
    information: Array | None = None
    spread: Array | None = None


def _walk_of_beam(tools: MarkerTools, path: BeamPath) -> _Walk:
    """The path with what its matches tell."""
    D = tools.body.layout.n_columns
    matched = [f.problem if f and f.is_seen else None for f in path.fits]
    information = np.zeros((len(path.states), D, D))
    for i, problem in enumerate(matched):
        if problem is not None:
            information[i] = problem.normal_equations(path.states[i])[1]
    return _Walk(
        states=path.states,
        ess_share=path.ess_share,
        is_seen=np.array([m is not None for m in matched], dtype=np.bool_),
        observed=np.array([observed_landmarks(tools, m) for m in matched]),
        information=information,
    )


def _filtered(clip: MarkerClip, prepared: Prepared, *, seed: int, tick: Callable[[], None]) -> _Walk:
    """The filter alone, as published: its estimates both ways from the start.  Source: CF 6.4."""
    tools, observation = clip.observation.tools, clip.observation
    alone = replace(tools, settings=replace(tools.settings, look_again=False))
    clip = replace(clip, observation=replace(observation, tools=alone))
    start, state = prepared.frame - clip.span.start, prepared.state
    poses: dict[int, FramePose] = {}
    for way, order in both_ways(len(clip), start):
        # The start is settled on the way forward; the way back goes on from it.
        rows = order if not poses else order[1:]
        for pose in follow_pose(clip, rows, state, seed=seed, stage=f"pose{way}", forgets=True):
            poses[pose.row] = pose
            tick()
        state = poses[start].state
    walked = [poses[row] for row in range(len(clip))]
    return _Walk(
        states=np.array([pose.state for pose in walked]),
        ess_share=np.array([pose.ess_share for pose in walked]),
        is_seen=np.isfinite([pose.log_likelihood for pose in walked]),
        observed=np.array([pose.observed for pose in walked]),
        spread=np.array([pose.spread for pose in walked]),
    )


def finish_markers(followed: FollowedPerson) -> PersonPoses:
    """Poses of a person who was followed: smoothed where that is set, with their uncertainty and warnings."""
    tools, series = followed.tools, followed.series
    assert isinstance(tools, MarkerTools)
    body, is_seen = tools.body, np.isfinite(series.log_likelihood)
    if followed.information is not None:
        pieces = unbroken(followed.frames)
        smoothed = [_smoothed(tools, series.states[p], followed.information[p], is_seen[p]) for p in pieces]
        states, spread = (np.concatenate(parts) for parts in zip(*smoothed, strict=True))
    else:
        blind = _blind_variance(tools, is_seen)
        states, spread = series.states, series.fit_covariance + blind[:, None, None, None] * np.eye(3)
    return PersonPoses(
        person=followed.person,
        body=body,
        height=followed.height,
        frames=followed.frames,
        states=states,
        landmarks=landmarks_of(body, states),
        landmark_covariance=spread + tools.settings.method.marker_fit.model_std_m**2 * np.eye(3),
        observed=series.observed,
        log_likelihood=series.log_likelihood,
        ess_share=series.ess_share,
        start_frame=followed.start_frame,
        first_pose=followed.first_pose,
        warnings=_warnings_of(followed),
    )


def _warnings_of(followed: FollowedPerson) -> tuple[str, ...]:
    person, height, warnings = followed.person, followed.height, []
    if followed.is_facing_open:
        warnings.append(
            f"person {person}: it is not clear which way the person faces (two poses explain the detections almost "
            "equally well); left and right may be exchanged"
        )
    if not height.is_measured:
        warnings.append(
            f"person {person}: the standing height could not be read from the markers; {height.height_m:.2f} m was "
            "taken. Remedy: set person_height_m in session.toml"
        )
    warnings += followed.warnings
    n_blind = len(followed.frames) - followed.n_usable
    if n_blind:
        warnings.append(
            f"person {person}: too few detections in {n_blind} of {len(followed.frames)} frames; the pose was carried "
            "on there and its landmarks are marked as not observed"
        )
    return tuple(warnings)


def _smoothed(
    tools: MarkerTools, states: Array, information: Array, is_seen: NDArray[np.bool_]
) -> tuple[Array, Array]:
    """States (T, D) smoothed over time, where that is asked for, and the covariance of their landmarks (T, M, 3, 3)
    m^2."""
    body, numbers = tools.body, tools.settings.method.marker_fit
    per_s2 = np.where(body.is_position, numbers.acceleration_m_s2, numbers.acceleration_rad_s2)
    smoothed, covariance = smooth_states(states, information, per_s2 / tools.fps**2, body.layout.is_circular)
    covariance = within_limits(body.layout, covariance)
    is_smooth = tools.judged_by.smooth
    if is_smooth:
        states = np.clip(smoothed, body.layout.lower, body.layout.upper)
    spread = np.empty((len(states), len(body.landmarks), 3, 3))
    for i in range(len(states)):
        if not is_smooth and is_seen[i]:
            covariance[i] = np.linalg.inv(information[i] + np.diag(tools.noise_std**-2.0))
        _, J, _ = point_jacobian(body, states[i], body.landmark_joint, body.landmark_offset)
        spread[i] = np.einsum("lri,ij,lcj->lrc", J, covariance[i], J)
    return states, spread


def _blind_variance(tools: MarkerTools, is_seen: NDArray[np.bool_]) -> Array:
    """Variance that a pose gains with every frame that it is carried on, (T,) m^2."""
    rows = np.arange(len(is_seen))
    seen = np.flatnonzero(is_seen)
    if not len(seen):
        return np.full(len(is_seen), np.inf)
    distance = np.abs(rows[:, None] - seen[None]).min(axis=1)
    return (distance * float(tools.noise_std[0])) ** 2


def _other_persons(prepared: Prepared, frames: range, states: Array) -> list[str]:
    """A warning when many steady points lie where the person is not."""
    looked = {f: p for f, p in prepared.points.items() if len(p)}
    if not looked:
        return []
    numbers = prepared.tools.settings.method.marker_start
    n_far = [
        int((np.linalg.norm(p[:, :2] - states[f - frames.start][:2], axis=1) > numbers.other_person_m).sum())
        for f, p in looked.items()
    ]
    if np.mean(np.array(n_far) >= numbers.other_points) < numbers.other_share:
        return []
    return [
        f"more than one person seems to wear markers; only one of them is followed (person {prepared.person}). Remedy: "
        "record one person at a time, or use --observation voxels"
    ]


def flesh_centroids(body: Body, states: Array) -> Array:
    """Centre of the flesh of states (T, D), (T, 3) m, world: what `tracks.csv` holds."""
    out = np.empty((len(states), 3))
    for i, state in enumerate(states):
        start, end = cones_of(body, state)
        weight = np.linalg.norm(end - start, axis=1) * (body.cones.radii**2).mean(axis=1)
        out[i] = weight @ (0.5 * (start + end)) / weight.sum()
    return out
