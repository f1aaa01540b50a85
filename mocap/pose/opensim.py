"""A motion as OpenSim has it: generalised coordinates by the names of its full-body models."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from mocap.body import Body, joint_transforms
from mocap.metrics.anatomy import ISB_FROM_OURS, segment_joints
from mocap.pose.angles import anatomical_states, angles_of_states, body_angles
from mocap.pose.method import AngleSettings
from mocap.pose.result import PersonPoses

Array = NDArray[np.float64]

# Ground of OpenSim (y up, as in the TRC files) from our world: file x = scene y, file y = scene z, file z = scene x.
GROUND_FROM_WORLD: Array = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])
PELVIS = ("pelvis_tilt", "pelvis_list", "pelvis_rotation", "pelvis_tx", "pelvis_ty", "pelvis_tz")
# Our angle -> coordinate of the full-body models of Rajagopal 2016 and Lai 2017, and its sign there.
_MIDDLE = {
    "trunk_flexion": ("lumbar_extension", -1.0),
    "trunk_bending": ("lumbar_bending", 1.0),
    "trunk_rotation": ("lumbar_rotation", 1.0),
    "neck_flexion": ("neck_extension", -1.0),
    "neck_bending": ("neck_bending", 1.0),
    "neck_rotation": ("neck_rotation", 1.0),
}
_PAIRED = {
    "hip_flexion": "hip_flexion",
    "hip_adduction": "hip_adduction",
    "hip_rotation": "hip_rotation",
    "knee_flexion": "knee_angle",
    "ankle_dorsiflexion": "ankle_angle",
    "ankle_inversion": "subtalar_angle",
    "ankle_rotation": "ankle_rotation",
    "shoulder_flexion": "arm_flex",
    "shoulder_adduction": "arm_add",
    "shoulder_rotation": "arm_rot",
    "elbow_flexion": "elbow_flex",
    "elbow_pronation": "pro_sup",
    "wrist_flexion": "wrist_flex",
    "wrist_deviation": "wrist_dev",
}


def coordinate_of_angle(angle: str) -> tuple[str, float] | None:
    """Coordinate of OpenSim that an anatomical angle is, with its sign; None for one that the models do not have."""
    if angle in _MIDDLE:
        return _MIDDLE[angle]
    side, _, name = angle.partition("_")
    if side in ("left", "right") and name in _PAIRED:
        return f"{_PAIRED[name]}_{side[0]}", 1.0
    return None


def opensim_coordinates(poses: PersonPoses, settings: AngleSettings) -> dict[str, Array]:
    """Coordinate -> (T,), degrees and metres, of the poses that the angles of `angles_of` are those of."""
    return coordinates_of_states(poses.body, anatomical_states(poses, settings)[0])


def coordinates_of_states(body: Body, states: Array) -> dict[str, Array]:
    """Coordinate -> (T,), degrees and metres, unwrapped over time, of states (T, D); empty without a pelvis."""
    R, t = joint_transforms(body, states)
    root = segment_joints(body.joints).get("pelvis")
    if root is None:
        return {}
    pelvis = GROUND_FROM_WORLD @ R[:, root] @ ISB_FROM_OURS.T
    turned = np.asarray(Rotation.from_matrix(pelvis).as_euler("ZXY", suppress_warnings=True))
    values = dict(zip(PELVIS[:3], np.rad2deg(np.unwrap(turned, axis=0)).T, strict=True))
    values |= dict(zip(PELVIS[3:], (t[:, root] @ GROUND_FROM_WORLD.T).T, strict=True))
    angles = np.rad2deg(np.unwrap(angles_of_states(body, states), axis=0))
    for name, column in zip(body_angles(body), angles.T, strict=True):
        found = coordinate_of_angle(name)
        if found is not None:
            values[found[0]] = found[1] * column
    return values
