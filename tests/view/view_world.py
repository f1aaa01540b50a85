"""A small procedural world for the tests of the view: three cameras, a walking person of cones, its hull."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from mocap.data import BONES, LANDMARKS, Camera, CameraRig, Hull, VoxelGrid
from mocap.view.overlay import BodyPart, side_of_landmark

Array = NDArray[np.float64]
SIZE = (320, 244)
RADIUS_M = {"neck": 0.15, "head": 0.1, "elbow": 0.05, "wrist": 0.04, "knee": 0.08, "ankle": 0.06}


def camera_at(name: str, center: Array, target: Array, *, size: tuple[int, int] = SIZE) -> Camera:
    """A camera with some distortion that looks from center (3,) m to target (3,) m."""
    z = (target - center) / np.linalg.norm(target - center)
    x = np.cross(z, [0.0, 0.0, 1.0])
    x /= np.linalg.norm(x)
    R = np.stack([x, np.cross(z, x), z])
    f = 0.68 * size[0]
    K = np.array([[f, 0, size[0] / 2 + 3.0], [0, f, size[1] / 2 - 2.0], [0, 0, 1.0]])
    return Camera(name, size, K, np.array([-0.12, 0.03, 0.0, 0.0, 0.0]), R, -R @ center)


def rig(size: tuple[int, int] = SIZE) -> CameraRig:
    target = np.array([0.0, 0.0, 0.9])
    centers = {"front": (2.9, 0.2, 1.6), "corner": (-1.9, 2.4, 2.3), "side": (-0.3, -2.7, 1.2)}
    return CameraRig(tuple(camera_at(n, np.array(c), target, size=size) for n, c in centers.items()))


def pose(t: float) -> Array:
    """Landmarks (15, 3) m of a walker at time t (s): legs and arms swing, the root moves along y."""
    root = np.array([0.0, -0.6 + 0.6 * t, 0.92])
    swing = 0.5 * np.sin(2 * np.pi * t)
    x, y, z = np.array([0.0, 1.0, 0.0]), np.array([-1.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0])

    def hang(angle: float) -> Array:
        return np.sin(angle) * x - np.cos(angle) * z

    p = {"pelvis": root, "neck": root + 0.5 * z, "head": root + 0.8 * z}
    for side, sign in (("left", 1.0), ("right", -1.0)):
        p[f"{side}_shoulder"] = root + 0.46 * z + sign * 0.19 * y
        p[f"{side}_elbow"] = p[f"{side}_shoulder"] + 0.28 * hang(-sign * swing) + sign * 0.05 * y
        p[f"{side}_wrist"] = p[f"{side}_elbow"] + 0.24 * hang(-sign * swing + 0.4)
        p[f"{side}_hip"] = root + sign * 0.09 * y
        p[f"{side}_knee"] = p[f"{side}_hip"] + 0.42 * hang(sign * swing)
        p[f"{side}_ankle"] = p[f"{side}_knee"] + 0.4 * hang(sign * swing - 0.25)
    return np.array([p[name] for name in LANDMARKS])


def body(landmarks: Array) -> list[BodyPart]:
    """One truncated cone per bone that has a thickness."""
    parts = []
    for a, b in BONES:
        if a not in LANDMARKS or b not in LANDMARKS:
            continue
        tip = RADIUS_M.get(b.split("_")[-1])
        if tip is None:
            continue
        p0, p1 = landmarks[LANDMARKS.index(a)], landmarks[LANDMARKS.index(b)]
        parts.append(BodyPart(b, side_of_landmark(b), ((p0, p1, 1.15 * tip, 0.9 * tip),)))
    return parts


def silhouette(camera: Camera, parts: list[BodyPart]) -> NDArray[np.bool_]:
    """Mask (H, W) of balls along every cone: a second way to draw a cone."""
    mask = np.zeros((camera.size[1], camera.size[0]), dtype=np.uint8)
    for part in parts:
        for p0, p1, r0, r1 in part.cones:
            s = np.linspace(0, 1, 40)
            uv, depth = camera.project(p0 + s[:, None] * (p1 - p0))
            radius = (r0 + s * (r1 - r0)) * camera.K[0, 0] / depth
            for at, r in zip(uv[np.isfinite(uv).all(axis=1)], radius, strict=False):
                cv2.circle(mask, (round(at[0]), round(at[1])), round(r), 1, -1)
    return mask.astype(np.bool_)


def picture(camera: Camera, mask: NDArray[np.bool_], rng: np.random.Generator) -> NDArray[np.uint8]:
    """A grey room with noise and a person in a dark red pullover."""
    h, w = mask.shape
    v, u = np.mgrid[:h, :w]
    room = 120 + 40 * np.sin(u / 37.0) * np.cos(v / 23.0) + 30 * (v > 0.6 * h)
    image = np.repeat(room[..., None], 3, axis=2) * np.array([0.95, 1.0, 0.9])
    image[mask] = (120, 45, 50)
    image += rng.normal(0, 6, image.shape)
    return image.clip(0, 255).astype(np.uint8)


def hull(cameras: CameraRig, masks: list[NDArray[np.bool_]], voxel_size_m: float = 0.03) -> Hull:
    """Voxels whose centre is foreground in every view."""
    grid = VoxelGrid.from_bounds(np.array([-0.9, -1.4, 0.0]), np.array([0.9, 1.5, 1.95]), voxel_size_m)
    voxels = np.arange(grid.n_voxels, dtype=np.int32)
    for camera, mask in zip(cameras, masks, strict=True):
        uv, _ = camera.project(grid.centers(voxels))
        inside = camera.contains(uv)
        u, v = np.rint(np.where(inside[:, None], uv, 0)).astype(int).T
        voxels = voxels[inside & mask[v, u]]
    dense = np.pad(grid.dense(voxels), 1)
    core = dense[1:-1, 1:-1, 1:-1].copy()
    for axis in range(3):
        for shift in (-1, 1):
            core &= np.roll(dense, shift, axis)[1:-1, 1:-1, 1:-1]
    is_surface = ~core.ravel()[voxels]
    rgb = np.tile(np.array([120, 45, 50], dtype=np.uint8), (len(voxels), 1))
    return Hull(grid, voxels, is_surface, is_surface.astype(np.uint8) * 2, rgb)
