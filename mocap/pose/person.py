"""The pose of one person over a clip of volumes: start, size, both directions, repair, smoothing."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from itertools import chain

import numpy as np
from numpy.typing import NDArray

from mocap.body import landmarks_of
from mocap.body.initial import HeightEstimate, head_top, is_low
from mocap.body.model import Cones
from mocap.data import LANDMARKS
from mocap.forks import in_processes, shared_zeros
from mocap.pose.deviation import FrameSeries, fit_covariance, landmark_covariances
from mocap.pose.evidence import FrameEvidence, PersonClip
from mocap.pose.follow import FramePose, follow_both_ways, follow_pose, note, on_threads, unbroken
from mocap.pose.limbs import in_doubt
from mocap.pose.load import arms_alike, bare, find_load, laden
from mocap.pose.method import LoadSettings, StartSettings
from mocap.pose.repair import EvidenceOf, repair_limbs
from mocap.pose.result import FollowedPerson, PersonPoses, warnings_of_volumes
from mocap.pose.size import fit_size
from mocap.pose.smooth import smooth_motion
from mocap.pose.start import (
    FirstPose,
    PoseSearch,
    affordable_first_poses,
    against_walking,
    heading_of,
    settle_first_poses,
    try_first_poses,
    walking_velocity,
)
from mocap.pose.texture import settle_on_texture
from mocap.pose.turns import carry_over_turns
from mocap.pose.volume import VolumeEvidence, VolumeObservation, VolumeTools
from mocap.profiling import part
from mocap.rng import rng_for

Array = NDArray[np.float64]

# Made ready for repairs, which come back to a frame with another limb, from its other side, and to put it right.
_KEPT_FRAMES = 32


@dataclass(frozen=True, eq=False)
class VolumeClip(PersonClip):
    """A person seen by volumes."""

    observation: VolumeObservation

    def with_tools(self, tools: VolumeTools) -> VolumeClip:
        """The same clip judged by other tools, without colours."""
        return replace(self, observation=self.observation.with_tools(tools))


@dataclass(frozen=True, eq=False)
class Start:
    """A person ready to be followed.  trial : (K,) mean evidence of the starting hypotheses that were compared.
    n_usable : frames with a usable hull.  is_sized : the size was fitted to poses.
    """

    tools: VolumeTools
    height: HeightEstimate
    first: FirstPose
    trial: Array
    n_usable: int
    is_sized: bool


def start_person(
    clip: VolumeClip, height: HeightEstimate, *, seed: int, is_size_fitted: bool = False
) -> Start:
    """First pose and size of one person; the arguments and errors are those of `follow_person`.

    Of a hull that is no higher than a tall man who sits both are tried, somebody of the usual size, who may sit or
    crouch, and somebody as small as the hull is high, who stands; who walks or stands does not sit. With more threads
    than one it forks: see `in_processes` for where it may be called.
    """
    usual = _started(clip, replace(height, low_m=None), seed=seed, is_size_fitted=is_size_fitted)
    if height.low_m is None:
        return usual
    tools = clip.observation.tools
    resized = clip.with_tools(tools.resized(height.low_m / tools.body.height_m))
    small = _started(resized, HeightEstimate(height.low_m, True), seed=seed, is_size_fitted=is_size_fitted)
    gain = _likelihood(clip, small) - _likelihood(clip, usual)
    numbers, row = tools.settings.method.start, int(np.searchsorted(clip.frames, usual.first.frame))
    is_walking = heading_of(walking_velocity(clip, row, numbers), numbers) is not None
    may_sit = not is_walking and not _stands(usual, numbers)
    return small if gain > (numbers.small_nats if may_sit else 0.0) else usual


def _likelihood(clip: VolumeClip, start: Start) -> float:
    """Log-likelihood of a first pose with the outlines as heavy as usual: where they are not all of the person they
    count for less, and a body that leaves much unexplained would gain by it."""
    usual, own = clip.observation.tools.settings, start.tools.settings
    if own.outline_weight == usual.outline_weight:
        return start.first.log_likelihood
    tools = replace(start.tools.without_floor, settings=usual)
    search = _search_at(clip.with_tools(tools), int(np.searchsorted(clip.frames, start.first.frame)))
    return float(search.judge([start.first.state])[0])


def _stands(start: Start, numbers: StartSettings) -> bool:
    """Whether the pelvis of a first pose is as high above the floor as of somebody who stands."""
    body = start.tools.body
    pelvis_m = landmarks_of(body, start.first.state[None])[0, LANDMARKS.index("pelvis"), 2]
    return bool(pelvis_m > numbers.pelvis_share * body.height_m)


def _started(clip: VolumeClip, height: HeightEstimate, *, seed: int, is_size_fitted: bool) -> Start:
    """First pose and size of somebody of whom it is known, or presumed, how tall he is."""
    followed, frames = clip.observation.tools, clip.frames
    tools = followed.without_floor  # a foot that is lifted explains outlines less well than one that is lost
    usable = [i for i in range(len(clip)) if clip.observation.is_usable(int(frames[i]))]
    if not usable:
        raise ValueError(f"person {clip.person} has no frame with a usable hull")
    numbers = tools.settings.method.start
    rows = _where_to_start(clip, usable, height)
    # Where no motion will tell front from back, or a flat hull head from feet: look harder.
    is_hard = len(usable) < numbers.short_frames or any(_is_low(clip, row) for row in rows)
    factor = numbers.short_factor if is_hard else 1
    n_frames = min(tools.settings.n_start_frames, len(usable))
    n_first = affordable_first_poses(numbers, factor * tools.settings.n_first_poses, n_frames)
    searching = replace(tools, settings=replace(tools.settings, n_first_poses=n_first))
    with part("first poses"):
        promising = _most_promising(clip.with_tools(searching), rows, seed=seed)

    def settled(search: PoseSearch, tried: Sequence[FirstPose]) -> list[FirstPose]:
        rng = rng_for(seed, "settle", clip.person, search.frame)
        with part("settle"):
            return settle_first_poses(search, tried, rng=rng)

    search, tried, hypotheses = _best_explained(promising, settled, numbers)
    evidence = search.evidence
    assert isinstance(evidence, VolumeEvidence)  # the clip is one of volumes
    is_crowded = evidence.is_crowded(hypotheses[0].state)
    gentle = numbers.crowded_outline_weight
    if is_crowded and tools.settings.outline_weight > gentle:
        # The silhouettes hold more than the person, a chair perhaps: their outlines are not all his.
        tools = replace(tools, settings=replace(tools.settings, outline_weight=gentle))
        searching = replace(searching, settings=replace(searching.settings, outline_weight=gentle))
        row = int(np.searchsorted(frames, search.frame))
        hypotheses = settled(_search_at(clip.with_tools(searching), row), tried)
    clip = clip.with_tools(tools)
    with part("trial"):
        best, trial = choose_hypothesis(clip, hypotheses, seed=seed)
    is_sized = is_size_fitted and not is_crowded  # a larger body would explain the chair as well
    if is_sized:
        with part("size"):
            tools, height, best = _sized(clip, height, best, seed=seed)
    return Start(replace(tools, surface_fit=followed.surface_fit), height, best, trial, len(usable), is_sized)


def _is_low(clip: VolumeClip, row: int) -> bool:
    """Whether the person lies in a row of a clip, or is on hands and knees."""
    tools, hull = clip.observation.tools, clip.observation.hull_of(int(clip.frames[row]))
    return hull is not None and is_low(tools.grid.centers(hull.voxels), tools.body)


def _search_at(clip: VolumeClip, row: int) -> PoseSearch:
    """The search for a first pose in a row of a clip that has a usable hull."""
    frame = int(clip.frames[row])
    prepared = clip.observation.prepare(frame)
    assert prepared is not None
    velocity = walking_velocity(clip, row, clip.observation.tools.settings.method.start)
    return PoseSearch(clip.observation.evidence(prepared), frame, velocity)


def _where_to_start(clip: VolumeClip, usable: Sequence[int], height: HeightEstimate) -> list[int]:
    """Rows in which a first pose is looked for: some of those around the middle of the clip, or around the row nearest
    to it in which the person stands.

    Who sits or crouches says less of how large he is.
    """
    observation, settings = clip.observation, clip.observation.tools.settings
    numbers, frames, grid = settings.method.start, clip.frames, observation.tools.grid

    def stands(row: int) -> bool:
        hull = observation.hull_of(int(frames[row])) if height.is_measured else None
        if hull is None:
            return False
        top_m = head_top(grid.centers(hull.voxels), grid.voxel_size_m)
        return top_m > numbers.standing_share * height.height_m

    middle = usable[len(usable) // 2]
    by_nearness = sorted(
        _spread(usable, numbers.height_frames), key=lambda row: abs(frames[row] - frames[middle])
    )
    around = next(filter(stands, [middle, *by_nearness]), middle)
    reach = 0.5 * numbers.window_s * observation.tools.fps
    window = [row for row in usable if abs(frames[row] - frames[around]) <= reach]
    rows = _spread(window, settings.n_start_frames)
    if not all(map(stands, rows)):
        rows = _spread(list(filter(stands, window)) or window, settings.n_start_frames)
    return rows


def _spread(rows: Sequence[int], n: int) -> list[int]:
    """At most n of the rows, evenly spread."""
    return [rows[k] for k in np.unique(np.linspace(0, len(rows) - 1, n).astype(int))]


def _most_promising(
    clip: VolumeClip, rows: Sequence[int], *, seed: int
) -> list[tuple[PoseSearch, list[FirstPose]]]:
    """Some rows with the poses tried there, those in which a first pose promises most first."""
    searches = []
    for row in rows:
        search = _search_at(clip, row)
        rng = rng_for(seed, "first-pose", clip.person, search.frame)
        searches.append((search, try_first_poses(search, rng=rng)))
    return sorted(searches, key=lambda entry: -entry[1][0].log_likelihood)


def _best_explained(
    promising: Sequence[tuple[PoseSearch, list[FirstPose]]],
    settled: Callable[[PoseSearch, list[FirstPose]], list[FirstPose]],
    numbers: StartSettings,
) -> tuple[PoseSearch, list[FirstPose], list[FirstPose]]:
    """The frame that its poses explain best once they are settled, with those tried and settled there: of the most
    promising ones, as many as it takes until two are explained alike. A search that was caught in a wrong pose gives
    itself away by what another frame has.
    """
    found: list[tuple[PoseSearch, list[FirstPose], list[FirstPose]]] = []
    for search, tried in promising:
        found.append((search, tried, settled(search, tried)))
        found.sort(key=lambda entry: -entry[2][0].log_likelihood)
        best, *others = (poses[0].log_likelihood for _, _, poses in found)
        if others and best < others[0] + numbers.same_nats:
            break
    return found[0]


def choose_hypothesis(
    clip: VolumeClip, hypotheses: Sequence[FirstPose], *, seed: int
) -> tuple[FirstPose, Array]:
    """The hypothesis that explains the seconds around its start best, and the mean log-likelihood of each, (K,).

    Each is followed over every third frame with few particles. Front and back look alike in one frame; knees and
    elbows that bend, and the way that the person goes, tell them apart over time.
    """
    tools, frames = clip.observation.tools, clip.frames
    numbers = tools.settings.method.start
    settled = np.array([h.log_likelihood for h in hypotheses])
    if len(clip) < numbers.short_frames:
        return hypotheses[0], settled
    decisive = max(numbers.decisive_nats, -numbers.decisive_share * settled[0])
    if len(hypotheses) == 1 or settled[0] > settled[1] + decisive:
        return hypotheses[0], settled[:1]
    stride = numbers.trial_stride_frames
    brisk = tools.brisk(numbers.trial_layers, numbers.trial_particles, stride, refine=True)
    quick = clip.with_tools(brisk)
    reach = round(numbers.trial_s * tools.fps)

    def worth(pose: FramePose) -> float:
        heading = heading_of(walking_velocity(clip, pose.row, numbers), numbers)
        return pose.evidence - float(against_walking(tools.body, pose.state[None], heading, numbers)[0])

    ways = []
    for hypothesis in hypotheses:
        start = int(np.searchsorted(frames, hypothesis.frame))
        later = range(start, min(len(clip), start + reach), stride)
        earlier = range(start, max(-1, start - reach), -stride)
        ways += [(hypothesis.state, later), (hypothesis.state, earlier)]
    poses = _looked_at(quick, ways, seed=seed, stage="trial")
    values = np.array(
        [
            np.nanmean([worth(pose) for pose in (*later, *earlier)])
            for later, earlier in zip(poses[::2], poses[1::2], strict=True)
        ]
    )
    return hypotheses[int(values.argmax())], values


def _looked_at(
    quick: VolumeClip, ways: Sequence[tuple[Array, range]], *, seed: int, stage: str
) -> list[list[FramePose]]:
    """The poses along several ways through a clip, side by side where there are threads for it.

    ways : each the pose (D,) that it begins with, and the rows in its order.
    """
    n_threads = quick.observation.tools.n_threads
    own = on_threads(quick, max(1, n_threads // len(ways)))

    def poses_of(way: tuple[Array, range]) -> list[FramePose]:
        first, order = way
        return list(follow_pose(own, order, first, seed=seed, stage=stage))

    return in_processes(poses_of, ways, n_threads)


def follow_person(
    clip: VolumeClip,
    height: HeightEstimate,
    *,
    seed: int,
    is_size_fitted: bool = False,
    progress: Callable[[int], None] | None = None,
) -> PersonPoses:
    """Poses of one person over the frames of its track: `follow_frames`, then `finish_person`."""
    return finish_person(
        follow_frames(clip, height, seed=seed, is_size_fitted=is_size_fitted, progress=progress)
    )


def follow_frames(
    clip: VolumeClip,
    height: HeightEstimate,
    *,
    seed: int,
    is_size_fitted: bool = False,
    progress: Callable[[int], None] | None = None,
) -> FollowedPerson:
    """One person over the frames of its track, followed and repaired.

    clip : the person's track and hulls, with a body of the given height in its tools.
    The first pose is looked for in a few frames in the middle, or as near to it as the person stands; the filter runs
    from the best of them to the end, and back to the beginning.
    is_size_fitted : girths and, where it was not given, the size are fitted to some frames around the first pose, as
    `height` is only the highest place of the head, and changes with it; of who never stands to frames of the whole clip
    besides, and he is followed once more.
    Raises ValueError when no frame has a usable hull.
    """
    followed = _follow_body(clip, height, seed=seed, is_size_fitted=is_size_fitted, progress=progress)
    usual, numbers = clip.observation.tools, followed.tools.settings.method.load
    if not np.nanmedian(followed.series.unexplained) > numbers.unexplained_share:
        return followed
    thing = "wears or holds something, a rucksack or a box perhaps: it counts as no part of the body"
    dressed: VolumeClip | None = None
    for _ in range(numbers.n_times):  # a limb that was lost in it shows how far it goes, once it is found
        load = _load_of(clip, followed, numbers)
        if load is None:
            break
        dressed = clip.with_tools(usual.with_body(laden(usual.body, load)))
        again = _follow_body(dressed, height, seed=seed, is_size_fitted=is_size_fitted)
        tools = _volume_tools(again).with_body(bare(again.body, load))
        followed = replace(again, tools=tools, warnings=(*again.warnings, f"person {clip.person} {thing}"))
        dressed = dressed.with_tools(_volume_tools(again))
    if dressed is not None:
        with part("load"):
            _doubt_arms(dressed, followed.series)
    return followed


def _doubt_arms(clip: VolumeClip, series: FrameSeries) -> None:
    """Mark, in place, an arm of somebody who holds something, where his other arm's place explains a frame about as
    well: along a box one place is like another."""
    for row, frame in enumerate(clip.frames):
        prepared, state = clip.observation.prepare(int(frame)), series.states[row]
        if prepared is None or not np.isfinite(state).all():
            continue
        evidence = clip.observation.evidence(prepared)
        own, *rivals = evidence.all_refined([state, *arms_alike(clip.observation.tools.body, state)])
        nats = evidence.evidence([own, *rivals])
        for rival, worth in zip(rivals, nats[1:], strict=True):
            if worth > nats[0] - evidence.tools.settings.method.legs.clear_nats:
                _doubt(series, row, state, rival, evidence)


def _doubt(series: FrameSeries, row: int, state: Array, rival: Array | None, evidence: FrameEvidence) -> None:
    """Mark, in place, what of a state (D,) in a row is in doubt as a rival (D,) explains the frame about as well."""
    doubtful, doubt_std = in_doubt(evidence.tools.body, state, rival, evidence.tools.settings.method.legs)
    series.hidden_std[row] = np.maximum(series.hidden_std[row], doubt_std)
    series.doubtful[row] |= doubtful
    series.observed[row] &= ~series.doubtful[row]


def _volume_tools(followed: FollowedPerson) -> VolumeTools:
    """The tools of a person who was followed in volumes."""
    assert isinstance(followed.tools, VolumeTools)
    return followed.tools


def _load_of(clip: VolumeClip, followed: FollowedPerson, numbers: LoadSettings) -> Cones | None:
    """What a person who was followed wears or holds."""
    with part("load"):
        observation = clip.observation.with_tools(_volume_tools(followed))
        return find_load(observation, followed.frames, followed.series.states, numbers)


def _follow_body(
    clip: VolumeClip,
    height: HeightEstimate,
    *,
    seed: int,
    is_size_fitted: bool,
    progress: Callable[[int], None] | None = None,
) -> FollowedPerson:
    """One person with the body that the clip's tools have; arguments as of `follow_frames`."""
    with part("start"):
        start = start_person(clip, height, seed=seed, is_size_fitted=is_size_fitted)
    tools, settings = start.tools, start.tools.settings
    observation = clip.observation.with_tools(tools)
    if settings.refine:
        observation = observation.learning()
    clip = replace(clip, observation=observation)
    series = _followed(clip, start.first, seed=seed, progress=progress)
    if start.is_sized and not start.height.is_measured:
        with part("size"):
            again = _sized_anew(clip, series, start)
        if again is not None:
            start, tools = again, again.tools
            clip = replace(clip, observation=clip.observation.with_tools(tools).learning())
            series = _followed(clip, start.first, seed=seed, progress=None)
    trial, numbers = start.trial, settings.method.start
    return FollowedPerson(
        person=clip.person,
        tools=tools,
        height=start.height,
        frames=clip.frames,
        series=series,
        is_facing_open=len(trial) > 1 and bool(abs(trial[0] - trial[1]) < numbers.clear_facing_nats),
        n_usable=start.n_usable,
        start_frame=start.first.frame,
        first_pose=start.first.label,
    )


