"""Forward: one person followed while he is seen, frame after frame, when the end of the clip is not known.

Who comes in is watched for a while; then pose and size are looked for on another thread, what was seen meanwhile is
caught up in strides, and from there on every frame gives a pose. Who comes back keeps his size.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import Executor, Future
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mocap.body.initial import HeightEstimate
from mocap.data import VoxelGrid
from mocap.pose.follow import FramePose, OnePose, follow_frame
from mocap.pose.person import VolumeClip, start_person
from mocap.pose.volume import PersonHull, VolumeObservation, VolumeTools, estimate_height
from mocap.rng import rng_for

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Sighting:
    """One person at one time.  xyz : (3,) m, the track.  hull : None where he has no voxel."""

    time_s: float
    xyz: Array
    hull: PersonHull | None


@dataclass(frozen=True)
class ForwardSettings:
    """When a person's pose is looked for.

    watched_s, known_watched_s : how long a person is watched before, and one whose size is known; a step or two tells
    front from back.  least_frames : in so many frames at least.  gone_s : unseen for longer, his pose is looked for
    anew.  stride_frames : in which what was seen meanwhile is caught up; as in the comparison of starting hypotheses.
    """

    watched_s: float = 1.0
    known_watched_s: float = 0.4
    least_frames: int = 6
    gone_s: float = 0.5
    stride_frames: int = 3


@dataclass(frozen=True, eq=False)
class KnownPerson:
    """A person with size and a pose.  state : (D,), at the sighting of this row."""

    tools: VolumeTools
    height: HeightEstimate
    state: Array
    row: int


class ForwardPerson:
    """One person whom `see` is told of, frame by frame.

    given_m : the height, None = it is measured.  tools_of : tools for a body of some height, m; of one thread, unless
    frames wait for the search: with more it forks.  executor : looks for the first pose while frames go on.
    """

    def __init__(
        self,
        person: int,
        grid: VoxelGrid,
        tools_of: Callable[[float], VolumeTools],
        executor: Executor,
        *,
        seed: int,
        given_m: float | None = None,
        settings: ForwardSettings | None = None,
    ) -> None:
        self.person, self.settings = person, settings or ForwardSettings()
        self._grid, self._tools_of, self._executor = grid, tools_of, executor
        self._seed, self._given_m = seed, given_m
        self._known: KnownPerson | None = None
        self._watched: list[Sighting] = []
        self._search: Future[KnownPerson] | None = None
        self._following: _Following | None = None
        self._last_s: float | None = None
        self._height_m = given_m

    @property
    def height_m(self) -> float | None:
        """The body's; until it is known that of the hulls, and None before they are enough."""
        return self._height_m if self._known is None else self._known.height.height_m

    @property
    def tools(self) -> VolumeTools | None:
        """With the person's body; None while its size is not known."""
        return None if self._known is None else self._known.tools

    def see(self, seen: Sighting) -> FramePose | None:
        """The pose at this time; None while the first one is looked for."""
        if self._last_s is not None and seen.time_s - self._last_s > self.settings.gone_s:
            self._following, self._search, self._watched = None, None, []
        self._last_s = seen.time_s
        if self._following is None:
            self._watched.append(seen)
            self._look_for()
        return None if self._following is None else self._following.step(seen)

    def _look_for(self) -> None:
        """Begin the search for pose and size when enough was seen; take over what it has found."""
        if self._search is None:
            usable = [s.time_s for s in self._watched if s.hull is not None]
            wanted_s = self.settings.watched_s if self._known is None else self.settings.known_watched_s
            if len(usable) >= self.settings.least_frames and usable[-1] - usable[0] >= wanted_s:
                watched = self._watched
                self._search = self._executor.submit(lambda: self._found(watched))
        elif self._search.done():
            search, watched = self._search, self._watched
            self._search, self._watched = None, []
            try:
                self._known = search.result()
            except ValueError:  # no hull that can hold a person: watch on
                return
            self._following = _Following(
                self.person, self._known, watched[self._known.row].xyz, seed=self._seed
            )

    def _found(self, watched: list[Sighting]) -> KnownPerson:
        """Size and pose, out of what was seen; `watched` grows meanwhile, and is caught up with.

        Raises ValueError when there is no usable hull.
        """
        looked_at = list(watched)
        fps = (len(looked_at) - 1) / (looked_at[-1].time_s - looked_at[0].time_s)

        def hull_of(row: int) -> PersonHull | None:
            return watched[row].hull

        if self._known is not None:
            tools, height = self._known.tools, self._known.height
        else:
            rows = list(range(len(looked_at)))
            height = (
                HeightEstimate(self._given_m, True, is_given=True)
                if self._given_m is not None
                else estimate_height(self._grid, hull_of, rows)
            )
            if height.is_measured:
                self._height_m = height.height_m  # long before the search is done
            tools = self._tools_of(height.height_m)
        tools = replace(tools, fps=fps)
        clip = _clip(self.person, looked_at, VolumeObservation(tools, hull_of))
        start = start_person(clip, height, seed=self._seed, is_size_fitted=self._known is None)
        numbers, stride = tools.settings.method.start, self.settings.stride_frames
        brisk = start.tools.brisk(numbers.trial_layers, numbers.trial_particles, stride, refine=True)
        observation = VolumeObservation(brisk, hull_of)
        row, state = start.first.frame, start.first.state
        policy = OnePose(_clip(self.person, watched, observation), row, state)
        while row + stride < len(watched):
            row += stride
            policy.clip = _clip(self.person, watched, observation)
            state = _step(policy, row, seed=self._seed).state
        return KnownPerson(start.tools, start.height, state, row)


class _Following:
    """A person with a pose, followed from frame to frame."""

    def __init__(self, person: int, known: KnownPerson, xyz: Array, *, seed: int) -> None:
        self._hull: PersonHull | None = None
        observation = VolumeObservation(known.tools, lambda row: self._hull)
        if known.tools.settings.refine:
            observation = observation.learning()
        self._n, self._xyz, self._seed = 1, np.array([xyz]), seed
        self._frames = np.arange(1)
        clip = VolumeClip(person, self._frames, self._xyz, observation)
        self._policy = OnePose(clip, 0, known.state)

    def step(self, seen: Sighting) -> FramePose:
        """The pose of the next frame."""
        self._hull = seen.hull
        if self._n == len(self._xyz):
            # 2.6 MB an hour: how somebody walks is asked of the track.
            self._xyz = np.concatenate([self._xyz, np.zeros_like(self._xyz)])
            self._frames = np.arange(len(self._xyz))
        self._xyz[self._n] = seen.xyz
        self._n += 1
        clip = replace(self._policy.clip, frames=self._frames[: self._n], xyz=self._xyz[: self._n])
        self._policy.clip = clip
        return _step(self._policy, self._n - 1, seed=self._seed)


def _clip(person: int, seen: Sequence[Sighting], observation: VolumeObservation) -> VolumeClip:
    """Sightings as a clip, numbered one after the other."""
    xyz = np.array([s.xyz for s in seen])
    return VolumeClip(person, np.arange(len(xyz)), xyz, observation)


def _step(policy: OnePose, row: int, *, seed: int) -> FramePose:
    """The pose of one row."""
    observation = policy.clip.observation
    prepared = observation.prepare(row)
    evidence = None if prepared is None else observation.evidence(prepared)
    return follow_frame(policy, row, evidence, rng_for(seed, "live", policy.clip.person, row))
