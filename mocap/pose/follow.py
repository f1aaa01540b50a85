"""Follower: one person's pose carried through the frames of a clip, whatever the frames show.

`follow` is the loop, once for every observation; a `Policy` says what happens in a frame: poses are carried over,
proposed by the filter, refined and judged, limbs are searched for, a lost body is restarted, and what the next frame
needs is remembered. `OnePose` is the policy of volumes; `beam.Beam`, with several hypotheses, that of detections.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from mocap.body import Body, landmarks_of
from mocap.body.average import mean_state
from mocap.body.kinematics import facing_of
from mocap.filters import FILTERS, FilterInfo, ParticleState, initial_particles
from mocap.forks import can_fork, forked
from mocap.geometry.rigid import wrap_angle
from mocap.pose.deviation import FrameSeries, fit_covariance
from mocap.pose.evidence import FrameEvidence, PersonClip, PersonTools, WholeBodyEvidence
from mocap.pose.limb_search import LimbSchedule, search_limbs
from mocap.pose.limbs import in_doubt, legs_exchanged
from mocap.pose.restart import FallenEvidence, restarted_pose
from mocap.pose.start import (
    FirstPose,
    PoseSearch,
    faces_other_way,
    heading_of,
    settle_first_poses,
    try_first_poses,
    walking_velocity,
)
from mocap.profiling import part
from mocap.rng import rng_for
from mocap.threads import worker_threads

Array = NDArray[np.float64]
T_co = TypeVar("T_co", covariant=True)
Clip = TypeVar("Clip", bound=PersonClip)


@dataclass(frozen=True, eq=False)
class Candidate:
    """A pose that may be the frame's.

    parent : row of the hypothesis that it goes on from.  value : evidence, nats, nan while it is not judged.
    fit : what its refinement found, for policies that keep it.
    """

    state: Array
    parent: int = 0
    value: float = float("nan")
    fit: Any = None


Candidates = list[Candidate]


class Policy(Protocol[T_co]):
    """What a follower does in one frame; what it remembers from frame to frame is its own."""

    def carry(self, row: int, evidence: FrameEvidence) -> Candidates | None:
        """The poses of the frame before, moved on; None where too little is seen to judge any."""
        ...

    def lose_sight(self, row: int) -> T_co:
        """The frame's result where too little is seen."""
        ...

    def propose(self, carried: Candidates, rng: np.random.Generator) -> Candidates:
        """The carried poses and the filter's."""
        ...

    def refine(self, proposed: Candidates) -> Candidates:
        """All of them, and each moved to a nearby minimum of the residuals."""
        ...

    def judge(self, refined: Candidates) -> Candidates:
        """Those that stay in the race."""
        ...

    def search_limbs(self, judged: Candidates, rng: np.random.Generator) -> Candidates:
        """The same after a search for limbs that are lost or doubtful."""
        ...

    def restart(self, searched: Candidates, rng: np.random.Generator) -> Candidates:
        """The same after a new start, where the whole body is lost."""
        ...

    def remember(self, settled: Candidates) -> T_co:
        """The frame's result; what the next frame needs is kept."""
        ...


def follow(
    clip: PersonClip,
    order: Sequence[int],
    policy: Policy[T_co],
    rng_of: Callable[[int], np.random.Generator],
) -> Iterator[T_co]:
    """A policy's result for every row of a clip, in the given order.

    rng_of : frame -> generator, so that a frame draws the same numbers whatever came before it.
    """
    for row, evidence in _evidence_ahead(clip, order):
        yield follow_frame(policy, row, evidence, rng_of(int(clip.frames[row])))


def follow_frame(
    policy: Policy[T_co], row: int, evidence: FrameEvidence | None, rng: np.random.Generator
) -> T_co:
    """A policy's result for one row.  evidence : None where too little is seen."""
    carried = None if evidence is None else policy.carry(row, evidence)
    if carried is None:
        return policy.lose_sight(row)
    with part("propose"):
        candidates = policy.propose(carried, rng)
    with part("refine"):
        candidates = policy.refine(candidates)
    with part("judge"):
        candidates = policy.judge(candidates)
    with part("search limbs"):
        candidates = policy.search_limbs(candidates, rng)
    with part("restart"):
        candidates = policy.restart(candidates, rng)
    with part("remember"):
        return policy.remember(candidates)


