"""Persons before a ring of cameras, seen as keypoints only: exact ones, or with the errors of a network."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
from marker_world import FPS, marching, ring
from numpy.typing import NDArray

from mocap.body import Body, landmarks_of, load_body_model, scale_body
from mocap.body.keypoints import place_keypoints
from mocap.body.markers import Markers, marker_positions
from mocap.data import LANDMARKS, CameraRig, Motion
from mocap.data.keypoints import N_KEYPOINTS
from mocap.io.calibration import write_calibration
from mocap.io.keypoints import write_keypoints_csv
from mocap.io.tables import write_landmarks_csv

Array = NDArray[np.float64]
SIZE = (640, 496)


@dataclass(frozen=True, eq=False)
class KeypointWorld:
    """states : per person (T, D) of `body`.  landmarks : per person (T, 15, 3) m.  figures : per frame, per camera, the
    (K, 3) of every person: u px, v px, confidence."""

    rig: CameraRig
    body: Body
    markers: Markers
    states: tuple[Array, ...]
    landmarks: tuple[Array, ...]
    figures: tuple[list[list[Array]], ...]


@cache
def keypoint_world(
    n_frames: int = 12, noise_px: float = 0.0, n_cameras: int = 4, apart_m: float | None = None
) -> KeypointWorld:
    """Marching persons.  apart_m : of a second person who does the same a little later; None = there is one."""
    rng = np.random.default_rng(3)
    rig = ring(n_cameras, SIZE)
    body = scale_body(load_body_model("girdle"), 1.70)
    markers = place_keypoints(body)
    states = [marching(body, n_frames)]
    if apart_m is not None:
        second = marching(body, n_frames + 7)[7:]
        second[:, 1] += apart_m
        states.append(second)
    points = [marker_positions(body, markers, s) for s in states]
    figures = tuple([[_seen(c, p[f], noise_px, rng) for p in points] for c in rig] for f in range(n_frames))
    return KeypointWorld(
        rig, body, markers, tuple(states), tuple(landmarks_of(body, s) for s in states), figures
    )


def _seen(camera: object, points: Array, noise_px: float, rng: np.random.Generator) -> Array:
    uv, _ = camera.project(points)  # type: ignore[attr-defined]
    uv = uv + noise_px * rng.standard_normal(uv.shape)
    confidence = np.where(camera.contains(uv), 0.9, np.nan)  # type: ignore[attr-defined]
    assert len(points) == N_KEYPOINTS
    return np.column_stack([np.where(np.isfinite(confidence)[:, None], uv, np.nan), confidence])


def write_keypoint_session(world: KeypointWorld, root: Path, figures: Sequence[object] | None = None) -> Path:
    """A session folder of calibration, keypoints and truth; no pictures."""
    (root / "keypoints").mkdir(parents=True)
    (root / "truth").mkdir()
    write_calibration(root / "calibration.toml", world.rig)
    (root / "session.toml").write_text(f"fps = {FPS}\n")
    for c, camera in enumerate(world.rig):
        rows = [(f, k, p) for f, frame in enumerate(figures or world.figures) for k, p in enumerate(frame[c])]  # type: ignore[arg-type]
        write_keypoints_csv(root / "keypoints" / f"{camera.name}.csv", rows)
    frames = np.arange(len(world.states[0]))
    motions = [Motion(k + 1, frames, frames / FPS, marks) for k, marks in enumerate(world.landmarks)]
    write_landmarks_csv(root / "truth" / "landmarks.csv", motions)
    assert world.landmarks[0].shape[1] == len(LANDMARKS)
    return root
