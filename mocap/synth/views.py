"""Views of every person, exactly, per camera: projected landmarks and markers, what hides them, tight boxes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mocap.data import LANDMARKS, Camera
from mocap.synth.body import Body
from mocap.synth.figure import JOINT, PARENTS
from mocap.synth.markers import Sight
from mocap.synth.render import CameraView, PosedScene
from mocap.synth.world import World

Array = NDArray[np.float64]
States = NDArray[np.uint8]

_TOLERANCE_M = 0.004  # a marker's own skin does not hide it
_THICKNESS_FACTOR, _THICKNESS_M = 2.0, 0.02


class Witness:
    """The truth of one camera's pictures, collected one by one.

    Per picture, landmark_states : (P, 15), marker_states : (P, M), codes of `Sight`, marker_uvs : (P, M, 2) px, boxes :
    (P, 4) px, tight boxes u0, v0, u1, v1.
    """

    def __init__(self, world: World) -> None:
        self._world = world
        self._flesh = [_Flesh(a.body) for a in world.actors]
        self._landmark_uv: list[Array] = []
        self.landmark_states: list[States] = []
        self.marker_uvs: list[Array] = []
        self.marker_states: list[States] = []
        self.boxes: list[Array] = []

    def look(self, view: CameraView, posed: PosedScene, instant: float, *, is_off: bool) -> None:
        """Add the picture that shows the bodies of `posed`, which are those of `instant`."""
        world = self._world
        P, M = len(world.actors), world.n_markers
        landmark_uv, marker_uv = np.full((P, len(LANDMARKS), 2), np.nan), np.full((P, M, 2), np.nan)
        landmark_state = np.full((P, len(LANDMARKS)), Sight.NOT_THERE, np.uint8)
        marker_state = np.full((P, M), Sight.NOT_THERE, np.uint8)
        box = np.full((P, 4), np.nan)
        for i, actor in enumerate(world.actors):
            if is_off or i not in posed.things:
                continue
            landmarks = actor.landmarks_at(instant)
            landmark_uv[i], landmark_state[i] = self._judge(view, posed, i, landmarks, is_marker=False)
            vertices, normals = posed.of(i)
            box[i] = _tight_box(view.camera, vertices)
            if actor.markers is not None:
                markers = actor.markers.positions(vertices, normals)
                marker_uv[i], marker_state[i] = self._judge(view, posed, i, markers, is_marker=True)
        self._landmark_uv.append(landmark_uv)
        self.landmark_states.append(landmark_state)
        self.marker_uvs.append(marker_uv)
        self.marker_states.append(marker_state)
        self.boxes.append(box)

    def save(self, path: Path, camera: Camera) -> None:
        """Write truth/views/CAM.npz; the arrays are explained in docs/synthetic.md."""
        path.parent.mkdir(parents=True, exist_ok=True)
        np.savez_compressed(
            path,
            persons=np.array([a.person for a in self._world.actors], dtype=np.int64),
            size_px=np.array(camera.size, dtype=np.int64),
            landmark_uv=np.stack(self._landmark_uv),
            landmark_state=np.stack(self.landmark_states),
            marker_uv=np.stack(self.marker_uvs),
            marker_state=np.stack(self.marker_states),
            box_px=np.stack(self.boxes),
        )

    def _judge(
        self, view: CameraView, posed: PosedScene, person: int, points: Array, *, is_marker: bool
    ) -> tuple[Array, States]:
        """Pixels (N, 2) and states (N,) of points (N, 3) of a person."""
        uv, _ = view.camera.project(points)
        distance = np.linalg.norm(points - view.camera.center, axis=1)
        hit = view.first_hits(points, posed)
        is_body = hit.body_m < np.minimum(hit.room_m, distance - _TOLERANCE_M)
        owner = np.array([self._world.owner_of_thing(posed, f) for f in hit.face])
        is_own = is_body & (owner == person)
        ball = np.array([self._world.ball_of_face(posed, f) for f in hit.face])
        if is_marker:
            hidden_by_self = is_own & (ball != np.arange(len(points)))
        else:
            flesh = self._flesh[person]
            first = posed.first_vertex[posed.things.index(person)]
            around = (ball >= 0) | flesh.is_around(posed.faces[hit.face] - first)
            hidden_by_self = is_own & ~(around & (distance - hit.body_m < flesh.limit_m))
        state = np.full(len(points), Sight.VISIBLE, np.uint8)
        state[hidden_by_self] = Sight.OWN_BODY
        state[is_body & ~is_own] = Sight.OTHER_PERSON
        state[hit.room_m < np.minimum(hit.body_m, distance - _TOLERANCE_M)] = Sight.FURNITURE
        state[~view.camera.contains(uv)] = Sight.OUTSIDE
        return uv, state


class _Flesh:
    """How much of a body's own flesh may lie before each landmark: a joint is inside, and yet it can be seen.

    limit_m : (15,) twice the distance from the joint to the skin, and a little.
    """

    def __init__(self, body: Body) -> None:
        self._bone = np.argmax(body.weights, axis=1)
        joints = [JOINT[name] for name in LANDMARKS]
        nearest = [np.linalg.norm(body.vertices - body.rest_position[j], axis=1).min() for j in joints]
        self.limit_m = _THICKNESS_FACTOR * np.array(nearest) + _THICKNESS_M
        self.limit_m[LANDMARKS.index("head")] = 2 * _THICKNESS_M  # the top of the head is on the skin
        self._meets = np.zeros((len(joints), len(PARENTS)), dtype=bool)
        for i, j in enumerate(joints):
            self._meets[i, [j, max(PARENTS[j], 0), *np.flatnonzero(j == PARENTS)]] = True

    def is_around(self, corners: NDArray[np.int64]) -> NDArray[np.bool_]:
        """Whether face i with corners (15, 3) belongs to a segment that meets at landmark i, (15,)."""
        known = np.all((corners >= 0) & (corners < len(self._bone)), axis=1)
        bones = self._bone[np.where(known[:, None], corners, 0)]
        return known & self._meets[np.arange(len(corners))[:, None], bones].any(axis=1)


def _tight_box(camera: Camera, vertices: Array) -> Array:
    """u0, v0, u1, v1 of the projected vertices within the picture, (4,) px; NaN when nothing is in it."""
    uv, _ = camera.project(vertices)
    uv = uv[np.isfinite(uv).all(axis=1)]
    if not len(uv):
        return np.full(4, np.nan)
    border = np.array(camera.size) - 0.5
    low, high = np.maximum(uv.min(axis=0), -0.5), np.minimum(uv.max(axis=0), border)
    return np.concatenate([low, high]) if np.all(low < high) else np.full(4, np.nan)
