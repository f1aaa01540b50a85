"""Anatomical angles of a person's poses, with what the stored covariances of the landmarks say of them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mocap.body import Body, joint_transforms
from mocap.body.kinematics import point_jacobian
from mocap.data import AngleSeries, landmark_names
from mocap.geometry.rigid import wrap_angle
from mocap.metrics.anatomy import (
    anatomical_angles,
    angles_of_joint,
    joints_of,
    movable_angles,
    segment_frames,
    segment_joints,
    standing_rotations,
)
from mocap.pose.method import AngleSettings
from mocap.pose.result import PersonPoses

Array = NDArray[np.float64]

_STEP_RAD = 1e-4  # of the central difference
_BATCH_FRAMES = 200  # bounds the memory of an hour's recording
# Segment -> the landmarks that show how it lies; of limbs for one side.
_SHOWN_BY: dict[str, tuple[str, ...]] = {
    "pelvis": ("left_hip", "right_hip", "neck"),
    "lumbar": ("left_hip", "right_hip", "neck"),
    "thorax": ("left_shoulder", "right_shoulder", "neck"),
    "head": ("neck", "head"),
    "upper_arm": ("shoulder", "elbow"),
    "forearm": ("elbow", "wrist"),
    "hand": ("wrist", "hand_tip"),
    "thigh": ("hip", "knee"),
    "shank": ("knee", "ankle"),
    "foot": ("ankle", "heel", "toe"),
    "toes": ("toe",),
}
# What hulls and outlines do not show, so that it is as usual: how a spine shares the bend of the trunk, and the turn of
# a forearm, which is round.
_INFERRED = frozenset(
    f"{joint}_{angle}" for joint in ("lumbar", "thoracic") for angle in ("flexion", "bending", "rotation")
) | {"elbow_pronation"}
# Turns of a limb about its own length show in the bend of the next joint alone.
_SHOWN_BY_BEND = {
    "hip_rotation": "knee_flexion",
    "shoulder_rotation": "elbow_flexion",
    "shoulder_axial_rotation": "elbow_flexion",
}


def body_angles(body: Body) -> tuple[str, ...]:
    """The anatomical angles that a body can move."""
    return movable_angles(body.joints, body.parent, body.offset, body.dof_joint, body.dof_axis)


def angles_of_states(body: Body, states: Array) -> Array:
    """Anatomical angles of states (T, D): (T, A) rad, in the order of `body_angles`."""
    R, _ = joint_transforms(body, states)
    found = anatomical_angles(segment_frames(body.joints, body.offset, R, body.standing_pitch))
    names = body_angles(body)
    return np.stack([found[name] for name in names], axis=1) if names else np.zeros((len(states), 0))


def angles_of(
    poses: PersonPoses, fps: float, settings: AngleSettings, anatomy: tuple[Array, Array] | None = None
) -> AngleSeries:
    """The anatomical angles of one person, with standard deviations and whether they were observed.

    The covariance of a pose is that which its landmarks' covariances leave, with what is known of a joint without data;
    it is carried to the angles by their derivatives, and what bodies differ in is added.  anatomy : what
    `anatomical_states` gives, the angles are those of its poses; None = not known yet.
    """
    body, names = poses.body, body_angles(poses.body)
    states, variance = anatomical_states(poses, settings) if anatomy is None else anatomy
    pairs = [settings.of_angle.get(_kind(name), settings.of_others) for name in names]
    floor_deg, factor = np.array(pairs).reshape(-1, 2).T
    values = angles_of_states(body, states)
    return AngleSeries(
        person=poses.person,
        names=names,
        frames=poses.frames,
        time_s=poses.frames / fps,
        values=values,
        # Beyond that of an angle of which nothing is known there is nothing to say.
        std=np.minimum(np.sqrt(factor**2 * variance + np.deg2rad(floor_deg) ** 2), np.pi / np.sqrt(3.0)),
        observed=_observed(names, values, poses.observed, settings),
    )


def anatomical_states(poses: PersonPoses, settings: AngleSettings) -> tuple[Array, Array]:
    """The poses (T, D) with what is known of spines, and the variance of every angle then, (T, A) rad^2.

    Neither hull nor outlines show how the pelvis stands under the trunk. Pelvis and lumbar spine share a bend of the
    trunk; that is taken as one more observation of every pose, and moves what the landmarks leave open alone.
    """
    states = np.empty_like(poses.states)
    variance = np.empty((len(states), len(body_angles(poses.body))))
    for start in range(0, len(states), _BATCH_FRAMES):
        rows = slice(start, start + _BATCH_FRAMES)
        states[rows], variance[rows] = _with_spine(
            poses.body, poses.states[rows], poses.landmark_covariance[rows], settings
        )
    return states, variance


def _kind(name: str) -> str:
    return name.removeprefix("left_").removeprefix("right_")


def _with_spine(
    body: Body, states: Array, landmark_covariance: Array, settings: AngleSettings
) -> tuple[Array, Array]:
    """States (T, D) after the observation of the spine, and variances (T, A) rad^2 of the angles."""
    names, slope = body_angles(body), _slopes(body, states)
    weak = np.where(body.is_position, 1.0, np.minimum(body.usual_std, settings.weak_std_rad)) ** -2.0
    information = np.linalg.inv(landmark_covariance)
    out, variance = states.copy(), np.empty(slope.shape[:2])
    has_spine = {"trunk_flexion", "pelvis_tilt"} <= set(names)
    if has_spine:
        bent, tilted = names.index("trunk_flexion"), names.index("pelvis_tilt")
        angles = angles_of_states(body, states)
        missed = angles[:, bent] - settings.spine_share * angles[:, tilted]
    for i in range(len(states)):
        _, J, _ = point_jacobian(body, states[i], body.landmark_joint, body.landmark_offset)
        flat = J.reshape(-1, J.shape[-1])
        A = flat.T @ (information[i] @ J).reshape(flat.shape) + np.diag(weak)
        covariance = np.linalg.inv(A)
        if has_spine:
            row = slope[i, bent] - settings.spine_share * slope[i, tilted]
            across = covariance @ row
            gain = across / (row @ across + np.deg2rad(settings.spine_std_deg) ** 2)
            out[i] -= gain * missed[i]
            covariance -= np.outer(gain, across)
        variance[i] = ((slope[i] @ covariance) * slope[i]).sum(axis=1)
    return np.clip(out, body.layout.lower, body.layout.upper), variance


def _slopes(body: Body, states: Array) -> Array:
    """Derivatives of the angles by the columns of states (T, D), (T, A, D), by central differences: 0 but for what
    turns one of an angle's two segments and not the other."""
    names, at, chain = body_angles(body), segment_joints(body.joints), body.chain
    standing = standing_rotations(body.joints, body.offset, body.standing_pitch)
    turning = np.flatnonzero(~body.is_position)
    (T, D), n = states.shape, len(turning)
    steps = np.zeros((2, n, D))
    steps[0, np.arange(n), turning] = _STEP_RAD
    steps[1] = -steps[0]
    R, _ = joint_transforms(body, (states[:, None, None] + steps).reshape(-1, D))
    R = R.reshape(T, 2, n, -1, 3, 3)
    slope = np.zeros((T, len(names), D))
    for joint in joints_of(tuple(at)):
        segments = [segment for segment in (joint.distal, joint.proximal) if segment is not None]
        is_between = np.logical_xor.reduce([body.arrays.moves[at[segment]] for segment in segments])
        rows = np.flatnonzero(np.isin(turning, chain.dof_column[is_between]))
        frames = {s: (R[:, :, rows, at[s]] @ standing[s].T).reshape(-1, 3, 3) for s in segments}
        for name, values in angles_of_joint(joint, frames).items():
            if name in names:
                later, earlier = values.reshape(T, 2, len(rows)).swapaxes(0, 1)
                slope[:, names.index(name), turning[rows]] = wrap_angle(later - earlier) / (2 * _STEP_RAD)
    return slope


