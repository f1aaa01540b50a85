"""Persons: everybody who is tracked is taken up, followed and remembered; where it can be, in a process of its own.

Poses and the search for a first one keep the interpreter busy: on threads they and the next frame would wait for each
other.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from mocap.body import Body, load_body_model
from mocap.data import Occluders, VoxelGrid
from mocap.forks import answering, can_fork
from mocap.io.session import Session
from mocap.pipeline.config import Config
from mocap.pipeline.pose_settings import make_tools, stated_height_m
from mocap.pipeline.stage import Arrays
from mocap.pipeline.stages.carve import grid_of
from mocap.pipeline.stages.pose import PersonViews, look_at
from mocap.pose.deviation import FrameSeries, landmark_covariances
from mocap.pose.follow import FramePose
from mocap.pose.forward import ForwardPerson, ForwardSettings, Sighting
from mocap.pose.person import note
from mocap.pose.thing import Look, ThingWatch
from mocap.pose.volume import VolumeTools
from mocap.threads import AtOnce
from mocap.tracking.state import Track

Array = NDArray[np.float64]

MOST_PERSONS = 16
"""Who is remembered; the one who was not seen for longest gives way."""


@dataclass(frozen=True, eq=False)
class PersonResult:
    """One person in one frame.

    xyz : (3,) m, the track.  height_m : None while it is not known.  body : None while it is not known.  pose and
    deviation_m (M,), the standard deviation of a landmark along an axis: None while the first pose is looked for.
    is_thing : nobody, but a thing that the empty room does not have.
    """

    person: int
    xyz: Array
    height_m: float | None = None
    body: Body | None = None
    pose: FramePose | None = None
    deviation_m: Array | None = None
    is_thing: bool = False


@dataclass(frozen=True, eq=False)
class SeenPersons:
    """What was seen of all persons in one frame.

    tracks : those that are confirmed.  owner : (N,) serial + 1 of the track that holds each voxel.  hulls, masks : the
    rows of these products.
    """

    time_s: float
    tracks: Sequence[Track]
    owner: NDArray[np.uint32]
    hulls: Arrays
    masks: Arrays


Poses = Callable[[SeenPersons], tuple[PersonResult, ...]]
"""Gives everybody of a frame with his pose; of frames in their order."""


@dataclass(frozen=True, eq=False)
class Following:
    """How persons are followed.  occluders : what stands before people.  forward : how they are taken up; None = the
    usual.  n_threads : with more than one, first poses are looked for while frames go on."""

    session: Session
    config: Config
    occluders: Occluders
    seed: int
    n_threads: int
    forward: ForwardSettings | None

    def poses(self) -> AbstractContextManager[Poses]:
        """What follows, beside this process if there are two threads; use as context manager."""
        return answering(self._here) if self.n_threads > 1 and can_fork() else self._here()

    @contextmanager
    def _here(self) -> Iterator[Poses]:
        with ThreadPoolExecutor(1) if self.n_threads > 1 else AtOnce() as searches:
            yield _Persons(self, searches).posed


@dataclass(eq=False)
class _Known:
    """One who was seen: how he is followed, and whether he is a thing."""

    follower: ForwardPerson
    watch: ThingWatch


class _Persons:
    """Everybody who was seen so far.  searches : looks for first poses."""

    def __init__(self, following: Following, searches: ThreadPoolExecutor | AtOnce) -> None:
        self._of, self._searches = following, searches
        self._grid = grid_of(following.session, following.config)
        self._views = PersonViews(following.session, self._grid, following.occluders)
        self._persons: dict[int, _Known] = {}

    def posed(self, seen: SeenPersons) -> tuple[PersonResult, ...]:
        """The persons of a frame with their poses."""
        return tuple(self._person(track, seen) for track in seen.tracks)

    def _person(self, track: Track, seen: SeenPersons) -> PersonResult:
        one = self._known(track.person)
        watch, owner = one.watch, track.serial + 1

        def look() -> Look:
            return look_at(seen.hulls, seen.owner == owner, self._grid)

        if watch.is_thing:
            watch.see(seen.time_s, track.xyz, None, look)
            if watch.is_thing:
                return PersonResult(track.person, track.xyz, is_thing=True)
            one.follower = self._follower(track.person)
        hull = self._views.hull(seen.hulls, seen.owner, owner, lambda: seen.masks)
        follower = one.follower
        pose = follower.see(Sighting(seen.time_s, track.xyz, hull))
        tools = follower.tools
        misfit = None if pose is None or pose.blind_std > 0 else float(pose.misfit.sum())
        watch.see(seen.time_s, track.xyz, misfit, look)
        if pose is None or tools is None:
            body = None if tools is None else tools.body
            return PersonResult(track.person, track.xyz, follower.height_m, body)
        series = FrameSeries.of_length(1, tools.body)
        note(series, 0, pose, tools)
        covariance = landmark_covariances(tools.body, series, self._of.config.method.deviation)
        deviation_m = np.sqrt(np.trace(covariance[0], axis1=1, axis2=2) / 3.0)
        return PersonResult(track.person, track.xyz, follower.height_m, tools.body, pose, deviation_m)

    def _known(self, person: int) -> _Known:
        """What is known of a person; the last who was seen stands last."""
        config = self._of.config
        known = self._persons.pop(person, None) or _Known(
            self._follower(person), ThingWatch(self._grid.voxel_size_m, config.method.thing)
        )
        self._persons[person] = known
        while len(self._persons) > MOST_PERSONS:
            del self._persons[next(iter(self._persons))]
        return known

    def _follower(self, person: int) -> ForwardPerson:
        session, config = self._of.session, self._of.config
        return ForwardPerson(
            person,
            self._grid,
            partial(_tools_of, self._grid, session.fps, config),
            self._searches,
            seed=self._of.seed,
            settings=self._of.forward,
            given_m=stated_height_m(config, load_body_model(config.body_model("voxels")), session),
        )


def _tools_of(grid: VoxelGrid, fps: float, config: Config, height_m: float) -> VolumeTools:
    """Tools of a person of some height; of one thread: beside the others that are at work here none may fork."""
    model = config.body_model("voxels")
    return make_tools(grid, fps, height_m, model, config.pose, config.likelihood, 1, config.method)
