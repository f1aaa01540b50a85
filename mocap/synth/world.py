"""The world of a scene: room, cameras, bodies and motions, made concrete by a seed."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from mocap.data import Camera, CameraRig
from mocap.errors import MocapError
from mocap.synth.body import Body
from mocap.synth.carried import Carried, with_both_hands
from mocap.synth.faults import Timeline, moved_cameras, room_faults, timeline
from mocap.synth.figure import JOINT, forward_kinematics, landmarks_of
from mocap.synth.furniture import furniture_boxes
from mocap.synth.looks import Look
from mocap.synth.markers import BallLook, Balls, Markers, marker_spots, place_markers
from mocap.synth.motions import MOTIONS, Pose
from mocap.synth.persons import Person, cast, loads_of
from mocap.synth.render import Paint, PosedScene, Thing, posed_scene
from mocap.synth.rigs import make_rig
from mocap.synth.rooms import Room, box_corners, make_room
from mocap.synth.scene import Scene

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Actor:
    """One person of a prepared scene.

    pose : the motion, of which the session's frame 0 is frame `lead`; position : (M, J, 3) m, rotation :
    (M, J, 3, 3), world, all of its frames.  landmarks : (T, 15, 3) m, the session's frames.
    """

    person: int
    body: Body
    look: Look
    pose: Pose
    position: Array
    rotation: Array
    landmarks: Array
    lead: int = 0
    markers: Markers | None = None
    loads: tuple[Carried, ...] = ()

    def joints(self, instant: float) -> tuple[Array, Array]:
        """Positions (J, 3) m and rotations (J, 3, 3) at an instant, in frames of the session.

        Between frames every joint turns at constant speed. Instants beyond the motion give its ends.
        """
        at = min(max(instant + self.lead, 0.0), len(self.position) - 1.0)
        k = int(at)
        share = at - k
        if share < 1e-9:
            return self.position[k], self.rotation[k]
        first = Rotation.from_matrix(self.pose.rotations[k])
        turn = (first.inv() * Rotation.from_matrix(self.pose.rotations[k + 1])).as_rotvec()
        local = (first * Rotation.from_rotvec(share * turn)).as_matrix()
        root = (1 - share) * self.pose.root_position[k] + share * self.pose.root_position[k + 1]
        position, rotation = forward_kinematics(self.body.figure.offsets, local[None], root[None])
        return position[0], rotation[0]

    def landmarks_at(self, instant: float) -> Array:
        """The landmarks (15, 3) m at an instant, in frames of the session."""
        position, rotation = self.joints(instant)
        return landmarks_of(self.body.figure, position[None], rotation[None])[0]

    def head_at(self, instant: float) -> Array:
        """Middle of the head, (3,) m: halfway from the joint under the skull to its top."""
        position, rotation = self.joints(instant)
        j = JOINT["head"]
        return position[j] + rotation[j] @ (0.5 * self.body.figure.head_top)

    def posed(self, instant: float) -> tuple[Array, Array]:
        """Vertices and normals (V, 3) at an instant, in frames of the session."""
        return self.body.pose(*self.joints(instant))


@dataclass(frozen=True, eq=False)
class World:
    """A scene made concrete by its seed.

    rig : the cameras as calibrated.  cameras : per camera its poses, as calibrated and after each move.
    timelines : per camera what each of its pictures shows.
    """

    scene: Scene
    seed: int
    room: Room
    rig: CameraRig
    cameras: dict[str, tuple[Camera, ...]]
    timelines: dict[str, Timeline]
    actors: tuple[Actor, ...]

    def rng(self, *address: int) -> np.random.Generator:
        """The generator of one address of this world."""
        return rng_at(self.seed, *address)

    def room_in(self, state: int) -> Room:
        """The room in a state of a timeline: with new obstacles and switched lamps."""
        room = self.room
        for bit, fault in enumerate(room_faults(self.scene.faults)):
            if state >> bit & 1 and fault.kind == "obstacle":
                box = box_corners(np.array(fault.lower_m), np.array(fault.upper_m))
                rgb = np.array([[0.16, 0.19, 0.24]])
                room = replace(
                    room,
                    furniture=np.concatenate([room.furniture, box[None]]),
                    furniture_rgb=np.concatenate([room.furniture_rgb, rgb]),
                )
            elif state >> bit & 1:
                lights = list(room.lights)
                lights[fault.lamp] = replace(lights[fault.lamp], power=lights[fault.lamp].power * fault.gain)
                room = replace(room, lights=tuple(lights))
        return room

    @property
    def n_markers(self) -> int:
        """Markers per person."""
        return 0 if self.scene.markers is None else len(marker_spots())

    @cached_property
    def balls(self) -> tuple[Balls, ...]:
        """The markers to be rendered, one thing per person."""
        is_seen = self.scene.markers is not None and self.scene.markers.balls
        return tuple(Balls(a.markers) for a in self.actors if is_seen and a.markers is not None)

    @property
    def bodies(self) -> tuple[Body, ...]:
        return tuple(a.body for a in self.actors)

    @cached_property
    def things(self) -> tuple[Thing, ...]:
        """All that is rendered: the bodies of the persons, then their balls in the same order, then what they carry."""
        return (*self.bodies, *self.balls, *self._loads)

    @property
    def _loads(self) -> tuple[Carried, ...]:
        return tuple(load for a in self.actors for load in a.loads)

    @cached_property
    def _owners(self) -> tuple[int, ...]:
        """The person of each thing, an index."""
        P = len(self.actors)
        loads = (i for i, a in enumerate(self.actors) for _ in a.loads)
        return (*range(P), *range(len(self.balls)), *loads)

    @cached_property
    def looks(self) -> tuple[Paint, ...]:
        """The colours of the things."""
        return (*(a.look for a in self.actors), *(BallLook() for _ in self.balls), *self._loads)

    def owner_of_thing(self, posed: PosedScene, face: int) -> int:
        """Index of the person that a face of the posed scene belongs to, -1 for none."""
        return -1 if face < 0 else self._owners[self._thing_of_face(posed, face)[0]]

    def ball_of_face(self, posed: PosedScene, face: int) -> int:
        """Index of the marker whose ball a face of the posed scene belongs to, -1 for none."""
        if face < 0:
            return -1
        thing, vertex = self._thing_of_face(posed, face)
        k = thing - len(self.actors)
        return vertex // self.balls[k].n_vertices_each if 0 <= k < len(self.balls) else -1

    def _thing_of_face(self, posed: PosedScene, face: int) -> tuple[int, int]:
        """The thing that a face belongs to, and its first vertex within the thing."""
        vertex = int(posed.faces[face, 0])
        i = int(np.searchsorted(posed.first_vertex[1:], vertex, side="right"))
        return posed.things[i], vertex - posed.first_vertex[i]

    def at(self, instant: float, *, with_light: bool = True) -> PosedScene:
        """All bodies at an instant, in frames of the session, ready for ray casting."""
        posed = {i: a.posed(instant) for i, a in enumerate(self.actors)}
        posed = {i: p for i, p in posed.items() if self.room.holds_some(p[0])}
        for k, balls in enumerate(self.balls):
            if k in posed:
                posed[len(self.actors) + k] = balls.pose(balls.markers.positions(*posed[k]))
        for k, load in enumerate(self._loads, start=len(self.actors) + len(self.balls)):
            if (owner := self._owners[k]) in posed:
                posed[k] = load.pose(*self.actors[owner].joints(instant))
        return posed_scene(
            tuple(self.things[i] for i in posed),
            list(posed.values()),
            self.room,
            things=tuple(posed),
            with_light=with_light,
        )


def rng_at(seed: int, *address: int) -> np.random.Generator:
    """The generator of one address; independent of every other address and of the order of use."""
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=address))


def build_world(scene: Scene, *, seed: int | None = None) -> World:
    """Room, rig, bodies and motions of a scene.

    seed : replaces the scene's seed and moves the persons' seeds along with it.
    """
    base = scene.seed if seed is None else seed
    furniture, tint = furniture_boxes(scene.room.furniture)
    room = make_room(
        scene.room.size_m, floor=scene.room.floor, furniture=furniture, tint=tint, rng=rng_at(base, 1)
    )
    rig = make_rig(scene.rig, room, rng=rng_at(base, 2))
    cameras = {c.name: moved_cameras(c, scene.faults) for c in rig}
    timelines = {n: timeline(n, scene.faults, scene.n_frames, scene.fps) for n in rig.names}
    shutter_frames = (scene.picture.exposure_ms + scene.picture.readout_ms) / 1000 * scene.fps / 2
    lead = max(0, int(np.ceil(shutter_frames - min(t.instant.min() for t in timelines.values()))))
    last = max(float(t.instant.max()) for t in timelines.values()) + shutter_frames
    n_motion = lead + max(scene.n_frames, int(np.ceil(last)) + 1)
    shift = 0 if seed is None else seed * 7919
    actors = tuple(
        _actor(scene, room, i + 1, person, person.seed + shift, lead=lead, n_motion=n_motion)
        for i, person in enumerate(scene.persons)
    )
    return World(scene, base, room, rig, cameras, timelines, actors)


def _actor(
    scene: Scene, room: Room, number: int, person: Person, seed: int, *, lead: int, n_motion: int
) -> Actor:
    """One person; the motion begins `lead` frames before the session and has `n_motion` frames."""
    body, look = cast(person, room, lambda k: rng_at(seed, k))
    arguments = person.motion.arguments()
    if "start_s" in arguments:
        arguments["start_s"] += lead / scene.fps
    if person.motion.kind == "fall":
        arguments["body"] = body  # what touches the floor is the flesh that is rendered
    try:
        pose = MOTIONS[person.motion.kind](body.figure, n_motion, scene.fps, rng=rng_at(seed, 6), **arguments)
    except ValueError as error:  # what only this body cannot do, such as a seat too high for its legs
        raise MocapError(f"persons.{number - 1}.motion: {error}", remedy="correct the scene file") from error
    if any(load.kind == "crate" for load in person.carries):
        pose = with_both_hands(body.figure, pose)
    position, rotation = forward_kinematics(body.figure.offsets, pose.rotations, pose.root_position)
    landmarks = landmarks_of(body.figure, position, rotation)[lead : lead + scene.n_frames]
    markers = None if scene.markers is None else place_markers(body, scene.markers.radius_m)
    loads = loads_of(person, room, body)
    return Actor(number, body, look, pose, position, rotation, landmarks, lead, markers, loads)