def finish_person(followed: FollowedPerson) -> PersonPoses:
    """The poses of a person who was followed: smoothed where that is set, with deviations and warnings."""
    tools, series = followed.tools, followed.series
    settings = tools.settings
    states = series.states
    if settings.smooth_lag_frames:
        lag, method = settings.smooth_lag_frames, settings.method
        pieces = [series.rows(piece) for piece in unbroken(followed.frames)]
        with part("smooth"):
            states = np.concatenate([smooth_motion(tools.body, p, tools.fps, lag, method) for p in pieces])
    warnings = warnings_of_volumes(
        followed.person,
        n_blind=len(followed.frames) - followed.n_usable,
        series=series,
        frames=followed.frames,
        height=followed.height,
        is_facing_open=followed.is_facing_open,
        crowded_share=settings.method.start.crowded_share,
    )
    return PersonPoses(
        person=followed.person,
        body=tools.body,
        height=followed.height,
        frames=followed.frames,
        states=states,
        landmarks=landmarks_of(tools.body, states),
        landmark_covariance=landmark_covariances(tools.body, series, settings.method.deviation),
        observed=series.observed,
        log_likelihood=series.log_likelihood,
        ess_share=series.ess_share,
        start_frame=followed.start_frame,
        first_pose=followed.first_pose,
        warnings=(*followed.warnings, *warnings),
        series=series,
    )


