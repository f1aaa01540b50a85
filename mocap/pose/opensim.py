"""A motion as OpenSim has it: generalised coordinates by the names of its full-body models."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from mocap.body import Body, joint_transforms
from mocap.data import landmark_names
from mocap.data.opensim import OpenSimBody
from mocap.metrics.anatomy import ISB_FROM_OURS, Joint, joints_of, segment_joints, standing_rotations
from mocap.pose.angles import angles_of_states, body_angles

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
    "mtp_extension": "mtp_angle",
    "shoulder_flexion": "arm_flex",
    "shoulder_adduction": "arm_add",
    "shoulder_rotation": "arm_rot",
    "elbow_flexion": "elbow_flex",
    "elbow_pronation": "pro_sup",
    "wrist_flexion": "wrist_flex",
    "wrist_deviation": "wrist_dev",
}
# What the thoracic spine takes of a bend of the trunk: 20 of 80 degrees (AAOS for both, AMA Guides for the lumbar one).
# One joint so far up from the lumbar to the thoracic one moves the thorax as both do.
_UPPER_SHARE = 0.25
# Segment -> body of the models, and its share of the mass (Winter, after Dempster).
_BODIES = {
    "pelvis": ("pelvis", 0.142),
    "thorax": ("torso", 0.355),
    "head": ("head", 0.081),
    "upper_arm": ("humerus", 0.028),
    "forearm": ("ulna", 0.016),
    "hand": ("hand", 0.006),
    "thigh": ("femur", 0.100),
    "shank": ("tibia", 0.0465),
    "foot": ("calcn", 0.0125),
    "toes": ("toes", 0.002),
}


def coordinate_of_angle(angle: str) -> tuple[str, float] | None:
    """Coordinate of OpenSim that an anatomical angle is, with its sign; None for one that the models do not have."""
    if angle in _MIDDLE:
        return _MIDDLE[angle]
    side, _, name = angle.partition("_")
    if side in ("left", "right") and name in _PAIRED:
        return f"{_PAIRED[name]}_{side[0]}", 1.0
    return None


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


def opensim_bodies(body: Body, markers: Mapping[str, str]) -> list[OpenSimBody]:
    """The body as a model of OpenSim, in metres; its coordinates are those of `coordinates_of_states`.

    markers : landmark -> name, those that the model carries. With all coordinates 0 it stands upright as the body does.
    The shoulder girdle, which the models do not have, is at rest. A spine of two joints is one joint between them.
    """
    at, standing = (
        segment_joints(body.joints),
        standing_rotations(body.joints, body.offset, body.standing_pitch),
    )
    places = np.zeros((len(body.joints), 3))  # of the joints at rest, where all frames are parallel
    for j, parent in enumerate(body.parent):
        places[j] = body.offset[j] + (places[parent] if parent >= 0 else 0.0)
    origins = {segment: places[joint] for segment, joint in at.items()}
    if "lumbar" in at:
        lower, upper = origins.pop("lumbar"), origins["thorax"]
        origins["thorax"] = lower + _UPPER_SHARE * (upper - lower)

    def inside(segment: str, place: Array) -> Array:
        joint = places[at[segment]]
        return np.asarray(ISB_FROM_OURS @ (joint - origins[segment] + standing[segment] @ (place - joint)))

    carried = _carried(body, {segment: at[segment] for segment in origins})
    movable, out = set(body_angles(body)), {}
    for joint in joints_of(tuple(origins)):
        if joint.distal in out:
            continue  # the second sequence of the shoulder
        own = {
            markers[name]: inside(joint.distal, places[body.landmark_joint[m]] + body.landmark_offset[m])
            for m, name in enumerate(landmark_names(len(body.landmark_joint)))
            if carried[m] == joint.distal and name in markers
        }
        name, share = _body_of(joint.distal)
        start = origins[joint.distal]
        out[joint.distal] = OpenSimBody(
            name=name,
            parent="ground" if joint.proximal is None else _body_of(joint.proximal)[0],
            location=np.zeros(3) if joint.proximal is None else inside(joint.proximal, start),
            rotations=_rotations(joint, movable),
            mass_share=share,
            markers=own,
        )
    return list(out.values())


def _body_of(segment: str) -> tuple[str, float]:
    side, _, kind = segment.partition("_")
    if side in ("left", "right"):
        name, share = _BODIES[kind]
        return f"{name}_{side[0]}", share
    return _BODIES[segment]


def _carried(body: Body, at: Mapping[str, int]) -> list[str | None]:
    """The segment that carries every landmark: that of its joint, or of the next one towards the root that has one."""
    of_joint = {joint: segment for segment, joint in at.items()}
    found: list[str | None] = []
    for joint in body.landmark_joint:
        j = int(joint)
        while j >= 0 and j not in of_joint:
            j = int(body.parent[j])
        found.append(of_joint.get(j))
    return found


def _rotations(joint: Joint, movable: set[str]) -> tuple[tuple[str, tuple[float, float, float]], ...]:
    """The coordinates of a joint with their axes, in the order of application."""
    if joint.proximal is None:
        return tuple(
            (name, tuple(np.eye(3)["XYZ".index(letter)]))
            for name, letter in zip(PELVIS[:3], "ZXY", strict=True)
        )
    out = []
    for name, letter, (_, sign) in zip(joint.names, joint.sequence, joint.angles, strict=True):
        found = coordinate_of_angle(name) if name in movable else None
        coordinate, own = found or ("", 1.0)
        mirror = -1.0 if joint.is_left and letter != "Z" else 1.0
        out.append((coordinate, tuple(sign * own * mirror * np.eye(3)["XYZ".index(letter)])))
    return tuple(out)
