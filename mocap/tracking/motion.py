"""Motion of persons between frames: a velocity that fades, and how uncertain a position is."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from mocap.arrays import Array
from mocap.tracking.state import Track, TrackerSettings

FADE_S = 0.6  # people turn and stop: a velocity says little about what follows after a second
ACCELERATION = 3.0  # power of the white acceleration, m^2/s^3: a person stops from 1.4 m/s within about 0.6 s
START_SPEED_M_S = 0.8  # standard deviation of the speed of somebody new
# Of the centroid of a person's own voxels about that of the body, along x, y and z: what was found on the development
# meeting scenes. Height is the worst: the legs of who sits at a table are in nobody's view.
POSITION_STD_M = np.array([0.02, 0.02, 0.075])
SHARED_STD_M = np.array([0.05, 0.05, 0.08])  # where a blob was divided
BRIDGE = 0.25  # m^2/s, variance of a random walk between two sightings


def start_motion(settings: TrackerSettings) -> Array:
    """Covariance (2, 2) of position and velocity along an axis, of somebody new."""
    return np.diag([POSITION_STD_M[0] ** 2 + settings.voxel_size_m**2 / 12, START_SPEED_M_S**2])


def place_covariance(settings: TrackerSettings, *, is_certain: bool = True) -> Array:
    """Covariance (3, 3) m^2 of the centroid of a track's voxels; is_certain : they are a whole person of their own."""
    std = POSITION_STD_M if is_certain else SHARED_STD_M
    return np.diag(std**2 + settings.voxel_size_m**2 / 12)


def faded(track: Track, variance: float) -> Array:
    """Covariance (3, 3) m^2 of a place that was predicted: what was known last, and the variance of the way since."""
    return np.diag(np.maximum(np.diagonal(track.covariance), variance))


def predict(track: Track, n_frames: int, settings: TrackerSettings) -> Track:
    """The track n_frames later, without an observation: moved by its fading velocity, less certain.

    Departs from CF 4.3.2, which uses no dynamical model: because persons walk by up to 10 cm between two frames of a
    slow camera, five voxels of 2 cm. With motion `none` the position stays.
    """
    transition, noise = _transition(n_frames / settings.fps)
    step, keep = float(transition[0, 1]), float(transition[1, 1])
    motion = transition.dot(track.motion).dot(transition.T) + noise
    if settings.motion == "none":
        return track.replace(motion=motion, covariance=faded(track, motion[0, 0]))
    shift = step * track.velocity
    if track.misses:
        shift[2] = (
            0.0  # who is out of sight goes on walking, not sinking: half outside the volume centroids drop
        )
    return track.replace(
        xyz=track.xyz + shift,
        velocity=keep * track.velocity,
        motion=motion,
        covariance=faded(track, motion[0, 0]),
        samples=track.samples + shift,
    )


@lru_cache(maxsize=64)
def _transition(dt: float) -> tuple[Array, Array]:
    """Of position and velocity along an axis over dt seconds: transition (2, 2), and covariance of its noise."""
    keep = np.exp(-dt / FADE_S)
    transition = np.array([[1.0, FADE_S * (1.0 - keep)], [0.0, keep]])
    return transition, ACCELERATION * np.array([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]])


def observe(track: Track, xyz: Array, covariance: Array, settings: TrackerSettings) -> Track:
    """The track at an observed position xyz (3,) m with covariance (3, 3); velocity by a Kalman gain.

    The position is the observed one: a lag behind somebody who turns would be worse than the noise.
    """
    variance = float(covariance[0, 0] + covariance[1, 1]) / 2.0
    gain = track.motion[:, 0] / (track.motion[0, 0] + variance)
    motion = track.motion - np.outer(gain, track.motion[0])
    velocity = track.velocity + gain[1] * (xyz - track.xyz)
    if settings.motion == "none":
        velocity = np.zeros(3)
    return track.replace(xyz=xyz, covariance=covariance, velocity=velocity, motion=motion)


def bridge_variance(n_before: NDArray[np.int64], n_after: NDArray[np.int64], fps: float) -> Array:
    """Extra variance (n,) m^2 of positions interpolated n_before frames after one sighting, n_after before the next."""
    return BRIDGE * n_before * n_after / np.maximum(n_before + n_after, 1) / fps
