"""The search for a first pose: many kinds of poses in all directions, the promising ones followed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from mocap.body import Body, candidate_states
from mocap.filters import ParticleState, initial_particles
from mocap.filters.apf import ApfSettings, apf_step
from mocap.likelihood.colours import Appearance
from mocap.pipeline.limbs import first_parts, recover_limbs
from mocap.pipeline.pose_problem import FrameProblem, PoseTools, PreparedHull
from mocap.threads import in_parallel

Array = NDArray[np.float64]

_SEARCH_STD_M = 0.06
_SEARCH_STD_RAD = 0.2
_SEARCH_COPIES = 8
_FACING_NATS = 8.0  # cost of facing against the direction of walking, CF 6.3.3 takes it as a certainty
_WALKING_M_S = 0.3


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
    way costs likelihood.  appearance : what is known of the person's colours.
    """

    tools: PoseTools
    hull: PreparedHull
    frame: int
    walking_xy: Array | None
    appearance: Appearance | None = None

    @cached_property
    def problem(self) -> FrameProblem:
        return self.tools.frame(self.hull, self.appearance)

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
        value = self.problem.log_likelihood(states)
        yaw, heading = yaw_column(self.tools.body), self.heading
        if yaw is not None and heading is not None:
            value -= _FACING_NATS * (1.0 - np.cos(states[:, yaw] - heading))
        return value

    def judge(self, states: Sequence[Array]) -> Array:
        """The evidence of states with the prior on the direction, (K,) nats."""
        return self.score(np.stack(states)) - self.problem.misfit(states)

    def with_limbs_recovered(self, found: FirstPose, *, rng: np.random.Generator) -> FirstPose:
        """The same pose after scouts have looked for limbs that fit badly or that the hull shows elsewhere."""
        every = first_parts(self.tools.body.layout)
        state = recover_limbs(self.problem, found.state, look_at=every, max_limbs=4, rng=rng)
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
        alone = replace(self, tools=replace(self.tools, n_threads=1))
        jobs = list(zip(starts, rng.spawn(len(starts)), strict=True))

        def follow(job: tuple[tuple[ParticleState, str], np.random.Generator]) -> FirstPose:
            (start, label), own = job
            return alone.attempt(start, label, settings, is_brief=is_brief, rng=own)

        return in_parallel(follow, jobs, self.tools.n_threads)

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
        problem = self.problem.coarse if is_brief else self.problem
        _, info = apf_step(problem.search, start, settings, rng=rng)
        found = [info.estimate, problem.refined(info.estimate, 5 if is_brief else 12)]
        values = self.score(np.stack(found)) - problem.misfit(found)
        top = int(values.argmax())
        return FirstPose(self.frame, found[top], label, float(values[top]))


def try_first_poses(search: PoseSearch, *, rng: np.random.Generator) -> list[FirstPose]:
    """Many kinds of poses in all directions, the promising ones followed briefly, best first.

    Source: CF 6.3.3; departs from it: the volume decides, the displacement is a prior.
    """
    body = search.tools.body
    yaws: Array = np.arange(16, dtype=np.float64) * (2 * np.pi / 16) + (search.heading or 0.0)
    centers = search.tools.grid.centers(search.hull.hull.voxels)
    candidates, labels = candidate_states(body, centers, yaws)
    copies = np.repeat(candidates, _SEARCH_COPIES, axis=0)
    copies = search.problem.search.propagate(copies, search.std, rng=rng)
    copies[::_SEARCH_COPIES] = candidates
    value = search.score(copies).reshape(len(candidates), _SEARCH_COPIES)
    copies = copies.reshape(len(candidates), _SEARCH_COPIES, -1)
    equal = np.full(_SEARCH_COPIES, 1.0 / _SEARCH_COPIES)
    brief = ApfSettings(n_layers=4, n_particles=80, std=search.std, survival_rate=0.5)
    promising = np.argsort(-value.max(axis=1), kind="stable")[: 4 * search.tools.pose.n_first_poses]
    starts = [(ParticleState(copies[k], equal), labels[k]) for k in promising.tolist()]
    tried = search.attempts(starts, brief, is_brief=True, rng=rng)
    return sorted(tried, key=lambda found: -found.log_likelihood)


def settle_first_poses(
    search: PoseSearch, tried: Sequence[FirstPose], *, rng: np.random.Generator
) -> list[FirstPose]:
    """The best pose after following the best starts to the end, and the best one that faces the other way."""
    yaw = yaw_column(search.tools.body)
    chosen = list(tried[: search.tools.pose.n_first_poses])
    if yaw is not None:
        # A person from behind has the silhouette of one from the front: follow the best of the other half too.
        behind = [f for f in tried if np.cos(f.state[yaw] - tried[0].state[yaw]) < 0]
        chosen += [f for f in behind[:3] if f not in chosen]
    thorough = ApfSettings(n_layers=8, n_particles=200, std=search.std, survival_rate=0.6)
    problem = search.problem.search
    starts = [(initial_particles(problem, f.state, 2), f.label) for f in chosen]
    found = search.attempts(starts, thorough, is_brief=False, rng=rng)
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


def yaw_column(body: Body) -> int | None:
    columns = np.flatnonzero(body.layout.is_circular)
    return int(columns[0]) if len(columns) else None


def walking_velocity(frames: NDArray[np.int64], xyz: Array, i: int, fps: float) -> Array | None:
    """Mean velocity on the floor over about half a second around row i, (2,) m/s."""
    reach = max(1, round(0.25 * fps))
    a, b = max(0, i - reach), min(len(frames) - 1, i + reach)
    if a == b:
        return None
    return (xyz[b, :2] - xyz[a, :2]) * fps / float(frames[b] - frames[a])
