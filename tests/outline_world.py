"""A ring of small cameras around a body, and the outlines of what they see."""

from __future__ import annotations

import numpy as np
from flesh_voxels import Flesh

from mocap.body import cones_of, neutral_state
from mocap.data import Camera, CameraRig
from mocap.likelihood.residuals import (
    OutlineFitSettings,
    OutlineProblem,
    Outlines,
    person_outlines,
    pinhole_view,
)
from mocap.volume.residuals import silhouette as silhouette_of_voxels

W, H = 200, 160
FOCAL = 150.0
ANGLES_DEG = (10.0, 80.0, 155.0, 230.0, 300.0)
N_POINTS = 60


def make_rig(dist: tuple[float, ...] = (0.0, 0.0, 0.0, 0.0)) -> CameraRig:
    cameras = []
    for i, angle in enumerate(np.deg2rad(ANGLES_DEG)):
        eye = np.array([2.9 * np.cos(angle), 2.9 * np.sin(angle), 1.2 + 0.2 * (i % 3)])
        forward = np.array([0.0, 0.0, 0.9]) - eye
        forward /= np.linalg.norm(forward)
        right = np.cross(forward, [0.0, 0.0, 1.0])
        right /= np.linalg.norm(right)
        R = np.stack([right, np.cross(forward, right), forward])
        K = np.array([[FOCAL, 0.0, W / 2], [0.0, FOCAL, H / 2], [0.0, 0.0, 1.0]])
        cameras.append(Camera(f"c{i}", (W, H), K, np.array(dist), R, -R @ eye))
    return CameraRig(tuple(cameras))


def box_silhouettes(
    rig: CameraRig, low_m: tuple[float, ...], high_m: tuple[float, ...], side_m: float
) -> list[np.ndarray]:
    """What every camera sees of a box filled with voxels."""
    axes = [np.arange(low, high, side_m) for low, high in zip(low_m, high_m, strict=True)]
    points = np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 3)
    return [silhouette_of_voxels(camera, points, side_m) for camera in rig]


def silhouette(flesh: Flesh, state: np.ndarray, camera: Camera) -> np.ndarray:
    """Pixels whose ray passes a ball of the flesh: cones filled with closely spaced balls."""
    start, end = cones_of(flesh.body, state)
    u, v = np.meshgrid(np.arange(W), np.arange(H))
    rays = camera.rays(np.stack([u, v], axis=-1).astype(np.float64)).reshape(-1, 3)
    mask = np.zeros(len(rays), dtype=np.bool_)
    for a, b, (ra, rb) in zip(start, end, flesh.body.cones.radii, strict=True):
        for s in np.linspace(0.0, 1.0, 12):
            centre = a + s * (b - a) - camera.center
            across = (centre @ centre) - (rays @ centre) ** 2
            mask |= across <= (ra + s * (rb - ra)) ** 2
    return mask.reshape(H, W)


def bent(flesh: Flesh) -> np.ndarray:
    state = neutral_state(flesh.body)
    names = flesh.body.layout.names
    for name, value in (
        ("root_yaw", 0.6),
        ("right_shoulder_x", 0.5),
        ("left_shoulder_x", -0.7),
        ("left_elbow_z", -0.8),
        ("right_hip_y", -0.5),
        ("right_knee_y", 0.7),
    ):
        state[names.index(name)] = value
    return state


def outlines_of(
    flesh: Flesh, state: np.ndarray, rig: CameraRig, other: np.ndarray | None = None, scale: int = N_POINTS
) -> Outlines:
    masks = [silhouette(flesh, state, c) for c in rig]
    points = landmark_cloud(flesh, state)
    return person_outlines([pinhole_view(c) for c in rig], rig, masks, points, other, n_points=scale)


def landmark_cloud(flesh: Flesh, state: np.ndarray) -> np.ndarray:
    """Points all over the body, as a hull's surface would be."""
    start, end = cones_of(flesh.body, state)
    s = np.linspace(0.0, 1.0, 9)[:, None, None]
    axis = (start + s * (end - start)).reshape(-1, 3)
    rng = np.random.default_rng(0)
    return np.concatenate([axis + 0.06 * rng.normal(size=axis.shape) for _ in range(12)])


def problem_of(
    flesh: Flesh, outlines: Outlines, settings: OutlineFitSettings | None = None
) -> OutlineProblem:
    return OutlineProblem(flesh.body, flesh.table, outlines, settings or OutlineFitSettings())
