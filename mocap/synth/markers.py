"""Markers on a body's skin: where they sit, how they look, and what a detector makes of them (CF 6.6.1)."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from mocap.errors import MocapError
from mocap.io.tables import write_detections_csv
from mocap.synth.body import Body
from mocap.synth.figure import JOINT, JOINTS, SIDES, forward_kinematics
from mocap.synth.section import Section

Array = NDArray[np.float64]
Detections = dict[str, tuple[NDArray[np.int64], Array]]


class Sight(IntEnum):
    """What truth/views says about a landmark or marker in a picture."""

    VISIBLE = 0
    OWN_BODY = 1
    OTHER_PERSON = 2
    FURNITURE = 3
    """Or a wall."""
    OUTSIDE = 4
    """The picture does not reach there."""
    NOT_THERE = 5
    """The person is not in the room, or the camera is off."""


class MarkerConfig(Section):
    """Twenty markers on every person, and the detector that is simulated on them."""

    detection_rate: float = Field(0.9, ge=0.0, le=1.0)
    """Probability that a visible marker is found. Source: CF 6.6.1, DR."""
    false_positives: float = Field(20.0, ge=0.0, le=1000.0)
    """Mean number of false detections per person and picture. Source: CF 6.6.1, FP."""
    noise_variance_px2: float = Field(4.0, ge=0.0)
    """Variance of u and of v. Source: CF 6.6.1."""
    seed: int | None = Field(None, ge=0)
    """Of the detector; not given: the scene's."""
    detections: bool = True
    """Write detections/."""
    balls: bool = False
    """Render the markers as yellow balls."""
    radius_m: float = Field(0.01, gt=0.0, le=0.1)
    """A marker is a ball that touches the skin; its place is its centre."""


@dataclass(frozen=True)
class Spot:
    """Where a marker sits: from `start` (a joint of the skeleton, shifted) along `direction` to the skin.

    start, direction, shift : in the joint's frame with hanging arms: x forward, y outwards of the side, z up; the
    shift in fractions of the stature.  part, joint : of the filter's bodies (docs/bodies.md).  origin : the joint of
    the skeleton that lies where `joint` does.
    """

    name: str
    start: str
    direction: tuple[float, float, float]
    part: str
    joint: str
    origin: str
    shift: tuple[float, float, float] = (0.0, 0.0, 0.0)
    sign: float = 1.0


def marker_spots() -> tuple[Spot, ...]:
    """The twenty markers: one at each landmark, and one on chest, hands and toes."""
    spots = [
        Spot("head", "head", (0, 0, 1), "head", "neck", "neck"),
        Spot("neck", "neck", (-1, 0, 0.2), "torso", "waist", "pelvis"),
        Spot("chest", "chest", (1, 0, 0), "torso", "waist", "pelvis", (0, 0, 0.06)),
        Spot("pelvis", "pelvis", (-1, 0, 0.15), "torso", "root", "pelvis"),
    ]
    for side, sign in SIDES:

        def put(
            name: str,
            start: str,
            direction: tuple[float, float, float],
            part: str,
            joint: str,
            shift: tuple[float, float, float] = (0, 0, 0),
            *,
            side: str = side,
            sign: float = sign,
        ) -> None:
            own = joint in ("root", "waist")
            spots.append(
                Spot(
                    f"{side}_{name}",
                    f"{side}_{start}",
                    direction,
                    part if part == "torso" else f"{side}_{part}",
                    joint if own else f"{side}_{joint}",
                    "pelvis" if own else f"{side}_{joint}",
                    shift,
                    sign,
                )
            )

        put("shoulder", "shoulder", (0, 1, 0.75), "torso", "waist")  # upwards when the arm is modelled spread
        put("elbow", "elbow", (0, 1, 0), "upper_arm", "shoulder")
        put("wrist", "wrist", (0, 1, 0), "forearm", "elbow")
        put("hand", "wrist", (0, 1, 0), "forearm", "elbow", (0, 0, -0.055))
        put("hip", "hip", (0.5, 1, 0), "torso", "root")
        put("knee", "knee", (0, 1, 0), "thigh", "hip")
        put("ankle", "ankle", (0, 1, 0), "shank", "knee")
        put("toe", "toe", (0, 0, 1), "shank", "knee")
    return tuple(spots)


@dataclass(frozen=True, eq=False)
class Markers:
    """The markers of one body.  vertex : (M,) that they touch.  offset : (M, 3) m, see `marker_offsets`."""

    spots: tuple[Spot, ...]
    vertex: NDArray[np.int64]
    offset: Array
    radius_m: float

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(s.name for s in self.spots)

    def positions(self, vertices: Array, normals: Array) -> Array:
        """Centres (M, 3) m, world, on posed vertices with unit normals, each (V, 3)."""
        return vertices[self.vertex] + self.radius_m * normals[self.vertex]