def _observed(
    names: tuple[str, ...], values: Array, observed: NDArray[np.bool_], settings: AngleSettings
) -> NDArray[np.bool_]:
    """Whether the landmarks of an angle were observed; a turn about a limb's length needs a bend that shows it, and
    what nothing shows never is."""
    seen: dict[str, NDArray[np.bool_]] = {}
    landmarks = landmark_names(observed.shape[1])
    everything = [*_SHOWN_BY, *(f"{side}_{s}" for side in ("left", "right") for s in _SHOWN_BY)]
    for joint in joints_of(everything):
        both = [segment for segment in (joint.proximal, joint.distal) if segment is not None]
        rows = [landmarks.index(name) for segment in both for name in _landmarks_of(segment, landmarks)]
        seen.update(dict.fromkeys(joint.names, np.asarray(observed[:, rows].all(axis=1))))
    out = np.ones(values.shape, dtype=np.bool_)
    for i, name in enumerate(names):
        out[:, i] = seen[name] & (_kind(name) not in _INFERRED)
        bend = f"{name.partition('_')[0]}_{_SHOWN_BY_BEND.get(_kind(name))}"
        if bend in names:
            out[:, i] &= values[:, names.index(bend)] > np.deg2rad(settings.bend_deg)
    return out


def _landmarks_of(segment: str, landmarks: Sequence[str]) -> list[str]:
    """The landmarks that show a segment, of those that there are."""
    side, _, kind = segment.partition("_")
    paired = side in ("left", "right")
    names = (f"{side}_{name}" for name in _SHOWN_BY[kind]) if paired else iter(_SHOWN_BY[segment])
    return [name for name in names if name in landmarks]