def _followed(
    clip: VolumeClip, first: FirstPose, *, seed: int, progress: Callable[[int], None] | None
) -> FrameSeries:
    """The poses of all frames, from the first one to the end and back to the beginning, repaired where that is set."""
    tools = clip.observation.tools
    series, appearance = FrameSeries.of_length(len(clip), tools.body), clip.observation.appearance
    of_way_back = shared_zeros((0,) if appearance is None else appearance.counts.shape, np.float32)

    def take(pose: FramePose) -> None:
        note(series, pose.row, pose, tools)

    def leave(back: VolumeClip) -> None:
        if back.observation.appearance is not None:
            of_way_back[:] = back.observation.appearance.counts

    learnt = follow_both_ways(clip, first, seed=seed, take=take, leave=leave, progress=progress)
    if tools.settings.look_again:
        with part("turns"):
            carry_over_turns(clip, series, partial(_looked_at, clip, seed=seed, stage="turn"))
    if tools.settings.repair and tools.settings.refine:
        # Where a limb was lost it has taught its own colours; on the other way it had its own place.
        observation = learnt.observation.knowing(of_way_back)
        with part("repair"):
            _repair(replace(learnt, observation=observation), series)
    if tools.settings.texture_weight > 0 and tools.settings.refine:
        with part("texture"):
            settle_on_texture(clip, series)
    return series