def place_markers(body: Body, radius_m: float) -> Markers:
    """Markers on the skin of a body, each at the vertex nearest to where its ray leaves the flesh."""
    spots = marker_spots()
    vertex = np.array([_vertex_at(body, spot) for spot in spots], dtype=np.int64)
    return Markers(spots, vertex, _offsets(body, spots, vertex, radius_m), radius_m)


def _vertex_at(body: Body, spot: Spot) -> int:
    j = JOINT[spot.start]
    outwards = np.array([1.0, spot.sign, 1.0])
    R = body.rest_rotation[j]
    start = body.rest_position[j] + R @ (np.array(spot.shift) * outwards * body.figure.stature_m)
    direction = R @ (np.array(spot.direction) * outwards)
    direction /= np.linalg.norm(direction)
    distance = _leaves_at(body.vertices[body.faces], start, direction)
    if not np.isfinite(distance):
        raise RuntimeError(f"marker {spot.name}: no skin beyond joint {spot.start}")
    at = start + distance * direction
    return int(np.argmin(np.linalg.norm(body.vertices - at, axis=1)))


def _leaves_at(triangles: Array, start: Array, direction: Array) -> float:
    """Distance at which a ray from inside leaves the mesh, triangles (F, 3, 3); inf when it never does.

    Source: Moeller and Trumbore 1997, vectorised over the triangles.
    """
    a, ab, ac = triangles[:, 0], triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    across = np.cross(direction, ac)
    det = np.einsum("fi,fi->f", ab, across)
    with np.errstate(divide="ignore", invalid="ignore"):
        from_a = start - a
        u = np.einsum("fi,fi->f", from_a, across) / det
        second = np.cross(from_a, ab)
        v = second @ direction / det
        t = np.einsum("fi,fi->f", ac, second) / det
    inside = (u >= -1e-9) & (v >= -1e-9) & (u + v <= 1 + 1e-9) & (t > 1e-6) & np.isfinite(t)
    return float(t[inside].min()) if inside.any() else float("inf")


def _offsets(body: Body, spots: tuple[Spot, ...], vertex: NDArray[np.int64], radius_m: float) -> Array:
    """Marker minus joint of a person that stands with hanging arms, (M, 3) m, in the joint's frame at rest.

    At rest the filter's bodies stretch the arms along +-y, so what the arms carry is turned up by 90 degrees.
    """
    rotations = np.tile(np.eye(3), (1, len(JOINTS), 1, 1))
    position, rotation = forward_kinematics(body.figure.offsets, rotations, np.zeros((1, 3)))
    vertices, normals = body.pose(position[0], rotation[0])
    at = vertices[vertex] + radius_m * normals[vertex]
    out = at - position[0][[JOINT[s.origin] for s in spots]]
    for i, spot in enumerate(spots):
        if spot.joint.endswith(("_shoulder", "_elbow")):
            x, y, z = out[i]
            out[i] = (x, -spot.sign * z, spot.sign * y)
    return out


# --- yellow balls -------------------------------------------------------------------------------------------

_YELLOW = (0.72, 0.55, 0.02)


@dataclass(frozen=True, eq=False)
class Balls:
    """The markers of one person as a thing to render: vertices (V, 3) at rest, faces (F, 3)."""

    markers: Markers

    @cached_property
    def _sphere(self) -> tuple[Array, NDArray[np.int64]]:
        return _icosphere()

    @property
    def n_vertices_each(self) -> int:
        return len(self._sphere[0])

    @cached_property
    def vertices(self) -> Array:
        return np.tile(self._sphere[0], (len(self.markers.vertex), 1))

    @cached_property
    def faces(self) -> NDArray[np.int64]:
        n = self.n_vertices_each
        return np.concatenate([self._sphere[1] + i * n for i in range(len(self.markers.vertex))])

    def pose(self, centers: Array) -> tuple[Array, Array]:
        """Vertices and normals, each (V, 3), of balls at centres (M, 3)."""
        normals = self.vertices
        return np.repeat(centers, self.n_vertices_each, axis=0) + self.markers.radius_m * normals, normals


class BallLook:
    """Yellow all over."""

    def albedo(self, body: object, rest: Array) -> Array:
        """Linear RGB (N, 3)."""
        return np.tile(_YELLOW, (len(rest), 1))


