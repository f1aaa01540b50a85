"""Joint angles in the words of anatomy, and how far people can move them.

Angles are those of the skeleton of `mocap.synth.figure` (the one of truth/pose_N.npz). Positive is flexion, abduction
(away from the middle), inward rotation, bending and turning to the person's left.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from mocap.synth.figure import JOINT, JOINTS, SIDES, rotation_about

Array = NDArray[np.float64]

# Degrees, lower and upper. Passive ranges of healthy adults: Norkin and White, Measurement of Joint Motion, after the
# American Academy of Orthopaedic Surgeons; of the trunk and the neck each of our two joints has its share; the hip's
# abduction and rotation are wider when it is flexed; the ankle is that of a lunge with the knee bent. The
# ball of the foot extends to 90 when it bears the body.
RANGES_DEG: dict[str, tuple[float, float]] = {
    "spine_flexion": (-25.0, 50.0),
    "spine_side": (-25.0, 25.0),
    "spine_turn": (-30.0, 30.0),
    "chest_flexion": (-25.0, 50.0),
    "chest_side": (-25.0, 25.0),
    "chest_turn": (-35.0, 35.0),
    "neck_flexion": (-40.0, 40.0),
    "neck_side": (-30.0, 30.0),
    "neck_turn": (-45.0, 45.0),
    "head_flexion": (-40.0, 35.0),
    "head_side": (-25.0, 25.0),
    "head_turn": (-45.0, 45.0),
    "clavicle_up": (-12.0, 45.0),
    "clavicle_forward": (-20.0, 30.0),
    "shoulder_elevation": (0.0, 180.0),
    "elbow_flexion": (-1.0, 150.0),
    "elbow_other": (-1.0, 1.0),
    "wrist_flexion": (-80.0, 80.0),
    "wrist_side": (-45.0, 45.0),
    "wrist_turn": (-90.0, 90.0),
    "hip_flexion": (-35.0, 130.0),
    "hip_abduction": (-35.0, 60.0),
    "hip_rotation": (-50.0, 60.0),
    "knee_flexion": (-1.0, 150.0),
    "knee_other": (-1.0, 1.0),
    "ankle_flexion": (-60.0, 48.0),
    "ankle_side": (-35.0, 35.0),
    "ankle_turn": (-35.0, 35.0),
    "toe_flexion": (-90.0, 45.0),
}


def joint_angles(rotations: Array) -> dict[str, Array]:
    """Anatomical angles in degrees, (T,) each, by the names of RANGES_DEG, of the limbs with the side before them.

    rotations : (T, J, 3, 3) local. Trunk, neck, hip, ankle and wrist: flexion about the parent's axis to the side
    first, then the side movement, then the turn about the own axis. Shoulder: only the angle between the upper arm and
    the trunk's downward axis, because its other two angles are not defined near the poles.
    """

    def of(joint: str) -> Array:
        return np.rad2deg(Rotation.from_matrix(rotations[:, JOINT[joint]]).as_euler("YXZ"))

    out: dict[str, Array] = {}
    for joint in ("spine", "chest", "neck", "head"):
        flexion, side, turn = of(joint).T
        out |= {f"{joint}_flexion": flexion, f"{joint}_side": -side, f"{joint}_turn": turn}
    for name, sign in SIDES:
        girdle = np.rad2deg(Rotation.from_matrix(rotations[:, JOINT[f"{name}_clavicle"]]).as_euler("XZY"))
        down = rotations[:, JOINT[f"{name}_clavicle"]] @ rotations[:, JOINT[f"{name}_shoulder"], :, 2:]
        elbow = np.rad2deg(Rotation.from_matrix(rotations[:, JOINT[f"{name}_elbow"]]).as_rotvec())
        knee = np.rad2deg(Rotation.from_matrix(rotations[:, JOINT[f"{name}_knee"]]).as_rotvec())
        hip, ankle, wrist = of(f"{name}_hip"), of(f"{name}_ankle"), of(f"{name}_wrist")
        toe = np.rad2deg(Rotation.from_matrix(rotations[:, JOINT[f"{name}_toe"]]).as_rotvec())
        out |= {
            f"{name}_clavicle_up": sign * girdle[:, 0],
            f"{name}_clavicle_forward": -sign * girdle[:, 1],
            f"{name}_shoulder_elevation": np.rad2deg(np.arccos(np.clip(down[:, 2, 0], -1, 1))),
            f"{name}_elbow_flexion": -elbow[:, 1],
            f"{name}_elbow_other": np.abs(elbow[:, [0, 2]]).max(axis=1),
            f"{name}_wrist_flexion": -sign * wrist[:, 1],
            f"{name}_wrist_side": -wrist[:, 0],
            f"{name}_wrist_turn": -sign * wrist[:, 2],
            f"{name}_hip_flexion": -hip[:, 0],
            f"{name}_hip_abduction": sign * hip[:, 1],
            f"{name}_hip_rotation": sign * hip[:, 2],
            f"{name}_knee_flexion": knee[:, 1],
            f"{name}_knee_other": np.abs(knee[:, [0, 2]]).max(axis=1),
            f"{name}_ankle_flexion": -ankle[:, 0],
            f"{name}_ankle_side": -sign * ankle[:, 1],
            f"{name}_ankle_turn": -sign * ankle[:, 2],
            f"{name}_toe_flexion": toe[:, 1],
        }
    return out


def range_of(name: str) -> tuple[float, float]:
    """Lower and upper limit in degrees of an angle of `joint_angles`."""
    for side, _ in SIDES:
        name = name.removeprefix(f"{side}_")
    return RANGES_DEG[name]


def pose_of(angles_deg: Mapping[str, Array | float], n_frames: int) -> Array:
    """Rotations (n_frames, J, 3, 3) of some anatomical angles; those not given are 0.

    Names as in `joint_angles`, and for the shoulder `shoulder_flexion`, `shoulder_abduction` and `shoulder_rotation`
    (abduction first, then flexion, then the turn about the upper arm). Raises ValueError for an unknown name.
    """
    known = {n for n in RANGES_DEG if "shoulder" not in n and not n.endswith("_other")}
    known |= {"shoulder_flexion", "shoulder_abduction", "shoulder_rotation"}
    for name in angles_deg:
        bare = name.removeprefix("left_").removeprefix("right_")
        if bare not in known:
            raise ValueError(f"unknown angle {name!r}, expected one of {', '.join(sorted(known))}")

    def get(name: str) -> Array:
        return np.deg2rad(
            np.broadcast_to(np.asarray(angles_deg.get(name, 0.0), dtype=np.float64), (n_frames,))
        )

    out = np.tile(np.eye(3), (n_frames, len(JOINTS), 1, 1))
    for joint in ("spine", "chest", "neck", "head"):
        out[:, JOINT[joint]] = (
            rotation_about(1, get(f"{joint}_flexion"))
            @ rotation_about(0, -get(f"{joint}_side"))
            @ rotation_about(2, get(f"{joint}_turn"))
        )
    for name, sign in SIDES:
        out[:, JOINT[f"{name}_clavicle"]] = rotation_about(
            0, sign * get(f"{name}_clavicle_up")
        ) @ rotation_about(2, -sign * get(f"{name}_clavicle_forward"))
        out[:, JOINT[f"{name}_shoulder"]] = (
            rotation_about(0, sign * get(f"{name}_shoulder_abduction"))
            @ rotation_about(1, -get(f"{name}_shoulder_flexion"))
            @ rotation_about(2, -sign * get(f"{name}_shoulder_rotation"))
        )
        out[:, JOINT[f"{name}_elbow"]] = rotation_about(1, -get(f"{name}_elbow_flexion"))
        out[:, JOINT[f"{name}_wrist"]] = (
            rotation_about(1, -get(f"{name}_wrist_side"))
            @ rotation_about(0, -sign * get(f"{name}_wrist_flexion"))
            @ rotation_about(2, -sign * get(f"{name}_wrist_turn"))
        )
        out[:, JOINT[f"{name}_hip"]] = (
            rotation_about(1, -get(f"{name}_hip_flexion"))
            @ rotation_about(0, sign * get(f"{name}_hip_abduction"))
            @ rotation_about(2, sign * get(f"{name}_hip_rotation"))
        )
        out[:, JOINT[f"{name}_knee"]] = rotation_about(1, get(f"{name}_knee_flexion"))
        out[:, JOINT[f"{name}_ankle"]] = (
            rotation_about(1, -get(f"{name}_ankle_flexion"))
            @ rotation_about(0, -sign * get(f"{name}_ankle_side"))
            @ rotation_about(2, -sign * get(f"{name}_ankle_turn"))
        )
        out[:, JOINT[f"{name}_toe"]] = rotation_about(1, get(f"{name}_toe_flexion"))
    return out