def _shifted(evidence_of: EvidenceOf, by: int) -> EvidenceOf:
    return lambda row: evidence_of(by + row)


def _repair(clip: PersonClip, series: FrameSeries) -> None:
    """Carry limbs over jumps between frames that follow each other, in place, with the colours that are known now."""
    tools = clip.observation.tools

    @lru_cache(_KEPT_FRAMES)
    def evidence_of(row: int) -> FrameEvidence | None:
        prepared = clip.observation.prepare(int(clip.frames[row]))
        return None if prepared is None else clip.observation.evidence(prepared)

    numbers = tools.settings.method.repair
    repaired: dict[int, Array] = {}
    for piece in unbroken(clip.frames):
        found = repair_limbs(
            tools.body, series.states[piece], tools.fps, _shifted(evidence_of, piece.start), numbers
        )
        repaired |= {piece.start + row: state for row, state in found.items()}
    for row, state in repaired.items():
        evidence = evidence_of(row)
        if evidence is not None:
            _put_right(series, row, state, evidence)


def _put_right(series: FrameSeries, row: int, state: Array, evidence: FrameEvidence) -> None:
    """Another state (D,) in a row of the series; what the old one explains about as well is in doubt."""
    body, method = evidence.tools.body, evidence.tools.settings.method
    fit, old = evidence.fit(state), series.states[row].copy()
    new_nats, old_nats = evidence.evidence([state, old])
    is_clear = new_nats > old_nats + method.legs.clear_nats
    series.states[row] = state
    series.fit_covariance[row] = fit_covariance(body, state, fit.information, method.deviation)
    series.misfit[row] = fit.misfit
    series.unexplained[row] = fit.unexplained
    series.log_likelihood[row] = fit.log_likelihood
    series.observed[row] = fit.observed
    _doubt(series, row, state, None if is_clear else old, evidence)