def _icosphere() -> tuple[Array, NDArray[np.int64]]:
    """Unit sphere of 42 vertices and 80 faces."""
    g = (1 + 5**0.5) / 2
    points: list[tuple[float, float, float]]
    points = [(-1, g, 0), (1, g, 0), (-1, -g, 0), (1, -g, 0), (0, -1, g), (0, 1, g)]
    points += [(0, -1, -g), (0, 1, -g), (g, 0, -1), (g, 0, 1), (-g, 0, -1), (-g, 0, 1)]
    vertices = [np.array(p) / np.linalg.norm(p) for p in points]
    coarse = "0 11 5 0 5 1 0 1 7 0 7 10 0 10 11 1 5 9 5 11 4 11 10 2 10 7 6 7 1 8 3 9 4 3 4 2 3 2 6 3 6 8 3 8 9 4 9 5"
    coarse += " 2 4 11 6 2 10 8 6 7 9 8 1"
    middle: dict[tuple[int, int], int] = {}

    def between(a: int, b: int) -> int:
        key = (min(a, b), max(a, b))
        if key not in middle:
            half = vertices[a] + vertices[b]
            vertices.append(half / np.linalg.norm(half))
            middle[key] = len(vertices) - 1
        return middle[key]

    faces = []
    for a, b, c in np.array(coarse.split(), dtype=int).reshape(-1, 3):
        ab, bc, ca = between(a, b), between(b, c), between(c, a)
        faces += [(a, ab, ca), (b, bc, ab), (c, ca, bc), (ab, bc, ca)]
    return np.array(vertices), np.array(faces, dtype=np.int64)


# --- the simulated detector ---------------------------------------------------------------------------------


def simulate_detector(
    uv: Array,
    visible: NDArray[np.bool_],
    box: Array,
    size: tuple[int, int],
    *,
    detection_rate: float,
    false_positives: float,
    noise_variance_px2: float,
    rng: np.random.Generator,
) -> tuple[NDArray[np.int64], Array]:
    """What a marker detector finds in the pictures of one camera: frame (n,) ascending, uv (n, 2) px.

    uv : (F, P, M, 2) px, projected markers.  visible : (F, P, M).  box : (F, P, 4) px, tight box u0, v0, u1, v1 of
    each projected person, NaN = not in the picture.  size : (width, height) px.
    A visible marker is found with probability `detection_rate`. Each person in the picture adds a whole number of
    false detections, uniform in 0 .. 2 `false_positives`, uniform over its box. All get Gaussian noise. What falls
    outside the picture is lost. Within a frame the detections are sorted by u, which hides their identity.
    Source: CF 6.6.1, steps 3 to 5. Departs: the false detections are counted per person.
    """
    F, P, M = visible.shape
    found = visible & (rng.uniform(size=(F, P, M)) < detection_rate)
    n_false = rng.integers(0, int(np.floor(2 * false_positives)) + 1, size=(F, P))
    n_false[~np.isfinite(box).all(axis=2)] = 0
    at_frame, at_person = (np.repeat(index.ravel(), n_false.ravel()) for index in np.indices((F, P)))
    corner = box[at_frame, at_person]
    false = corner[:, :2] + rng.uniform(size=(len(corner), 2)) * (corner[:, 2:] - corner[:, :2])
    frame = np.concatenate([np.nonzero(found)[0], at_frame]).astype(np.int64)
    out = np.concatenate([uv[found], false]).reshape(-1, 2)
    out = out + np.sqrt(noise_variance_px2) * rng.standard_normal(out.shape)
    inside = np.all((out >= -0.5) & (out < np.array(size) - 0.5), axis=1)
    frame, out = frame[inside], out[inside]
    order = np.lexsort((out[:, 1], out[:, 0], frame))
    return frame[order], out[order]


def make_detections(
    session: Path | str,
    *,
    detection_rate: float = 0.9,
    false_positives: float = 20.0,
    noise_variance_px2: float = 4.0,
    rng: np.random.Generator,
) -> Detections:
    """Detections of all cameras of a synthetic session with markers, from its truth, without rendering again.

    Returns camera name -> frame (n,) ascending, uv (n, 2) px. The cameras draw in the order of their names.
    Raises MocapError when the session has no truth of markers.
    """
    files = sorted((Path(session) / "truth" / "views").glob("*.npz"))
    out: Detections = {}
    for path in files:
        with np.load(path) as data:
            if data["marker_uv"].shape[2] == 0:
                continue
            out[path.stem] = simulate_detector(
                data["marker_uv"].astype(np.float64),
                data["marker_state"] == Sight.VISIBLE,
                data["box_px"].astype(np.float64),
                (int(data["size_px"][0]), int(data["size_px"][1])),
                detection_rate=detection_rate,
                false_positives=false_positives,
                noise_variance_px2=noise_variance_px2,
                rng=rng,
            )
    if not out:
        raise MocapError(
            "the session has no truth of markers",
            path=Path(session),
            remedy="synthesise a scene with a [markers] section",
        )
    return out


def write_detections(session: Path | str, detections: Detections) -> None:
    """Write detections/CAM.csv of a session folder."""
    folder = Path(session) / "detections"
    folder.mkdir(parents=True, exist_ok=True)
    for name, (frame, uv) in detections.items():
        write_detections_csv(folder / f"{name}.csv", frame, uv)
