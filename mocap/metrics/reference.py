"""Inverse kinematics on a reference skeleton: a pose of any tool, written in angles of one and the same body.

The skeleton has the trunk as one block (pelvis, neck, hips), the shoulders as a second one that twists on it, and nine
segments of constant length: neck to head, upper arms, forearms, thighs, shanks. Its sizes are medians over the frames
of one person and one tool. Every frame is then fitted to the landmarks by least squares. Landmark noise along a segment
cannot bend a joint, and a tool whose segments change their lengths is measured by the pose that a body of constant
lengths would need.

State of a frame, 25 numbers: place of the pelvis, rotation of the trunk, twist of the shoulders, and the direction of
each segment as a unit vector. No Euler angle is involved, hence no singularity.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mocap.arrays import Array
from mocap.data import LANDMARKS
from mocap.metrics.angles import joint_angles
from mocap.metrics.points import torso_rotation, unit

# Segment end -> its start, parents first; the starts of the first five hang on the trunk.
SEGMENTS: dict[str, str] = {
    "head": "neck",
    "left_elbow": "left_shoulder",
    "right_elbow": "right_shoulder",
    "left_knee": "left_hip",
    "right_knee": "right_hip",
    "left_wrist": "left_elbow",
    "right_wrist": "right_elbow",
    "left_ankle": "left_knee",
    "right_ankle": "right_knee",
}
_TRUNK = ("pelvis", "neck", "left_hip", "right_hip", "left_shoulder", "right_shoulder")
_STEPS = 30
_TOLERANCE = 1e-6  # metres and radians; a shorter step ends the fit of its frame
_FIRST_DAMPING = 1e-6
_AT = LANDMARKS.index


@dataclass(frozen=True, eq=False)
class ReferenceFit:
    """The reference skeleton in every frame.

    landmarks : (T, 15, 3) m, world; NaN where the given landmark, or one between it and the
    trunk, is unknown, or where the frame has no whole trunk.
    angles : (T, 15) rad, order ANGLES.  lengths_m : segment end -> length, NaN when never seen.
    residual_mm : (T,) root mean square distance of the fit from the landmarks, NaN where nothing was fitted.
    """

    landmarks: Array
    angles: Array
    lengths_m: dict[str, float]
    residual_mm: Array


@dataclass(frozen=True, eq=False)
class _Sizes:
    neck: float
    hips: Array  # (2, 3) left, right, in the trunk's frame from the pelvis
    shoulders: Array  # (2, 3) left, right, in the shoulders' frame from the neck
    lengths: Array  # (9,)


@dataclass(frozen=True, eq=False)
class _State:
    pelvis: Array  # (T, 3)
    R: Array  # (T, 3, 3) forward, left, up
    twist: Array  # (T,)
    directions: Array  # (T, 9, 3)


def fit_reference_skeleton(landmarks: Array) -> ReferenceFit:
    """Fit the reference skeleton to the landmarks of one person, frame by frame.

    landmarks : (T, 15, 3) m, world, order LANDMARKS, NaN = unknown. A frame whose trunk (pelvis, neck, hips,
    shoulders) is not wholly known is not fitted; a limb that is not known leaves the rest alone.
    Raises ValueError for another shape.
    Source: CF 5.3.2. Departs from CF 5.3.2: the reference body is ours and is fitted by least squares, because Mikic's
    closed form takes every landmark as exact.
    """
    x = np.asarray(landmarks, dtype=np.float64)
    if x.ndim != 3 or x.shape[1:] != (len(LANDMARKS), 3):
        raise ValueError(f"landmarks has shape {x.shape}, expected (T, {len(LANDMARKS)}, 3)")
    known = np.all(np.isfinite(x), axis=2)
    for end, begin in SEGMENTS.items():
        # A wrist without its elbow leaves the forearm free to fold: it would pull at the trunk for nothing.
        known[:, _AT(end)] &= known[:, _AT(begin)]
    start = torso_rotation(x, "hip")
    shoulder_frame = torso_rotation(x, "shoulder")
    usable = known[:, [_AT(name) for name in _TRUNK]].all(axis=1)
    usable &= np.isfinite(start).all(axis=(1, 2)) & np.isfinite(shoulder_frame).all(axis=(1, 2))
    fitted = np.full_like(x, np.nan)
    residual = np.full(len(x), np.nan)
    lengths = np.full(len(SEGMENTS), np.nan)
    if usable.any():
        y, is_known = x[usable], known[usable]
        sizes = _sizes(y, start[usable], shoulder_frame[usable])
        state = _fit(_start(y, start[usable], shoulder_frame[usable]), sizes, y, is_known)
        places = np.where(is_known[:, :, None], _forward(state, sizes), np.nan)
        fitted[usable] = places
        squares = np.where(is_known, ((places - y) ** 2).sum(axis=2), 0.0)
        residual[usable] = 1000.0 * np.sqrt(squares.sum(axis=1) / is_known.sum(axis=1))
        lengths = sizes.lengths
    return ReferenceFit(
        landmarks=fitted,
        angles=joint_angles(fitted),
        lengths_m=dict(zip(SEGMENTS, map(float, lengths), strict=True)),
        residual_mm=residual,
    )


def _sizes(x: Array, R: Array, R_shoulder: Array) -> _Sizes:
    """Median sizes over the frames (T, 15, 3) of one person."""

    def in_frame(frame: Array, origin: str, names: tuple[str, str]) -> Array:
        parts = [np.einsum("tji,tj->ti", frame, x[:, _AT(n)] - x[:, _AT(origin)]) for n in names]
        return np.median(np.stack(parts), axis=1)

    lengths = []
    for end, begin in SEGMENTS.items():
        length = np.linalg.norm(x[:, _AT(end)] - x[:, _AT(begin)], axis=1)
        length = length[np.isfinite(length)]
        lengths.append(float(np.median(length)) if len(length) else np.nan)
    return _Sizes(
        neck=float(np.median(np.linalg.norm(x[:, _AT("neck")] - x[:, _AT("pelvis")], axis=1))),
        hips=in_frame(R, "pelvis", ("left_hip", "right_hip")),
        shoulders=in_frame(R_shoulder, "neck", ("left_shoulder", "right_shoulder")),
        lengths=np.array(lengths),
    )


def _start(x: Array, R: Array, R_shoulder: Array) -> _State:
    """The pose that the landmarks show directly; a segment that is not known hangs down."""
    left = np.einsum("tji,tj->ti", R, R_shoulder[:, :, 1])
    directions = np.stack(
        [unit(x[:, _AT(end)] - x[:, _AT(begin)]) for end, begin in SEGMENTS.items()], axis=1
    )
    is_known = np.isfinite(directions).all(axis=2, keepdims=True)
    return _State(
        pelvis=x[:, _AT("pelvis")],
        R=R,
        twist=np.arctan2(-left[:, 0], left[:, 1]),
        directions=np.where(is_known, directions, [0.0, 0.0, -1.0]),
    )


def _forward(state: _State, sizes: _Sizes) -> Array:
    """Landmarks of the skeleton, (T, 15, 3) m; a segment of unknown length has length zero."""
    T = len(state.pelvis)
    x = np.zeros((T, len(LANDMARKS), 3))
    x[:, _AT("pelvis")] = state.pelvis
    x[:, _AT("neck")] = state.pelvis + sizes.neck * state.R[:, :, 2]
    turned = state.R @ _about_z(state.twist)
    for i, side in enumerate(("left", "right")):
        x[:, _AT(f"{side}_hip")] = state.pelvis + state.R @ sizes.hips[i]
        x[:, _AT(f"{side}_shoulder")] = x[:, _AT("neck")] + turned @ sizes.shoulders[i]
    lengths = np.nan_to_num(sizes.lengths)
    for k, (end, begin) in enumerate(SEGMENTS.items()):
        x[:, _AT(end)] = x[:, _AT(begin)] + lengths[k] * state.directions[:, k]
    return x


def _fit(state: _State, sizes: _Sizes, y: Array, is_known: NDArray[np.bool_]) -> _State:
    """Levenberg-Marquardt, all frames at once, each with its own damping; a frame that is finished drops out."""
    weight = is_known[:, :, None].astype(np.float64)
    target = np.where(is_known[:, :, None], y, 0.0)

    def residuals(s: _State, rows: NDArray[np.int64]) -> Array:
        return ((target[rows] - _forward(s, sizes)) * weight[rows]).reshape(len(rows), -1)

    pelvis, R, twist, directions = (
        state.pelvis.copy(),
        state.R.copy(),
        state.twist.copy(),
        state.directions.copy(),
    )
    damping = np.full(len(y), _FIRST_DAMPING)
    eye = np.eye(7 + 2 * len(SEGMENTS))
    open_rows = np.arange(len(y))
    for _ in range(_STEPS):
        now = _State(pelvis[open_rows], R[open_rows], twist[open_rows], directions[open_rows])
        r = residuals(now, open_rows)
        J, bases = _jacobian(now, sizes)
        J = (J * weight[open_rows, ..., None]).reshape(len(open_rows), -1, J.shape[3])
        Jt = J.transpose(0, 2, 1)
        normal = Jt @ J + damping[open_rows, None, None] * eye
        step: Array = np.asarray(np.linalg.solve(normal, Jt @ r[..., None])[..., 0], dtype=np.float64)
        tried = _moved(now, step, bases)
        better = (residuals(tried, open_rows) ** 2).sum(axis=1) <= (r**2).sum(axis=1)
        taken = open_rows[better]
        pelvis[taken], R[taken] = tried.pelvis[better], tried.R[better]
        twist[taken], directions[taken] = tried.twist[better], tried.directions[better]
        damping[taken] /= 10.0
        damping[open_rows[~better]] *= 10.0
        # Near the minimum rounding decides whether a step is better: a short one ends the search either way.
        open_rows = open_rows[np.abs(step).max(axis=1) >= _TOLERANCE]
        if not len(open_rows):
            break
    return _State(pelvis, R, twist, directions)


def _jacobian(state: _State, sizes: _Sizes) -> tuple[Array, Array]:
    """Derivatives of the landmarks, (T, 15, 3, 25), and the tangent bases of the directions, (T, 9, 3, 2)."""
    x = _forward(state, sizes)
    T = len(x)
    lengths = np.nan_to_num(sizes.lengths)
    bases = _tangents(state.directions)
    J = np.zeros((T, len(LANDMARKS), 3, 7 + 2 * len(SEGMENTS)))
    J[..., 0:3] = np.eye(3)
    up = state.R[:, :, 2]
    for name in _TRUNK:
        j = _AT(name)
        lever = x[:, j] - state.pelvis
        # d(v) for a small rotation w is w x v: column i is e_i x v.
        J[:, j, :, 3:6] = np.cross(np.eye(3)[None], lever[:, None]).transpose(0, 2, 1)
        if name.endswith("shoulder"):
            J[:, j, :, 6] = np.cross(up, x[:, j] - x[:, _AT("neck")])
    for k, (end, begin) in enumerate(SEGMENTS.items()):
        J[:, _AT(end)] = J[:, _AT(begin)]
        J[:, _AT(end), :, 7 + 2 * k : 9 + 2 * k] = lengths[k] * bases[:, k]
    return J, bases


def _moved(state: _State, step: Array, bases: Array) -> _State:
    from scipy.spatial.transform import Rotation

    directions = state.directions + np.einsum(
        "tkij,tkj->tki", bases, step[:, 7:].reshape(len(step), len(SEGMENTS), 2)
    )
    return _State(
        pelvis=state.pelvis + step[:, 0:3],
        R=Rotation.from_rotvec(step[:, 3:6]).as_matrix() @ state.R,
        twist=state.twist + step[:, 6],
        directions=unit(directions),
    )


def _tangents(directions: Array) -> Array:
    """Two unit vectors perpendicular to each direction (T, K, 3), as columns, (T, K, 3, 2)."""
    # The axis that the direction is least along is never parallel to it.
    helper = np.eye(3)[np.argmin(np.abs(directions), axis=2)]
    first = unit(np.cross(directions, helper))
    return np.stack([first, np.cross(directions, first)], axis=3)


def _about_z(angle: Array) -> Array:
    R = np.zeros((len(angle), 3, 3))
    R[:, 0, 0] = R[:, 1, 1] = np.cos(angle)
    R[:, 1, 0] = np.sin(angle)
    R[:, 0, 1] = -R[:, 1, 0]
    R[:, 2, 2] = 1.0
    return R