def _evidence_ahead(clip: PersonClip, order: Sequence[int]) -> Iterator[tuple[int, FrameEvidence | None]]:
    """Rows in order with their evidence, None where too little is seen; with several threads the next one is made
    ready while a frame is worked on.
    """
    observation, frames = clip.observation, clip.frames
    n_threads = observation.tools.n_threads
    rows = list(order)
    if n_threads <= 1:
        for row in rows:
            prepared = observation.prepare(int(frames[row]))
            yield row, None if prepared is None else observation.evidence(prepared)
        return
    pool = worker_threads(n_threads)
    coming = [pool.submit(observation.prepare, int(frames[row])) for row in rows[:1]]
    for k, row in enumerate(rows):
        coming += [pool.submit(observation.prepare, int(frames[after])) for after in rows[k + 1 : k + 2]]
        prepared = coming.pop(0).result()
        yield row, None if prepared is None else observation.evidence(prepared)


def both_ways(n_rows: int, start: int) -> tuple[tuple[str, range], tuple[str, range]]:
    """The rows from a start to the end and from it to the beginning, each with what its generators are called by."""
    return ("", range(start, n_rows)), ("-backwards", range(start, -1, -1))


def unbroken(frames: NDArray[np.int64]) -> list[slice]:
    """The rows of frames (T,), ascending, in pieces without a missing frame: what moves between two is not known."""
    cuts = np.flatnonzero(np.diff(frames) > 1) + 1
    ends = [0, *cuts.tolist(), len(frames)]
    return [slice(a, b) for a, b in pairwise(ends)]


@dataclass(frozen=True, eq=False)
class FramePose:
    """The pose of one frame.  row : index into the person's frames; information, spread, misfit, unexplained,
    blind_std and hidden_std as in `FrameSeries`, the rest as in `PersonPoses`.  doubtful : (M,) bool, landmarks that
    another pose, which explains the frame about as well, has elsewhere.
    """

    row: int
    state: Array
    landmarks: Array
    information: Array
    spread: Array
    misfit: Array
    unexplained: float
    blind_std: float
    hidden_std: Array
    observed: NDArray[np.bool_]
    log_likelihood: float
    evidence: float
    ess_share: float
    doubtful: NDArray[np.bool_]


def follow_pose(
    clip: PersonClip,
    order: Sequence[int],
    first: Array,
    *,
    seed: int,
    stage: str,
    forgets: bool = False,
) -> Iterator[FramePose]:
    """Poses of rows `order` of a clip, from the pose `first` (D,) in the first of them, by one hypothesis.

    A frame without usable evidence carries the pose on with growing uncertainty and observed = False.
    stage : what the frames' generators are called by.  forgets : such a frame also ends what the particles know.
    """
    policy = OnePose(clip, order[0] if len(order) else 0, first, forgets=forgets)
    yield from follow(clip, order, policy, lambda frame: rng_for(seed, stage, clip.person, frame))


