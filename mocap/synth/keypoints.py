"""A pose network that is not there: 2D keypoints of a synthetic session, with the errors that networks make."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from mocap.data import LANDMARKS, Camera, Motion
from mocap.data.keypoints import KEYPOINTS, MIRRORED, N_KEYPOINTS
from mocap.synth.section import Section

Array = NDArray[np.float64]

KINDS = ("shoulder", "elbow", "wrist", "hip", "knee", "ankle")
_FAR_RUN = 8.0  # frames that a point stays far off, on average: what hides it goes as slowly as people
_SURE, _UNSURE = (0.7, 1.0), (0.1, 0.8)  # confidences of points, and of those that are far off


@dataclass(frozen=True)
class KindErrors:
    """How keypoints of one kind err, m at the person.

    bias_m : their constant place beside the joint of the left side, forward, left and up in the frame of the trunk.
    std_m : deviation along each axis of the picture.  correlation : of a frame's error with that of the frame before.
    far_share, far_m : share of points that are far off, and their deviation.
    """

    bias_m: tuple[float, float, float]
    std_m: float
    correlation: float
    far_share: float
    far_m: float


# MediaPipe's points in two realistic rendered sessions (`python -m eval.keypoint_errors`).
ERRORS = {
    "shoulder": KindErrors((-0.002, -0.005, 0.021), 0.013, 0.88, 0.028, 0.13),
    "elbow": KindErrors((0.008, -0.001, 0.013), 0.019, 0.81, 0.040, 0.12),
    "wrist": KindErrors((-0.002, -0.001, 0.001), 0.020, 0.71, 0.139, 0.15),
    "hip": KindErrors((0.032, -0.019, -0.022), 0.022, 0.89, 0.007, 0.13),
    "knee": KindErrors((-0.006, -0.003, 0.001), 0.022, 0.73, 0.098, 0.14),
    "ankle": KindErrors((0.012, 0.002, 0.018), 0.019, 0.64, 0.166, 0.23),
}


class KeypointConfig(Section):
    """Keypoints as a pose network would find them: of shoulders, elbows, wrists, hips, knees and ankles."""

    error_scale: float = Field(1.0, ge=0.0, le=10.0)
    """Factor on deviations and constant places."""
    missed: float = Field(0.02, ge=0.0, le=1.0)
    """Share of the points that are not found."""
    exchanged: float = Field(0.002, ge=0.0, le=1.0)
    """Share of the pictures in which a person's left and right are exchanged."""


def trunk_frame(landmarks: Array) -> Array:
    """Axes of the trunk, forward, left and up as columns (3, 3), of landmarks (15, 3) m."""
    up = landmarks[LANDMARKS.index("neck")] - landmarks[LANDMARKS.index("pelvis")]
    up /= np.linalg.norm(up)
    left = landmarks[LANDMARKS.index("left_hip")] - landmarks[LANDMARKS.index("right_hip")]
    left -= up * (left @ up)
    left /= np.linalg.norm(left)
    return np.column_stack([np.cross(left, up), left, up])


def simulated_keypoints(
    motion: Motion, camera: Camera, config: KeypointConfig, *, rng: np.random.Generator
) -> Array:
    """What a network finds of one person in a camera's pictures, (T, K, 3): u px, v px, confidence; NaN = not found.

    Points outside the picture are not found; points that something hides are as well found as others.
    """
    T = len(motion.frames)
    out = np.full((T, N_KEYPOINTS, 3), np.nan)
    trunks = np.array([trunk_frame(x) for x in motion.landmarks])
    for kind in KINDS:
        errors = ERRORS[kind]
        for side, mirror in (("left", 1.0), ("right", -1.0)):
            name = f"{side}_{kind}"
            bias = np.array(errors.bias_m) * [1.0, mirror, 1.0] * config.error_scale
            uv, depth = camera.project(motion.landmarks[:, LANDMARKS.index(name)] + trunks @ bias)
            error_m, is_far = _errors(T, errors, rng)
            uv = uv + error_m * (config.error_scale * camera.K[0, 0] / depth)[:, None]
            low, high = np.where(is_far[:, None], _UNSURE, _SURE).T
            confidence = rng.uniform(low, high)
            found = camera.contains(uv) & (rng.random(T) >= config.missed)
            own = np.column_stack([uv, confidence])
            out[found, KEYPOINTS.index(name)] = own[found]
    exchanged = rng.random(T) < config.exchanged
    out[exchanged] = out[exchanged][:, MIRRORED]
    return out


def _errors(n: int, errors: KindErrors, rng: np.random.Generator) -> tuple[Array, NDArray[np.bool_]]:
    """Errors (n, 2) m of a point in consecutive pictures, and in which it is far off."""
    near = np.empty((n, 2))
    step = np.sqrt(1.0 - errors.correlation**2)
    value = rng.standard_normal(2)
    for t in range(n):
        near[t] = errors.std_m * value
        value = errors.correlation * value + step * rng.standard_normal(2)
    is_far, shift = np.zeros(n, dtype=np.bool_), np.zeros((n, 2))
    begins = errors.far_share / (1.0 - errors.far_share) / _FAR_RUN
    is_now, own = rng.random() < errors.far_share, errors.far_m * rng.standard_normal(2)
    for t in range(n):
        is_far[t], shift[t] = is_now, own if is_now else 0.0
        if rng.random() < (1.0 / _FAR_RUN if is_now else begins):
            is_now, own = not is_now, errors.far_m * rng.standard_normal(2)
    return near + shift, is_far
