"""Anatomical angles by published definitions, from the pelvis to toes, wrists and head.

A segment frame is parallel to the body's (x forward, y to the person's left, z up) when the person stands upright with
arms hanging, palms to the thighs and feet pointing forward; x, z and -y are the X, Y and Z of the ISB. A joint angle
is a Cardan angle of the distal segment's frame against the proximal one's, in the sequence that the ISB recommends:
flexion about the proximal segment's lateral axis, rotation about the distal segment's long axis, adduction about the
floating axis between (Grood and Suntay 1983; Wu et al. 2002, 2005). Left limbs are mirrored, so that equal movements
have equal signs. docs/angles.md has the table of signs.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from mocap.arrays import Array
from mocap.geometry.rigid import wrap_angle

# Rows: X (forward), Y (up), Z (to the right) of the ISB in our frame.
ISB_FROM_OURS: Array = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
_MIRROR = np.diag([1.0, 1.0, -1.0])  # left to right, in ISB axes

# Segment -> the joints whose frame may carry it, from the root outwards: the last one that a skeleton has, does.
_TRUNK: dict[str, tuple[str, ...]] = {
    "pelvis": ("root", "pelvis"),
    "lumbar": ("waist", "spine", "lumbar"),
    "thorax": ("waist", "spine", "lumbar", "thorax", "chest"),
    "head": ("neck", "head"),
}
_LIMBS: dict[str, tuple[str, ...]] = {
    "upper_arm": ("shoulder",),
    "forearm": ("elbow", "forearm"),
    "hand": ("wrist", "hand"),
    "thigh": ("hip",),
    "shank": ("knee",),
    "foot": ("ankle", "subtalar", "foot"),
    "toes": ("mtp", "toe", "toes"),
}
_SIDES = ("left", "right")
# Limb segments that hang along -z in the standing pose: each takes its direction at rest from its own chain of joints.
_ARM = ("upper_arm", "forearm", "hand")


@dataclass(frozen=True)
class Joint:
    """Where two segments meet, and how their angles are called.

    proximal : None = the world.  sequence : axes of the rotations, in ISB letters.  angles : (name, sign) in that
    order.
    """

    name: str
    proximal: str | None
    distal: str
    sequence: str
    angles: tuple[tuple[str, float], ...]

    def of_side(self, side: str) -> Joint:
        """The joint of one side of the body."""
        return Joint(
            f"{side}_{self.name}",
            self.proximal if self.proximal in _TRUNK else f"{side}_{self.proximal}",
            f"{side}_{self.distal}",
            self.sequence,
            self.angles,
        )

    @property
    def is_left(self) -> bool:
        return self.name.startswith("left_")

    @property
    def names(self) -> tuple[str, ...]:
        """Full names of its angles, `left_hip_flexion`."""
        return tuple(f"{self.name}_{angle}" for angle, _ in self.angles)


_MIDDLE = (
    # Rotation, obliquity, tilt: the sequence of Baker 2001, in which a heading is a heading at any tilt.
    Joint("pelvis", None, "pelvis", "YXZ", (("rotation", 1.0), ("obliquity", 1.0), ("tilt", -1.0))),
    Joint("trunk", "pelvis", "thorax", "ZXY", (("flexion", -1.0), ("bending", 1.0), ("rotation", 1.0))),
    # The two halves of the trunk's angles, of a body whose spine bends at two places.
    Joint("lumbar", "pelvis", "lumbar", "ZXY", (("flexion", -1.0), ("bending", 1.0), ("rotation", 1.0))),
    Joint("thoracic", "lumbar", "thorax", "ZXY", (("flexion", -1.0), ("bending", 1.0), ("rotation", 1.0))),
    Joint("neck", "thorax", "head", "ZXY", (("flexion", -1.0), ("bending", 1.0), ("rotation", 1.0))),
)
_PAIRED = (
    Joint("hip", "pelvis", "thigh", "ZXY", (("flexion", 1.0), ("adduction", 1.0), ("rotation", 1.0))),
    Joint("knee", "thigh", "shank", "ZXY", (("flexion", -1.0), ("adduction", 1.0), ("rotation", 1.0))),
    Joint("ankle", "shank", "foot", "ZXY", (("dorsiflexion", 1.0), ("inversion", 1.0), ("rotation", 1.0))),
    Joint("mtp", "foot", "toes", "ZXY", (("extension", 1.0), ("adduction", 1.0), ("rotation", 1.0))),
    # The ISB's sequence for the shoulder has no flexion and is singular in a hanging arm, the other one in an arm
    # that is held out to the side: both are given.
    Joint(
        "shoulder", "thorax", "upper_arm", "ZXY", (("flexion", 1.0), ("adduction", 1.0), ("rotation", 1.0))
    ),
    Joint(
        "shoulder",
        "thorax",
        "upper_arm",
        "YXY",
        (("plane", 1.0), ("elevation", 1.0), ("axial_rotation", 1.0)),
    ),
    Joint("elbow", "upper_arm", "forearm", "ZXY", (("flexion", 1.0), ("carrying", -1.0), ("pronation", 1.0))),
    # Palms to the thighs: the hand flexes about the axis that points forward.
    Joint("wrist", "forearm", "hand", "XZY", (("flexion", 1.0), ("deviation", -1.0), ("rotation", 1.0))),
)
JOINTS: tuple[Joint, ...] = (*_MIDDLE, *(joint.of_side(side) for side in _SIDES for joint in _PAIRED))
# All angles that there are; a body has those that its joints allow.
ANATOMICAL_ANGLES: tuple[str, ...] = tuple(name for joint in JOINTS for name in joint.names)


def segment_joints(names: Sequence[str]) -> dict[str, int]:
    """Segment -> index of the joint whose frame carries it, of the segments that a skeleton with these joints has."""
    limbs = {
        f"{side}_{segment}": tuple(f"{side}_{joint}" for joint in joints)
        for side in _SIDES
        for segment, joints in _LIMBS.items()
    }
    found = {}
    for segment, candidates in {**_TRUNK, **limbs}.items():
        own = [name for name in candidates if name in names]
        if own:
            found[segment] = list(names).index(own[-1])
    if found.get("lumbar") == found.get("thorax"):  # one joint bends the whole spine
        found.pop("lumbar", None)
    return found


def standing_rotations(names: Sequence[str], offsets: Array, pitch: Array | None = None) -> dict[str, Array]:
    """Segment -> rotation (3, 3) that takes the rest pose to standing upright with hanging arms.

    offsets : (J, 3) m, every joint in its parent's frame at rest. An arm that rests along +-y hangs after a quarter
    turn.  pitch : (J,) rad, how far frames of the other joints lean forwards then; None = as at rest.
    """
    at = segment_joints(names)
    out = {
        segment: np.eye(3) if pitch is None else Rotation.from_euler("y", pitch[joint]).as_matrix()
        for segment, joint in at.items()
    }
    for side in _SIDES:
        elbow = at.get(f"{side}_forearm")
        if elbow is None:
            continue
        first = list(names).index(f"{side}_elbow") if f"{side}_elbow" in names else elbow
        along = offsets[first] / np.linalg.norm(offsets[first])
        turn = Rotation.align_vectors([[0.0, 0.0, -1.0], [1.0, 0.0, 0.0]], [along, [1.0, 0.0, 0.0]])[0]
        out.update({f"{side}_{s}": turn.as_matrix() for s in _ARM if f"{side}_{s}" in at})
    return out


def world_rotations(parents: NDArray[np.int64], local: Array) -> Array:
    """Orientations of joints in the world, (T, J, 3, 3), from those in their parents; parents come first."""
    world = local.copy()
    for j, parent in enumerate(parents):
        if parent >= 0:
            world[:, j] = world[:, parent] @ local[:, j]
    return world


def segment_frames(
    names: Sequence[str], offsets: Array, rotations: Array, pitch: Array | None = None
) -> dict[str, Array]:
    """Segment -> orientation of its frame, (T, 3, 3), world, of every segment that the skeleton has.

    names : J joints.  offsets : (J, 3) m in the parent's frame at rest.  rotations : (T, J, 3, 3) of the joints, world.
    pitch : as in `standing_rotations`.
    """
    standing = standing_rotations(names, offsets, pitch)
    return {
        segment: rotations[:, joint] @ standing[segment].T for segment, joint in segment_joints(names).items()
    }


def joints_of(segments: Sequence[str]) -> Iterator[Joint]:
    """The joints whose segments are all there."""
    for joint in JOINTS:
        if joint.distal in segments and (joint.proximal is None or joint.proximal in segments):
            yield joint


def anatomical_angles(segments: Mapping[str, Array]) -> dict[str, Array]:
    """Angle -> values (T,) rad in (-pi, pi], of every joint whose segments are there; NaN where a frame is.

    segments : name -> orientation of its frame (T, 3, 3), world, as of `segment_frames`.
    Where a sequence is singular (its middle angle at +-90 degrees, an elevation of 0 or 180) its last angle is 0.
    """
    found: dict[str, Array] = {}
    for joint in joints_of(tuple(segments)):
        found |= angles_of_joint(joint, segments)
    return found


def angles_of_joint(joint: Joint, segments: Mapping[str, Array]) -> dict[str, Array]:
    """The three angles of one joint, as `anatomical_angles` has them."""
    signs = (sign for _, sign in joint.angles)
    columns = cardan_angles(joint, segments).T
    return {
        name: np.asarray(wrap_angle(sign * values))
        for name, sign, values in zip(joint.names, signs, columns, strict=True)
    }


def cardan_angles(joint: Joint, segments: Mapping[str, Array]) -> Array:
    """The three angles of a joint in its sequence, (T, 3) rad, before their signs."""
    distal = segments[joint.distal]
    known = np.asarray(np.isfinite(distal).all(axis=(1, 2)))
    relative = np.where(known[:, None, None], distal, np.eye(3))
    if joint.proximal is not None:
        proximal = segments[joint.proximal]
        known = np.asarray(known & np.isfinite(proximal).all(axis=(1, 2)))
        relative = np.where(known[:, None, None], proximal.transpose(0, 2, 1) @ relative, np.eye(3))
    relative = ISB_FROM_OURS @ relative @ ISB_FROM_OURS.T
    if joint.is_left:
        relative = _MIRROR @ relative @ _MIRROR
    angles = np.asarray(
        Rotation.from_matrix(relative).as_euler(joint.sequence, suppress_warnings=True), dtype=np.float64
    )
    if joint.sequence == "YXY":
        # The same rotation with a negative elevation, as the ISB has it; called positive upwards here.
        angles = np.stack(
            [wrap_angle(angles[:, 0] - np.pi), angles[:, 1], wrap_angle(angles[:, 2] + np.pi)], 1
        )
    return np.where(known[:, None], angles, np.nan)


def movable_angles(
    names: Sequence[str],
    parents: NDArray[np.int64],
    offsets: Array,
    dof_joint: NDArray[np.int64],
    dof_axis: NDArray[np.int64],
) -> tuple[str, ...]:
    """The anatomical angles that a skeleton can move: those about whose axis some joint between the segments turns.

    parents : (J,), -1 for the root.  dof_joint, dof_axis : the joint of every rotation, and its axis 0, 1, 2 at rest.
    """
    at = segment_joints(names)
    standing = standing_rotations(names, offsets)
    found: list[str] = []
    for joint in joints_of(tuple(at)):
        stop = -1 if joint.proximal is None else at[joint.proximal]
        between = []
        j = at[joint.distal]
        while j not in (-1, stop):
            between.append(j)
            j = int(parents[j])
        axes = [np.eye(3)[a] for d, a in zip(dof_joint, dof_axis, strict=True) if d in between]
        turned = [np.abs(ISB_FROM_OURS @ standing[joint.distal] @ axis) for axis in axes]
        found += [
            name
            for name, letter in zip(joint.names, joint.sequence, strict=True)
            if any(axis["XYZ".index(letter)] > 0.5 for axis in turned)
        ]
    return tuple(found)