def _sized(
    clip: VolumeClip, height: HeightEstimate, first: FirstPose, *, seed: int
) -> tuple[VolumeTools, HeightEstimate, FirstPose]:
    """Tools, height and first pose of a person whose size is fitted to a few frames around the first pose."""
    tools, frames = clip.observation.tools, clip.frames
    numbers, trial = tools.settings.method.size, tools.settings.method.start
    start = int(np.searchsorted(frames, first.frame))
    stride = max(1, round(numbers.stride_s * tools.fps))
    brisk = tools.brisk(trial.trial_layers, trial.trial_particles, stride, refine=True)
    quick = clip.with_tools(brisk)
    reach = stride * numbers.n_frames
    later = range(start, min(len(clip), start + reach), stride)
    earlier = range(start - stride, max(-1, start - reach), -stride)
    ways = [(first.state, later), (first.state, earlier)]
    poses = chain.from_iterable(_looked_at(quick, ways, seed=seed, stage="sizing"))
    seen = [pose for pose in poses if np.isfinite(pose.evidence)]
    if not seen:
        return tools, height, first
    # The frames that are explained best: a limb that is lost says nothing of the size.
    seen = sorted(seen, key=lambda pose: -pose.evidence)[: numbers.n_frames]
    sized = _resized(clip, [(pose.row, pose.state) for pose in seen], height)
    if np.array_equal(sized.body.cones.radii, tools.body.cones.radii):
        return tools, height, first  # of the usual girth, and the height was given
    prepared = clip.observation.prepare(first.frame)
    again = clip.observation.with_tools(sized)
    state = first.state if prepared is None else again.evidence(prepared).refined(first.state)
    height = replace(height, height_m=sized.body.height_m)
    return sized, height, replace(first, state=state)


