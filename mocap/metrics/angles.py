"""Angular error on a reference skeleton that both poses are written in by the same inverse kinematics.

The reference skeleton has the angles that 15 landmarks determine in closed form. The direction of a segment
is the rotation vector that carries its rest direction to it along the shortest way, as two components; rest
is the T-pose of CF Table 6.1 (arms to the sides, legs down, head up), so that the only singular directions
are an arm through the chest, a leg straight up and a head straight down. Twists of upper arms and thighs are
left out: a straight limb does not show them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mocap.arrays import Array
from mocap.data import LANDMARKS
from mocap.geometry.rigid import wrap_angle
from mocap.metrics.points import point_errors, torso_rotation, unit

# name of the angle -> landmarks it depends on besides the trunk's (pelvis, neck and one pair)
ANGLES: dict[str, tuple[str, ...]] = {
    "torso_twist": ("left_hip", "right_hip", "left_shoulder", "right_shoulder"),
    "head_side": ("head", "left_shoulder", "right_shoulder"),
    "head_nod": ("head", "left_shoulder", "right_shoulder"),
    "left_shoulder_up": ("left_shoulder", "right_shoulder", "left_elbow"),
    "left_shoulder_front": ("left_shoulder", "right_shoulder", "left_elbow"),
    "left_elbow": ("left_shoulder", "left_elbow", "left_wrist"),
    "right_shoulder_up": ("left_shoulder", "right_shoulder", "right_elbow"),
    "right_shoulder_front": ("left_shoulder", "right_shoulder", "right_elbow"),
    "right_elbow": ("right_shoulder", "right_elbow", "right_wrist"),
    "left_hip_side": ("left_hip", "right_hip", "left_knee"),
    "left_hip_front": ("left_hip", "right_hip", "left_knee"),
    "left_knee": ("left_hip", "left_knee", "left_ankle"),
    "right_hip_side": ("left_hip", "right_hip", "right_knee"),
    "right_hip_front": ("left_hip", "right_hip", "right_knee"),
    "right_knee": ("right_hip", "right_knee", "right_ankle"),
}
_HINGES = ("left_elbow", "right_elbow", "left_knee", "right_knee")


@dataclass(frozen=True, eq=False)
class AngleScores:
    """Mean absolute angular error and its deviation over frames, degrees; None without a comparable angle.

    per_angle_deg : (15,) mean of each of ANGLES, NaN where never compared.  n_frames : frames that took part.
    """

    mean_deg: float | None
    std_deg: float | None
    per_angle_deg: Array
    n_frames: int


def joint_angles(landmarks: Array) -> Array:
    """Angles of the reference skeleton, (T, 15) rad, order ANGLES; NaN where landmarks are unknown.

    landmarks : (T, 15, 3) m, world, order LANDMARKS. Root position and orientation do not matter, nor do bone
    lengths. Source: CF 5.3.2 (after Mikic); the reference skeleton is ours, see the head of this module.
    """
    x = np.asarray(landmarks, dtype=np.float64)
    if x.ndim != 3 or x.shape[1:] != (len(LANDMARKS), 3):
        raise ValueError(f"landmarks has shape {x.shape}, expected (T, {len(LANDMARKS)}, 3)")
    at = LANDMARKS.index
    R_hip, R_shoulder = torso_rotation(x, "hip"), torso_rotation(x, "shoulder")

    def direction(R: Array, start: str, end: str) -> Array:
        return np.einsum("tji,tj->ti", R, unit(x[:, at(end)] - x[:, at(start)]))

    angles: dict[str, Array] = {}
    left = np.einsum("tji,tj->ti", R_hip, R_shoulder[:, :, 1])
    angles["torso_twist"] = np.arctan2(-left[:, 0], left[:, 1])
    swing = _swing(direction(R_shoulder, "neck", "head"), np.array([0.0, 0.0, 1.0]))
    angles["head_side"], angles["head_nod"] = swing[:, 0], swing[:, 1]
    for side, sign in (("left", 1.0), ("right", -1.0)):
        arm = direction(R_shoulder, f"{side}_shoulder", f"{side}_elbow")
        swing = _swing(arm, np.array([0.0, sign, 0.0]))
        angles[f"{side}_shoulder_up"], angles[f"{side}_shoulder_front"] = swing[:, 0], swing[:, 2]
        leg = direction(R_hip, f"{side}_hip", f"{side}_knee")
        swing = _swing(leg, np.array([0.0, 0.0, -1.0]))
        angles[f"{side}_hip_side"], angles[f"{side}_hip_front"] = swing[:, 0], swing[:, 1]
        for hinge, chain in (("elbow", ("shoulder", "elbow", "wrist")), ("knee", ("hip", "knee", "ankle"))):
            a, b, c = (x[:, at(f"{side}_{name}")] for name in chain)
            angles[f"{side}_{hinge}"] = _angle_between(unit(b - a), unit(c - b))
    return np.stack([angles[name] for name in ANGLES], axis=1)


def angle_scores(estimate: Array, truth: Array, epsilon_mm: float | None = None) -> AngleScores:
    """Mean angular error on the reference skeleton, and its deviation over frames.

    estimate, truth : (T, 15, 3) m, world, order LANDMARKS, NaN = unknown.
    epsilon_mm : only angles whose landmarks are all matched within it are compared; None compares all known.
    Source: CF Eq. 5.9, 5.3.2 (gate of CF 5.4). Departs from CF Eq. 5.9: the sum is divided by the number of
    angles compared, differences are wrapped (reading guide 7).
    """
    matched = None if epsilon_mm is None else point_errors(estimate, truth) <= epsilon_mm
    return angle_differences(joint_angles(estimate), joint_angles(truth), matched)


def angle_differences(
    estimate: Array, truth: Array, is_matched: NDArray[np.bool_] | None = None
) -> AngleScores:
    """Scores of two series of angles, however they were read from the landmarks.

    estimate, truth : (T, 15) rad, order ANGLES, NaN = unknown.  is_matched : (T, 15) bool, order LANDMARKS;
    only angles whose landmarks are all matched are compared; None = all known.
    """
    difference = np.abs(wrap_angle(np.asarray(estimate) - np.asarray(truth)))
    if is_matched is not None:
        for n, name in enumerate(ANGLES):
            trunk = () if name in _HINGES else ("pelvis", "neck")
            columns = [LANDMARKS.index(landmark) for landmark in (*ANGLES[name], *trunk)]
            difference[~is_matched[:, columns].all(axis=1), n] = np.nan
    is_known = np.isfinite(difference)
    degrees = np.degrees(np.where(is_known, difference, 0.0))
    count = is_known.sum(axis=1)
    per_frame = degrees.sum(axis=1)[count > 0] / count[count > 0]
    with np.errstate(invalid="ignore"):
        per_angle = degrees.sum(axis=0) / is_known.sum(axis=0)
    return AngleScores(
        mean_deg=float(per_frame.mean()) if len(per_frame) else None,
        std_deg=float(per_frame.std()) if len(per_frame) else None,
        per_angle_deg=per_angle,
        n_frames=len(per_frame),
    )


def _angle_between(a: Array, b: Array) -> Array:
    """Angle between unit vectors (T, 3), accurate near 0 and pi, (T,) rad."""
    return np.arctan2(np.linalg.norm(np.cross(a, b), axis=1), np.einsum("ti,ti->t", a, b))


def _swing(direction: Array, rest: Array) -> Array:
    """Shortest rotation vector from rest (3,) to direction (T, 3), unit vectors, (T, 3) rad."""
    axis = np.cross(rest, direction)
    sine = np.linalg.norm(axis, axis=1, keepdims=True)
    angle = np.arctan2(sine, direction @ rest[:, None])
    return axis * np.where(sine > 1e-12, angle / np.where(sine > 1e-12, sine, 1.0), 1.0)
