"""A small synthetic session, settings that make a run on it short, and the command line in this process."""

from __future__ import annotations

import contextlib
import hashlib
import io
import shutil
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any
from unittest import mock

import cv2
import numpy as np
import pytest

CAMERAS = ("cam_0", "cam_1", "cam_2", "cam_3")
N_FRAMES = 12
FPS = 10.0
SIZE = (240, 184)
SETTINGS = (
    "volume.voxel_size_m=0.04",
    "pose.n_layers=2",
    "pose.n_particles=50",
    "pose.n_start_frames=1",
    "pose.n_first_poses=1",
    "output.report_frames=1",
    "output.report_cameras=2",
)
# Without pictures, scene and plots: for tests that look at what was computed, not at how it is shown.
PLAIN = (*SETTINGS, 'output.formats=["bvh", "trc"]')


@cache
def small_session(base: Path) -> Path:
    """A session of 12 frames and four cameras, a man walking; made once in a process. Never change it: copy it."""
    pytest.importorskip("embreex", reason="rendering needs the extra synth (embreex)")
    from mocap.synth import synthesise
    from mocap.synth.scene import scene_from_dict

    scene = {
        "name": "small",
        "seed": 21,
        "n_frames": N_FRAMES,
        "fps": FPS,
        "n_background_frames": 5,
        "rig": {"n_cameras": len(CAMERAS), "size_px": list(SIZE)},
        "room": {"capture_m": [[-1.4, -1.3, 0.0], [1.4, 1.3, 2.1]]},
        "persons": [{"seed": 5, "motion": {"kind": "walk", "radii_m": [0.6, 0.5], "start_deg": 70}}],
    }
    return synthesise(scene_from_dict(scene), base / "small_session" / "session", workers=1)


def copy_session(session: Path, to: Path, *, masks: bool = False, n_frames: int | None = None) -> Path:
    """A copy that a test may damage; with `masks` the true silhouettes as masks/ instead of pictures.

    n_frames : with masks, the first so many frames, and the truth with them.
    """
    if not masks:
        shutil.copytree(session, to)
        return to
    to.mkdir(parents=True)
    for name in ("calibration.toml", "session.toml"):
        shutil.copy(session / name, to / name)
    shutil.copytree(session / "truth", to / "truth")
    for camera in CAMERAS:
        packed = np.load(session / "truth" / "masks" / f"{camera}.npz")["masks"]
        folder = to / "masks" / camera
        folder.mkdir(parents=True)
        for frame, mask in enumerate(np.unpackbits(packed, axis=2, count=SIZE[0])[:n_frames]):
            cv2.imwrite(str(folder / f"{frame:04d}.png"), mask * np.uint8(255))
    return to


def write_clip(path: Path, pictures: list[np.ndarray], fps: float = FPS) -> None:
    """A video of BGR pictures."""
    path.parent.mkdir(parents=True, exist_ok=True)
    height, width = pictures[0].shape[:2]
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"mp4v"), fps, (width, height))
    for picture in pictures:
        writer.write(picture)
    writer.release()


def read_clip(path: Path) -> list[np.ndarray]:
    """All pictures of a video, BGR."""
    capture = cv2.VideoCapture(str(path))
    pictures = []
    while (got := capture.read())[0]:
        pictures.append(got[1])
    capture.release()
    return pictures


def digests(folder: Path) -> dict[str, str]:
    """Relative path -> SHA-256 of every file under a folder."""
    files = sorted(p for p in folder.rglob("*") if p.is_file())
    return {str(p.relative_to(folder)): hashlib.sha256(p.read_bytes()).hexdigest() for p in files}


@dataclass(frozen=True)
class Said:
    """What a command answered."""

    code: int
    out: str
    err: str


def mocap(*arguments: object) -> Said:
    """Run the command line in this process. An exception that would be a traceback fails the test."""
    from mocap.cli import main

    out, err = io.StringIO(), io.StringIO()
    argv = ["mocap", *map(str, arguments)]
    code: Any = 0
    with (
        mock.patch.object(sys, "argv", argv),
        contextlib.redirect_stdout(out),
        contextlib.redirect_stderr(err),
    ):
        try:
            main()
        except SystemExit as leave:
            code = leave.code or 0
    return Said(int(code), out.getvalue(), err.getvalue())


def set_options(settings: tuple[str, ...]) -> list[str]:
    """Settings as options of the command line."""
    return [word for setting in settings for word in ("--set", setting)]


@contextlib.contextmanager
def full_disk(n_bytes: int) -> Iterator[None]:
    """No file of this process may grow beyond n_bytes: writes fail in the kernel, as on a full disk."""
    resource = pytest.importorskip("resource", reason="file size limits are a matter of POSIX")
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (n_bytes, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
