"""Start: the search for a first pose in one frame, in all directions, with nothing known but where the person is."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mocap.body import Body, candidate_states
from mocap.body.initial import N_KINDS, is_low
from mocap.body.kinematics import facing_of, joint_transforms
from mocap.filters import ParticleState, initial_particles
from mocap.filters.apf import ApfSettings, apf_step
from mocap.pose.evidence import PersonClip, WholeBodyEvidence
from mocap.pose.limb_search import first_parts, search_limbs
from mocap.pose.method import StartSettings
from mocap.pose.settings import PoseSettings
from mocap.threads import in_parallel

Array = NDArray[np.float64]


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

    evidence: WholeBodyEvidence
    frame: int
    walking_xy: Array | None

    @property
    def settings(self) -> PoseSettings:
        return self.evidence.tools.settings

    @property
    def body(self) -> Body:
        return self.evidence.tools.body

    @property
    def heading(self) -> float | None:
        """Direction of walking, rad, or None for a person who stays."""
        return heading_of(self.walking_xy, self.settings.method.start)

    @property
    def std(self) -> Array:
        """(D,) noise of the search, m and rad."""
        numbers = self.settings.method.start
        std = np.where(self.body.is_position, numbers.search_std_m, numbers.search_std_rad)
        return np.where(self.evidence.tools.is_searched, std, 0.0)

    @property
    def is_low(self) -> bool:
        """Whether the person lies, or is on hands and knees: then every kind of pose has its turn, as rough poses of a
        flat hull do not tell its ends and sides apart."""
        return is_low(self.evidence.places, self.body)

    def score(self, states: Array) -> Array:
        """Log-likelihood of states (N, D) with the prior on the direction, (N,)."""
        return self.evidence.log_likelihood(states) - self.against_walking(states)

    def against_walking(self, states: Array) -> Array:
        """What it costs states (N, D) to face against the direction of walking, (N,) nats."""
        return against_walking(self.body, states, self.heading, self.settings.method.start)

    def judge(self, states: Sequence[Array]) -> Array:
        """The evidence of states with the prior on the direction, (K,) nats."""
        return self.score(np.stack(states)) - self.evidence.misfit(states)

    def with_limbs_searched(self, found: FirstPose, *, rng: np.random.Generator) -> FirstPose:
        """The same pose after all limbs have been searched for, where that makes it better."""
        every = first_parts(self.body.layout)
        max_limbs = self.settings.method.start.max_limbs
        state = search_limbs(self.evidence, found.state, look_at=every, max_limbs=max_limbs, rng=rng)
        value = float(self.judge([state])[0])
        return FirstPose(found.frame, state, found.label, value) if value > found.log_likelihood else found

    def attempts(
        self,
        starts: Sequence[tuple[ParticleState, str]],
        settings: ApfSettings,
        *,
        is_brief: bool,
        rng: np.random.Generator,
    ) -> list[FirstPose]:
        """Several attempts, each with random numbers of its own, on the threads there are."""
        alone = replace(self, evidence=self.evidence.on_one_thread)
        jobs = list(zip(starts, rng.spawn(len(starts)), strict=True))

        def follow(job: tuple[tuple[ParticleState, str], np.random.Generator]) -> FirstPose:
            (start, label), own = job
            return alone.attempt(start, label, settings, is_brief=is_brief, rng=own)

        return in_parallel(follow, jobs, self.evidence.tools.n_threads)

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
        evidence = self.evidence.coarse if is_brief else self.evidence
        numbers = self.settings.method.start
        n_iterations = numbers.brief_iterations if is_brief else numbers.thorough_iterations
        _, info = apf_step(evidence.search, start, settings, rng=rng)
        found = [info.estimate, *evidence.all_refined([info.estimate], n_iterations)]
        values = self.score(np.stack(found)) - evidence.misfit(found)
        top = int(values.argmax())
        return FirstPose(self.frame, found[top], label, float(values[top]))


def affordable_first_poses(settings: StartSettings, n_first_poses: int, n_frames: int) -> int:
    """How many first poses can be followed to the end in each of n_frames so that their search stays within its
    evaluations: at most n_first_poses, at least one."""
    thorough = settings.thorough_layers * settings.thorough_particles
    brief = settings.brief_factor * settings.brief_layers * settings.brief_particles
    once = N_KINDS * settings.n_directions * settings.n_copies + settings.n_opposite * thorough
    return max(1, min(n_first_poses, (settings.max_evaluations // n_frames - once) // (brief + thorough)))


def try_first_poses(search: PoseSearch, *, rng: np.random.Generator) -> list[FirstPose]:
    """Many kinds of poses in all directions, the promising ones followed briefly, best first.

    Source: CF 6.3.3; departs from it: the volume decides, the displacement is a prior.
    """
    numbers = search.settings.method.start
    n, n_copies = numbers.n_directions, numbers.n_copies
    yaws: Array = np.arange(n, dtype=np.float64) * (2 * np.pi / n) + (search.heading or 0.0)
    candidates, labels = candidate_states(search.body, search.evidence.places, yaws)
    copies = np.repeat(candidates, n_copies, axis=0)
    copies = search.evidence.search.propagate(copies, search.std, rng=rng)
    copies[::n_copies] = candidates
    value = search.score(copies).reshape(len(candidates), n_copies)
    copies = copies.reshape(len(candidates), n_copies, -1)
    equal = np.full(n_copies, 1.0 / n_copies)
    brief = ApfSettings(
        n_layers=numbers.brief_layers,
        n_particles=numbers.brief_particles,
        std=search.std,
        survival_rate=numbers.brief_survival_rate,
    )
    n_promising = numbers.brief_factor * search.settings.n_first_poses
    promising = np.argsort(-value.max(axis=1), kind="stable")
    if search.is_low:
        promising = promising[_in_turn([labels[k] for k in promising.tolist()])]
    promising = promising[:n_promising]
    starts = [(ParticleState(copies[k], equal), labels[k]) for k in promising.tolist()]
    tried = search.attempts(starts, brief, is_brief=True, rng=rng)
    return sorted(tried, key=lambda found: -found.log_likelihood)


def settle_first_poses(
    search: PoseSearch, tried: Sequence[FirstPose], *, rng: np.random.Generator
) -> list[FirstPose]:
    """The best pose after following the best starts to the end, and the best one that faces the other way."""
    numbers = search.settings.method.start
    order = _in_turn([f.label for f in tried]) if search.is_low else range(len(tried))
    chosen = [tried[k] for k in order[: search.settings.n_first_poses]]
    # A person from behind has the silhouette of one from the front: follow the best of the other half too.
    behind = _facing(tried, tried[0], search, ahead=False)
    chosen += [f for f in behind[: numbers.n_opposite] if f not in chosen]
    thorough = ApfSettings(
        n_layers=numbers.thorough_layers,
        n_particles=numbers.thorough_particles,
        std=search.std,
        survival_rate=numbers.thorough_survival_rate,
    )
    starts = [(initial_particles(search.evidence.search, f.state, 2), f.label) for f in chosen]
    found = search.attempts(starts, thorough, is_brief=False, rng=rng)
    found.sort(key=lambda f: -f.log_likelihood)
    if search.body.yaw_column is not None:
        ahead = _facing(found, found[0], search, ahead=True)
        found = [*ahead[:2], *_facing(found, found[0], search, ahead=False)[:1]]
    searched = [search.with_limbs_searched(f, rng=rng) for f in found[: numbers.n_searched]]
    searched.sort(key=lambda f: -f.log_likelihood)
    return [searched[0], *_facing(searched, searched[0], search, ahead=False)[:1]]


def _in_turn(labels: Sequence[str]) -> list[int]:
    """Places of the first of every label, in order, then of every second one, and so on."""
    return sorted(range(len(labels)), key=lambda k: labels[:k].count(labels[k]))


def _facing(
    poses: Sequence[FirstPose], best: FirstPose, search: PoseSearch, *, ahead: bool
) -> list[FirstPose]:
    """The poses that face the same half of the room as the best one, or the other; none on a body without a yaw."""
    if search.body.yaw_column is None:
        return []
    return [f for f in poses if faces_other_way(search.body, f.state, best.state) != ahead]


def faces_other_way(body: Body, state: Array, other: Array) -> bool:
    """Whether two poses (D,) face opposite halves of the room, or are turned from each other by more than 90 degrees
    where one lies: his head is where the feet were, or his belly is up; never on a body without a yaw."""
    if body.yaw_column is None:
        return False
    both = np.stack([state, other])
    angle, is_level = facing_of(body, both)
    if is_level.all():
        return bool(np.cos(angle[0] - angle[1]) < 0.0)
    one, two = joint_transforms(body, both)[0][:, 0]
    return bool(np.trace(one.T @ two) < 1.0)


def walking_velocity(clip: PersonClip, i: int, settings: StartSettings) -> Array | None:
    """Mean velocity on the floor around row i of a clip, (2,) m/s; None without a track or in a single frame."""
    frames, xyz, fps = clip.frames, clip.xyz, clip.observation.tools.fps
    reach = max(1, round(settings.walking_window_s * fps))
    a, b = max(0, i - reach), min(len(frames) - 1, i + reach)
    if a == b or xyz is None:
        return None
    return (xyz[b, :2] - xyz[a, :2]) * fps / float(frames[b] - frames[a])


def heading_of(walking_xy: Array | None, settings: StartSettings) -> float | None:
    """Direction in which somebody walks, rad; None for one who stays.  walking_xy : (2,) m/s, or None."""
    if walking_xy is None or float(np.hypot(*walking_xy)) <= settings.walking_m_s:
        return None
    return float(np.arctan2(walking_xy[1], walking_xy[0]))


def against_walking(body: Body, states: Array, heading: float | None, settings: StartSettings) -> Array:
    """What it costs states (N, D) to face against the direction of walking, (N,) nats, nothing for who lies; heading :
    rad, or None."""
    if heading is None or body.yaw_column is None:
        return np.zeros(len(states))
    angle, is_level = facing_of(body, states)
    return np.where(is_level, settings.facing_nats * (1.0 - np.cos(angle - heading)), 0.0)