def _resized(clip: VolumeClip, poses: Sequence[tuple[int, Array]], height: HeightEstimate) -> VolumeTools:
    """Tools of the size that poses (D,) in some rows of a clip tell.  height : what is known of it."""
    problems, states = [], []
    for row, state in poses:
        prepared = clip.observation.prepare(int(clip.frames[row]))
        if prepared is not None:
            problems.append(clip.observation.evidence(prepared))
            states.append(state)
    fit = fit_size(problems, states, is_head_seen=height.is_measured, is_given=height.is_given)
    return clip.observation.tools.resized(fit.factor, fit.radii)


def _sized_anew(clip: VolumeClip, series: FrameSeries, start: Start) -> Start | None:
    """A start with the size that the best poses of the whole clip tell, at the best of them; None where it is the same.

    Of who never stands no height is known, and a size that was fitted to poses only just found makes up for what is
    wrong with them.
    """
    numbers = start.tools.settings.method.size
    worth = series.log_likelihood - series.misfit.sum(axis=1)
    worth[~np.isfinite(worth)] = -np.inf
    stretches = np.array_split(np.arange(len(clip)), min(numbers.n_frames, len(clip)))
    best = [int(rows[worth[rows].argmax()]) for rows in stretches]
    rows = sorted((row for row in best if np.isfinite(worth[row])), key=lambda row: -worth[row])
    if not rows:
        return None
    free = clip.with_tools(start.tools.without_floor)
    sized = _resized(free, [(row, series.states[row]) for row in rows], start.height)
    if abs(np.log(sized.body.height_m / start.tools.body.height_m)) < numbers.same_size:
        return None
    first = replace(start.first, frame=int(clip.frames[rows[0]]), state=series.states[rows[0]])
    tools = replace(sized, surface_fit=start.tools.surface_fit)
    return replace(
        start, tools=tools, height=replace(start.height, height_m=sized.body.height_m), first=first
    )
