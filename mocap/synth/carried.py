"""Things that people carry: a stick or a racket in the fist, a bag that hangs from it, a rucksack, a crate before them.

They are seen as people are, cast shadows and belong to the silhouettes; the truth of landmarks, volumes and voxels is
that of people without them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from mocap.synth.figure import JOINT, SIDES, Figure, forward_kinematics, rotation_about
from mocap.synth.motions import Pose
from mocap.synth.motions.kit import solve_arms

if TYPE_CHECKING:
    from trimesh import Trimesh

Array = NDArray[np.float64]

_EDGE_M = 0.03  # longest edge: rays are cast near projected vertices alone
_GRIP = 0.060  # from the wrist to the middle of the fist, of the stature
_BACK = (-0.085, 0.0, 0.02)  # from the joint of the chest to where a rucksack hangs, of the stature
_BEFORE = (0.195, 0.0, -0.03)  # from the joint of the chest to the middle of a crate, of the stature
_CRATE_M = (0.30, 0.40, 0.26)
_AT_ITS_SIDE_M = (-0.04, 0.23, -0.08)  # the left wrist, from the middle of a crate
_ELBOWS = (-0.6, 0.5, -0.6)  # behind, beside and below: where they point, as (forward, outward, up)
_SHAFT_DOWN_RAD = np.deg2rad(20.0)  # what a hanging arm holds points forward and a little down
_BEHIND_M = 0.10  # of a shaft, behind the fist
_USUAL_STATURE_M = 1.75  # bags, rucksacks and crates are as large as who carries them


@dataclass(frozen=True, eq=False)
class Carried:
    """A thing that is carried, to be rendered: vertices (V, 3) m round its handle, faces (F, 3), unit normals (V, 3).

    joint : that carries it.  at : (3,) m, the handle in the joint's frame.  hangs : it stays upright, and turns with
    the joint's heading alone.  rgb : (3,) linear.
    """

    vertices: Array
    faces: NDArray[np.int64]
    normals: Array
    joint: int
    at: Array
    hangs: bool
    rgb: Array

    def pose(self, position: Array, rotation: Array) -> tuple[Array, Array]:
        """Vertices and unit normals, each (V, 3), on joints at (J, 3) m with rotations (J, 3, 3), world."""
        R = rotation[self.joint]
        place = position[self.joint] + R @ self.at
        if self.hangs:
            R = rotation_about(2, _heading(R))
        return place + self.vertices @ R.T, self.normals @ R.T

    def albedo(self, body: Any, rest: Array) -> Array:
        """Linear RGB (N, 3)."""
        return np.tile(self.rgb, (len(rest), 1))


def carried(kind: str, hand: str, figure: Figure, rgb: Array) -> Carried:
    """Something on a figure.  kind : one of KINDS.  hand : left or right; of a rucksack and a crate none.

    rgb : (3,) linear.
    """
    joint, at = JOINT[f"{hand}_wrist"], (0.0, 0.0, -_GRIP)
    if kind == "rucksack":
        joint, at = JOINT["chest"], _BACK
    elif kind == "crate":
        joint, at = JOINT["chest"], _BEFORE
    corners = _triangles(KINDS[kind]())
    if kind in ("bag", "rucksack", "crate"):
        corners *= figure.stature_m / _USUAL_STATURE_M
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return Carried(
        vertices=corners.reshape(-1, 3),  # every face has corners of its own: edges are sharp
        faces=np.arange(3 * len(corners)).reshape(-1, 3),
        normals=np.repeat(normals, 3, axis=0),
        joint=joint,
        at=np.array(at) * figure.stature_m,
        hangs=kind in ("bag", "crate"),
        rgb=rgb,
    )


def with_both_hands(figure: Figure, pose: Pose) -> Pose:
    """A motion whose arms hold a crate before the trunk, whatever they did."""
    chest, scale = JOINT["chest"], figure.stature_m / _USUAL_STATURE_M
    rotations = pose.rotations.copy()
    for side, _ in SIDES:
        rotations[:, [JOINT[f"{side}_clavicle"], JOINT[f"{side}_wrist"]]] = np.eye(3)
    position, rotation = forward_kinematics(figure.offsets, rotations, pose.root_position)
    R = rotation[:, chest]
    heading = _heading(R)
    middle = position[:, chest] + R @ np.array(_BEFORE) * figure.stature_m
    goals = []
    for side, sign in SIDES:
        off = (middle - position[:, JOINT[f"{side}_shoulder"]])[:, None] @ rotation_about(2, heading)
        goals.append(off[:, 0] * (1.0, sign, 1.0) + np.array(_AT_ITS_SIDE_M) * scale)
    poles = [np.tile(_ELBOWS, (len(R), 1)) for _ in SIDES]
    solve_arms(figure, rotations, pose.root_position, goals, poles, heading=heading)
    return replace(pose, rotations=rotations)


def _heading(R: Array) -> Array:
    """Of frames (..., 3, 3), rad."""
    return np.asarray(np.arctan2(R[..., 1, 0], R[..., 0, 0]))


def _triangles(mesh: Trimesh) -> Array:
    """The faces of a mesh, (F, 3, 3) m, none with an edge that is longer than _EDGE_M."""
    from trimesh.remesh import subdivide_to_size

    vertices, faces = subdivide_to_size(mesh.vertices, mesh.faces, _EDGE_M)
    return np.asarray(vertices, dtype=np.float64)[faces]


def _shaft(length_m: float, radius_m: float) -> Trimesh:
    """A rod along x, a piece of it behind the fist."""
    from trimesh.creation import cylinder

    return cylinder(radius_m, segment=[[-_BEHIND_M, 0, 0], [length_m - _BEHIND_M, 0, 0]], sections=12)


def _stick() -> Trimesh:
    return _lowered(_shaft(0.95, 0.013))


def _racket() -> Trimesh:
    """A handle and a frame without strings."""
    from trimesh import util
    from trimesh.creation import torus

    frame = torus(0.14, 0.011, major_sections=32, minor_sections=8)
    frame.vertices = frame.vertices * (1.2, 1.0, 1.0) @ rotation_about(0, np.pi / 2).T + (0.44, 0.0, 0.0)
    return _lowered(util.concatenate([_shaft(0.38, 0.015), frame]))


def _bag() -> Trimesh:
    from trimesh import util
    from trimesh.creation import box, cylinder

    body = box([0.34, 0.12, 0.30])
    body.apply_translation([0.0, 0.0, -0.29])
    straps = [cylinder(0.008, segment=[[0, 0, 0], [x, 0, -0.14]], sections=8) for x in (-0.12, 0.12)]
    return util.concatenate([body, *straps])


def _rucksack() -> Trimesh:
    from trimesh.creation import capsule

    body = capsule(height=0.26, radius=0.13)
    body.vertices = body.vertices * (0.75, 1.1, 1.0) + (-0.06, 0.0, -0.13)
    return body


def _crate() -> Trimesh:
    from trimesh.creation import box

    return box(_CRATE_M)


def _lowered(mesh: Trimesh) -> Trimesh:
    """What points along x, a little down."""
    mesh.vertices = mesh.vertices @ rotation_about(1, _SHAFT_DOWN_RAD).T
    return mesh


KINDS: Mapping[str, Callable[[], Trimesh]] = {
    "stick": _stick,
    "racket": _racket,
    "bag": _bag,
    "rucksack": _rucksack,
    "crate": _crate,
}