def follow_both_ways(
    clip: Clip,
    first: FirstPose,
    *,
    seed: int,
    take: Callable[[FramePose], None],
    leave: Callable[[Clip], None] | None = None,
    progress: Callable[[int], None] | None = None,
) -> Clip:
    """Every frame of a clip once, from the first pose to the end and back to the beginning, as `follow_pose`; both ways
    at once, in two processes, where there are threads for it.

    take : given every pose once.  leave : given the clip of the way back at its end, with what was learnt on it. What
    either writes must be shared (`forks.shared_zeros`).  Returns the clip with what was learnt on the way to the end;
    each way learns by itself.
    """
    n_threads, tick = clip.observation.tools.n_threads, progress or (lambda n: None)
    start = int(np.searchsorted(clip.frames, first.frame))
    later, earlier = (on_threads(clip, max(1, n_threads // 2)) for _ in range(2))
    (name, onwards), (name_back, back) = both_ways(len(clip), start)

    def follow_way(own: PersonClip, name: str, order: range, tick: Callable[[int], None]) -> None:
        for pose in follow_pose(own, order, first.state, seed=seed, stage=f"pose{name}"):
            if own is later or pose.row != start:  # the start is settled on the way to the end
                take(pose)
                tick(1)

    def go_back(tick: Callable[[int], None]) -> None:
        follow_way(earlier, name_back, back, tick)
        if leave is not None:
            leave(earlier)

    if n_threads > 1 and len(back) > 1 and can_fork():
        with forked(go_back, tick):
            follow_way(later, name, onwards, tick)
    else:
        follow_way(later, name, onwards, tick)
        go_back(tick)
    return later


def on_threads(clip: Clip, n_threads: int) -> Clip:
    """The same clip for somebody who follows it on so many threads: what its observation learns is his own."""
    observation: Any = clip.observation  # a data class, whatever it observes
    tools = replace(observation.tools, n_threads=n_threads)
    return replace(clip, observation=replace(observation, tools=tools))


def note(series: FrameSeries, row: int, pose: FramePose, tools: PersonTools) -> None:
    """A frame's pose into its row of the series."""
    series.states[row] = pose.state
    series.fit_covariance[row] = (
        fit_covariance(tools.body, pose.state, pose.information, tools.settings.method.deviation)
        if tools.settings.refine
        else pose.spread
    )
    for column in (
        "misfit", "unexplained", "blind_std", "hidden_std", "observed", "doubtful", "log_likelihood", "ess_share",
    ):  # fmt: skip
        getattr(series, column)[row] = getattr(pose, column)


class OnePose:
    """The policy of one hypothesis: particles that propose, one pose that is refined, judged, and fed back."""

    def __init__(self, clip: PersonClip, first_row: int, first: Array, *, forgets: bool = False) -> None:
        self.clip, self.tools = clip, clip.observation.tools
        self.settings = self.tools.settings
        self._step = FILTERS[self.settings.filter.name].step
        self._filter = self.tools.filter_settings()
        self._forgets = forgets
        # What the next frame needs.
        self._particles: ParticleState | None = None
        self._estimate = first
        self._before: Array | None = None  # the pose of the frame before that
        self._n_since_search = 0
        self._xyz = self._place_at(first_row)
        self._last_row: int | None = None
        self._blind_std, self._n_blind = 0.0, 0
        self._hidden_std = np.zeros(len(self.tools.body.landmarks))
        self._limbs = LimbSchedule(self.settings.method.limb_search)
        self._legs_wait = 0
        self._rival: Array | None = None
        self._loss = FallenEvidence(self.settings.method.restart)

    def _place_at(self, row: int) -> Array:
        xyz = self.clip.xyz
        return np.zeros(3) if xyz is None or not len(xyz) else np.asarray(xyz[row])

    def lose_sight(self, row: int) -> FramePose:
        """The last pose carried on; its uncertainty grows with every frame."""
        body, layout = self.tools.body, self.tools.body.layout
        self._blind_std += float(self.tools.noise_std[0])
        self._n_blind += 1
        if self._forgets:
            self._particles = None
        return FramePose(
            row=row,
            state=self._estimate,
            landmarks=landmarks_of(body, self._estimate[None])[0],
            information=np.zeros((layout.n_columns,) * 2),
            spread=np.zeros((len(body.landmarks), 3, 3)),
            misfit=np.zeros(layout.n_parts),
            unexplained=0.0,
            blind_std=float(np.hypot(self.settings.method.follow.blind_std_m, self._blind_std)),
            hidden_std=np.zeros(len(body.landmarks)),
            observed=np.zeros(len(body.landmarks), dtype=np.bool_),
            log_likelihood=float("nan"),
            evidence=float("nan"),
            ess_share=float("nan"),
            doubtful=np.zeros(len(body.landmarks), dtype=np.bool_),
        )

    def carry(self, row: int, evidence: FrameEvidence) -> Candidates:
        """The pose of the frame before, moved with the track; nothing after a gap."""
        frames = self.clip.frames
        self._row, self._evidence, self._rival = row, evidence, None
        self._shift = self._place_at(row) - self._xyz
        self._xyz = self._place_at(row)
        # Frames in which the person was not tracked have no rows.
        last = self._last_row
        n_away = 0 if last is None else abs(int(frames[row] - frames[last])) - abs(row - last)
        self._last_row = row
        self._previous = None if self._blind_std > 0 or n_away > 0 else self._estimate
        self._came_from = None if last is None else self._previous
        numbers = self.settings.method.follow
        gone_frames = max(2, round(numbers.gone_s * self.tools.fps))
        is_long_ago = last is not None and self._is_apart and 1.0 / self.tools.fps >= numbers.gone_s
        self._has_returned = is_long_ago or self._n_blind + n_away >= gone_frames
        self._blind_std, self._n_blind = 0.0, 0
        if self._previous is None:
            return []
        carried = self._previous.copy()
        carried[:3] += self._shift
        return [Candidate(carried)]

    def _gone_on(self, carried: Candidates) -> Candidates:
        """The carried pose, its joints turned on as they turned before; those of a limb that was found stay.
        It has turned further than people turn in a frame.
        """
        (now,), body = carried, self.tools.body
        if self._before is None:
            return carried
        turn = self._estimate - self._before
        turn = np.where(body.layout.is_circular, wrap_angle(turn), turn)
        turn[:3] = 0.0  # the track says where the person has gone
        turn[np.abs(turn) > body.max_speed / self.tools.fps] = 0.0
        return [Candidate(np.clip(now.state + turn, body.layout.lower, body.layout.upper))]

    @property
    def _search_every_frames(self) -> int:
        numbers, wanted = self.settings.method.follow, self.settings.search_every_frames
        if wanted != "auto":
            return wanted
        return numbers.rarely_frames if self._evidence.n_cameras >= numbers.many_cameras else 1

    def propose(self, carried: Candidates, rng: np.random.Generator) -> Candidates:
        """The filter's estimate first, then the carried pose; between two searches the carried pose gone on."""
        problem = self._evidence.search
        can_wait = bool(carried) and self.settings.refine and self._particles is not None
        is_between = can_wait and self._n_since_search + 1 < self._search_every_frames
        self._n_since_search = self._n_since_search + 1 if is_between else 0
        if self._particles is None:
            self._particles = initial_particles(problem, self._estimate, self._filter.n_particles)
        particles = self._particles
        if self.settings.follow_track:
            moved = particles.particles.copy()
            moved[:, :3] += self._shift
            particles = replace(particles, particles=moved)
        if is_between:
            self._particles = particles
            return self._gone_on(carried)
        self._particles, self._info = self._step(problem, particles, self._filter, rng=rng)
        estimate = point_estimate(self.tools.body, self._particles, self._info, self.settings.estimate)
        self._spread = _landmark_spread(self.tools.body, self._particles, estimate)
        return [Candidate(estimate), *carried]

    def refine(self, proposed: Candidates) -> Candidates:
        """The filter's estimate as it is, and all refined; without refinement the estimate alone."""
        if not self.settings.refine:
            return proposed[:1]
        refined = self._evidence.all_refined([c.state for c in proposed])
        return [proposed[0], *(Candidate(state) for state in refined)]

    def judge(self, refined: Candidates) -> Candidates:
        """The one with most evidence."""
        values = self._evidence.evidence([c.state for c in refined])
        best = int(values.argmax())
        return [replace(refined[best], value=float(values[best]))]

    def search_limbs(self, judged: Candidates, rng: np.random.Generator) -> Candidates:
        """The pose with lost limbs found, where that raises the evidence; between two searches only where it fell."""
        (now,) = judged
        can_wait = self._n_since_search > 0 and not self._limbs.has_fallen(now.value)
        if can_wait or not self.settings.look_again:
            return judged
        look_at = self._limbs.due(now.value, self._evidence.limb_misfits(now.state))
        found = search_limbs(
            self._evidence,
            now.state,
            self._previous,
            look_at=look_at,
            max_limbs=self.settings.method.follow.max_limbs,
            rng=rng,
        )
        value = now.value if found is now.state else float(self._evidence.evidence([found])[0])
        self._limbs.note(value - now.value, look_at)
        return [self._with_legs_judged(Candidate(found, value=value))]

    def _with_legs_judged(self, now: Candidate) -> Candidate:
        """The pose with each leg where the other one is, where that raises the evidence; looked at now and then, and in
        every frame while the evidence hardly tells the two apart.
        """
        numbers = self.settings.method.legs
        self._legs_wait -= 1
        if self._legs_wait > 0:
            return now
        rival = legs_exchanged(self._evidence, now.state)
        if rival is None:
            return now
        value = float(self._evidence.evidence([rival])[0])
        other = Candidate(rival, value=value)
        if value > now.value + numbers.better_nats:
            now, other = other, now
        is_clear = other.value < now.value - numbers.clear_nats
        self._rival = None if is_clear else other.state
        self._legs_wait = numbers.turn_frames if is_clear else 1
        return now

    @property
    def _is_apart(self) -> bool:
        """Whether frames are so far apart that the pose before says too little of this one."""
        return 1.0 / self.tools.fps >= self.settings.method.follow.apart_s

    @property
    def _is_hard_to_follow(self) -> bool:
        """Whether frames are far apart, or too few cameras tell whether the pose before went on rightly."""
        few_cameras = self.settings.method.follow.few_cameras
        return self._came_from is not None and (self._is_apart or self._evidence.n_cameras <= few_cameras)

    def restart(self, searched: Candidates, rng: np.random.Generator) -> Candidates:
        """A pose found anew where the body is lost or hard to follow, faces against its way, or has come back after a
        while."""
        (now,) = searched
        is_backwards = self._faces_backwards(now.state)
        if self.settings.look_again and (
            self._has_returned
            or self._is_hard_to_follow
            or self._loss.is_due(self._row, now.value, is_backwards=is_backwards)
        ):
            now = self._restarted(now, rng)
            self._rival = self._rival if now is searched[0] else None
        self._loss.note(now.state, now.value)
        return [now]

    def _faces_backwards(self, state: Array) -> bool:
        """Whether a pose (D,) faces against the way that the person goes."""
        numbers, body = self.settings.method.start, self.tools.body
        heading = heading_of(walking_velocity(self.clip, self._row, numbers), numbers)
        if heading is None or body.yaw_column is None:
            return False
        (angle,), (is_level,) = facing_of(body, state[None])
        return bool(is_level and np.cos(angle - heading) < 0.0)

    def _restarted(self, now: Candidate, rng: np.random.Generator) -> Candidate:
        evidence: WholeBodyEvidence = self._evidence  # type: ignore[assignment]
        velocity = walking_velocity(self.clip, self._row, self.settings.method.start)
        search = PoseSearch(evidence, int(self.clip.frames[self._row]), velocity)
        # Who was away may stand anywhere near and face any way: nothing is known but the place.
        new = (
            settle_first_poses(search, try_first_poses(search, rng=rng), rng=rng)[0].state
            if self._has_returned
            else restarted_pose(search, now.state, self._loss.best_state, rng=rng)
        )
        both = np.stack([now.state, new])
        value, restarted = evidence.evidence(both).tolist()
        likelier = -float(np.diff(search.against_walking(both))[0])
        is_turned = faces_other_way(self.tools.body, now.state, new)
        is_taken = self._loss.settle(self._row, value, restarted, likelier=likelier, is_turned=is_turned)
        if not is_taken and not (self._has_returned and restarted + likelier > value):
            return now
        self._particles = initial_particles(evidence.search, new, self._filter.n_particles)
        return Candidate(new, value=restarted)

    def remember(self, settled: Candidates) -> FramePose:
        """Feed the pose back into the particles and learn what it shows."""
        (now,) = settled
        assert self._particles is not None
        self._before, self._estimate = self._came_from, now.state
        if self.settings.refine or self.settings.look_again:
            self._particles = _fed_back(self._particles, now.state, self.settings.feedback_share)
        self.clip.observation.learn(self._evidence, now.state)
        fit = self._evidence.fit(now.state, self._info.observed_parts)
        self._hidden_std = np.where(fit.judged, 0.0, self._hidden_std + self.tools.noise_std[0])
        blind_m = self.settings.method.follow.blind_std_m
        doubtful, doubt_std = in_doubt(self.tools.body, now.state, self._rival, self.settings.method.legs)
        return FramePose(
            row=self._row,
            state=now.state,
            landmarks=landmarks_of(self.tools.body, now.state[None])[0],
            information=fit.information,
            spread=self._spread + self._evidence.grain_m**2 * np.eye(3),
            misfit=fit.misfit,
            unexplained=fit.unexplained,
            blind_std=0.0,
            hidden_std=np.hypot(
                np.where(fit.judged, 0.0, np.hypot(blind_m, self._hidden_std)),
                np.hypot(doubt_std, fit.unseen_std),
            ),
            observed=fit.observed & ~doubtful,
            log_likelihood=fit.log_likelihood,
            evidence=now.value,
            ess_share=float(self._info.ess[-1]) / len(self._particles.weights),
            doubtful=doubtful,
        )


def point_estimate(body: Body, particles: ParticleState, info: FilterInfo, kind: str = "mean") -> Array:
    """One state (D,) for a frame's particles.

    kind : `mean` = the filter's own, weighted over angles (CF 3.19); `rotation_mean` = weighted over rotations;
    `map` = the particle of the highest likelihood, the maximum a posteriori under a flat prior.
    """
    if kind == "map":
        return info.best
    if kind == "rotation_mean":
        return mean_state(body, particles.particles, particles.weights, info.estimate)
    return info.estimate


def _landmark_spread(body: Body, particles: ParticleState, estimate: Array) -> Array:
    """Spread of the landmarks over the particles around the estimate's, (M, 3, 3) m^2."""
    d = landmarks_of(body, particles.particles) - landmarks_of(body, estimate[None])
    return np.einsum("n,nlr,nlc->lrc", particles.weights, d, d)


def _fed_back(particles: ParticleState, estimate: Array, share: float) -> ParticleState:
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
