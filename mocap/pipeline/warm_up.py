"""Warm-up: every kernel that a run needs is compiled, by a run on a few small pictures of a stick figure."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from mocap.compiling import compilation_shown
from mocap.data import Camera, CameraRig
from mocap.io.calibration import write_calibration
from mocap.pipeline.config import load_config
from mocap.pipeline.run import run_session
from mocap.progress import Progress, no_progress

Array = NDArray[np.float64]

_N_CAMERAS, _SIZE, _FOCAL_PX = 6, (192, 144), 150.0
_N_EMPTY, _N_FRAMES = 5, 12  # fewer frames are no clip: front and back would not be told apart by motion
_FPS = 10.0
_ROOM_M = ((-1.0, -1.0, 0.0), (1.0, 1.0, 2.1))
_SHADOW_M, _SHADOW_LIGHT = 0.45, 0.7  # radius of the shadow, and the share of the light that is left there
# What makes a run short and changes no kernel.
_SETTINGS = (
    "volume.voxel_size_m=0.04",
    "pose.n_layers=1",
    "pose.n_particles=40",
    "pose.n_start_frames=1",
    "pose.n_first_poses=1",
    'output.formats=["bvh", "report"]',
    "output.report_frames=1",
    "output.report_cameras=1",
)
# Ends and radius of limbs, m, on a person of 1.75 m at the origin, and their colours.
_LIMBS = (
    ((0.0, 0.0, 1.0), (0.0, 0.0, 1.4), 0.14, (60, 60, 190)),
    ((0.0, 0.0, 1.6), (0.0, 0.0, 1.66), 0.10, (120, 150, 200)),
    ((0.0, 0.2, 1.4), (0.05, 0.45, 1.15), 0.05, (60, 190, 60)),
    ((0.05, 0.45, 1.15), (0.25, 0.5, 1.0), 0.04, (120, 150, 200)),
    ((0.0, -0.2, 1.4), (0.0, -0.4, 1.1), 0.05, (60, 190, 60)),
    ((0.0, -0.4, 1.1), (0.1, -0.45, 0.85), 0.04, (120, 150, 200)),
    ((0.0, 0.1, 0.95), (0.1, 0.12, 0.5), 0.08, (190, 60, 60)),
    ((0.1, 0.12, 0.5), (0.0, 0.12, 0.06), 0.06, (90, 60, 60)),
    ((0.0, -0.1, 0.95), (0.0, -0.12, 0.5), 0.08, (190, 60, 60)),
    ((0.0, -0.12, 0.5), (-0.1, -0.12, 0.06), 0.06, (90, 60, 60)),
)


def warm_up(progress: Progress = no_progress) -> int:
    """Compile what a run with the preset `default` needs; the number of kernels that were not compiled yet.

    They are kept in numba's cache, so that the next run, and every other process, begins at once.
    """
    with tempfile.TemporaryDirectory(prefix="mocap-") as folder, compilation_shown(progress) as compiled:
        session = _small_session(Path(folder) / "session")
        run_session(session, Path(folder) / "out", config=load_config(settings=_SETTINGS), n_threads=1)
        return compiled.n


def _small_session(root: Path) -> Path:
    """A stick figure that walks before a few cameras on a ring."""
    rig = small_rig()
    rng = np.random.default_rng(0)
    root.mkdir(parents=True)
    write_calibration(root / "calibration.toml", rig)
    (root / "session.toml").write_text(
        f"fps = {_FPS}\nroom_bounds_m = {[list(c) for c in _ROOM_M]}\n", encoding="utf-8"
    )
    for camera in rig:
        wall = rng.integers(90, 150, (_SIZE[1], _SIZE[0], 3)).astype(np.float64)
        for frame in range(-_N_EMPTY, _N_FRAMES):
            noisy = wall + rng.normal(0.0, 1.5, wall.shape)
            picture = np.clip(noisy, 0, 255).astype(np.uint8)
            folder = root / ("background" if frame < 0 else "images") / camera.name
            folder.mkdir(parents=True, exist_ok=True)
            if frame >= 0:
                _draw(picture, camera, np.array([0.04 * frame - 0.2, 0.0, 0.0]))
            cv2.imwrite(str(folder / f"{frame + _N_EMPTY:03d}.png"), picture)
    return root


def small_rig() -> CameraRig:
    """Six cameras of 192 x 144 around the origin, which look at a height of 1 m."""
    return CameraRig(tuple(_cameras()))


def _cameras() -> Iterator[Camera]:
    K = np.array([[_FOCAL_PX, 0, _SIZE[0] / 2], [0, _FOCAL_PX, _SIZE[1] / 2], [0, 0, 1.0]])
    for i in range(_N_CAMERAS):
        angle = 2 * np.pi * i / _N_CAMERAS
        eye = np.array([2.8 * np.cos(angle), 2.8 * np.sin(angle), 1.6])
        z = np.array([0.0, 0.0, 1.0]) - eye
        z /= np.linalg.norm(z)
        x = np.cross(z, [0.0, 0.0, 1.0])
        x /= np.linalg.norm(x)
        R = np.stack([x, np.cross(z, x), z])
        yield Camera(f"cam_{i}", _SIZE, K, np.array([-0.05, 0.01, 0.0, 0.0]), R, -R @ eye)


def _draw(picture: NDArray[np.uint8], camera: Camera, place: Array) -> None:
    """The stick figure at a place (3,) m and its shadow on the floor into a picture (H, W, 3)."""
    around = np.linspace(0.0, 2 * np.pi, 12, endpoint=False)
    rim = np.stack([_SHADOW_M * np.cos(around), _SHADOW_M * np.sin(around), np.zeros(12)], axis=1)
    dark = np.zeros(picture.shape[:2], dtype=np.uint8)
    cv2.fillConvexPoly(dark, camera.project(rim + place)[0].round().astype(np.int32), 1)
    picture[dark > 0] = (_SHADOW_LIGHT * picture[dark > 0]).astype(np.uint8)
    for start, end, radius_m, colour in _LIMBS:
        uv, depth = camera.project(np.array([start, end]) + place)
        width = max(1, round(2 * radius_m * _FOCAL_PX / float(depth.mean())))
        a, b = (tuple(int(v) for v in point.round()) for point in uv)
        cv2.line(picture, a, b, colour, width)
