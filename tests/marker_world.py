"""A person with markers before a ring of cameras, drawn as detections only: another body than the pipeline's own.

The person's segments are stretched, and its markers sit elsewhere than their set says, so that a pipeline that knows
the set and the model only has something to find out.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from mocap.body import Body, landmarks_of, load_body_model, neutral_state, scale_body
from mocap.body.markers import Markers, load_marker_set, marker_positions, place_markers
from mocap.body.stretch import segment_groups, stretch_body
from mocap.data import LANDMARKS, Camera, CameraRig

Array = NDArray[np.float64]
FPS = 25.0
N_CAMERAS = 5
SIZE = (320, 248)
DIST = np.array([-0.10, 0.03, 0.0, 0.0])


def ring(n: int = N_CAMERAS, size: tuple[int, int] = SIZE, dist: Array = DIST) -> CameraRig:
    """Cameras on a circle of 3.1 m that look at its middle."""
    cameras = []
    for i in range(n):
        angle = 2 * np.pi * i / n + 0.2
        eye = np.array([3.1 * np.cos(angle), 3.0 * np.sin(angle), 1.3 + 0.8 * ((i * 3) % n) / n])
        forward = np.array([0.0, 0.0, 0.95]) - eye
        forward /= np.linalg.norm(forward)
        right = np.cross(forward, [0.0, 0.0, 1.0])
        right /= np.linalg.norm(right)
        R = np.array([right, np.cross(forward, right), forward])
        K = np.array(
            [
                [0.7 * size[0], 0.0, (size[0] - 1) / 2],
                [0.0, 0.7 * size[0], (size[1] - 1) / 2],
                [0.0, 0.0, 1.0],
            ]
        )
        cameras.append(Camera(f"cam_{i}", size, K, dist, R, -R @ eye))
    return CameraRig(tuple(cameras))


def spotted(rig: CameraRig, points: Array) -> list[NDArray[np.bool_]]:
    """What the cameras see of points (N, 3) m, each a square spot of seven pixels."""
    masks = []
    for camera in rig:
        mask = np.zeros(camera.size[::-1], dtype=np.uint8)
        uv = np.round(camera.project(points)[0]).astype(int)
        u, v = uv[((uv >= 0) & (uv < camera.size)).all(axis=1)].T
        mask[v, u] = 1
        masks.append(cv2.dilate(mask, np.ones((7, 7))) > 0)
    return masks


def other_body(height_m: float = 1.68) -> tuple[Body, Markers]:
    """Segments up to 8 % longer or shorter than the model's, markers up to 2 cm beside their places."""
    rng = np.random.default_rng(5)
    body = scale_body(load_body_model("anthropometric"), height_m)
    group = segment_groups(body)
    stretch = 1.0 + 0.08 * rng.uniform(-1, 1, (int(group.max()) + 1, 3))[group]
    markers = place_markers(load_marker_set("markers_20"), body)
    offset = markers.offset + rng.uniform(-0.02, 0.02, markers.offset.shape)
    return stretch_body(body, stretch), replace(markers, offset=offset)


def marching(body: Body, n_frames: int, fps: float = FPS) -> Array:
    """States (T, D): marching on a small circle, with arms that swing and bend."""
    names = body.layout.names
    states = np.tile(neutral_state(body), (n_frames, 1))
    t = np.arange(n_frames) / fps
    phase = 2 * np.pi * 0.9 * t
    heading = 0.6 * t

    def put(name: str, value: Array) -> None:
        states[:, names.index(name)] = value

    put("root_x", 0.5 * np.sin(heading))
    put("root_y", -0.5 * np.cos(heading))
    put("root_yaw", (heading + np.pi) % (2 * np.pi) - np.pi)
    for side, sign in (("right", 1.0), ("left", -1.0)):
        swing = sign * np.sin(phase)
        put(f"{side}_hip_y", -0.25 - 0.35 * swing)
        put(f"{side}_knee_y", 0.45 + 0.35 * np.sin(phase + (0.0 if sign > 0 else np.pi) - 1.0))
        put(f"{side}_shoulder_x", sign * (1.25 + 0.1 * np.cos(phase)))
        put(f"{side}_shoulder_z", 0.35 * swing)
        put(f"{side}_elbow_z", sign * (0.7 + 0.3 * np.cos(phase)))
    return np.clip(states, body.layout.lower, body.layout.upper)


def detect(
    rig: CameraRig,
    points: Array,
    *,
    rate: float,
    n_false: int,
    noise_px: float,
    rng: np.random.Generator,
) -> list[Array]:
    """Detections of one frame from markers (M, 3) m, per camera (n, 2) raw px, in no order."""
    out = []
    for camera in rig:
        uv, _ = camera.project(points)
        seen = uv[camera.contains(uv) & (rng.random(len(uv)) < rate)]
        false = rng.uniform(uv.min(axis=0), uv.max(axis=0), (n_false, 2))
        found = np.concatenate([seen, false])
        found = found + noise_px * rng.standard_normal(found.shape)
        out.append(rng.permutation(found[camera.contains(found)]))
    return out


@dataclass(frozen=True, eq=False)
class MarkerWorld:
    """states : (T, D) of `body`.  landmarks : (T, 15, 3) m.  points : (T, M, 3) m.

    detections : per frame, per camera (n, 2) raw px.
    """

    rig: CameraRig
    body: Body
    markers: Markers
    states: Array
    landmarks: Array
    points: Array
    detections: tuple[list[Array], ...]


@cache
def marker_world(
    n_frames: int = 30, rate: float = 0.8, n_false: int = 3, noise_px: float = 0.7, n_cameras: int = N_CAMERAS
) -> MarkerWorld:
    """A marching person and its detections."""
    rng = np.random.default_rng(8)
    rig = ring(n_cameras)
    body, markers = other_body()
    states = marching(body, n_frames)
    points = marker_positions(body, markers, states)
    detections = tuple(detect(rig, p, rate=rate, n_false=n_false, noise_px=noise_px, rng=rng) for p in points)
    return MarkerWorld(rig, body, markers, states, landmarks_of(body, states), points, detections)


def write_marker_session(world: MarkerWorld, root: Path, *, shifted: float | None = None) -> Path:
    """A session folder of calibration, detections and truth; no pictures.

    shifted : metres along x at which a second person walks the same way.
    """
    from mocap.data import Motion
    from mocap.io.calibration import write_calibration
    from mocap.io.tables import write_detections_csv, write_landmarks_csv

    (root / "detections").mkdir(parents=True)
    (root / "truth").mkdir()
    write_calibration(root / "calibration.toml", world.rig)
    (root / "session.toml").write_text(f"fps = {FPS}\n")
    for c, camera in enumerate(world.rig):
        found = [d[c] for d in world.detections]
        if shifted is not None:
            second = [camera.project(p + np.array([shifted, 0.0, 0.0]))[0] for p in world.points]
            found = [np.concatenate([a, b[camera.contains(b)]]) for a, b in zip(found, second, strict=True)]
        frame = np.repeat(np.arange(len(found)), [len(uv) for uv in found])
        write_detections_csv(root / "detections" / f"{camera.name}.csv", frame, np.concatenate(found))
    frames = np.arange(len(world.states))
    write_landmarks_csv(root / "truth" / "landmarks.csv", [Motion(1, frames, frames / FPS, world.landmarks)])
    assert world.landmarks.shape[1] == len(LANDMARKS)
    return root
