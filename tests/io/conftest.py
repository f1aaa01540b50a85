"""Small rigs and session folders for the tests of mocap.io."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from io_samples import frame_picture, look_at, write_video

from mocap.data import CameraRig
from mocap.io.calibration import write_calibration


@pytest.fixture
def rig() -> CameraRig:
    """Three cameras of different sizes, whose names do not sort like their order."""
    return CameraRig(
        (
            look_at("back", np.array([-3.0, 0.5, 1.5]), (64, 48)),
            look_at("cam_10", np.array([2.0, 2.5, 2.0]), (48, 40)),
            look_at("cam_2", np.array([1.5, -3.0, 1.2]), (56, 32)),
        )
    )


@pytest.fixture
def make_session(tmp_path: Path, rig: CameraRig) -> Callable[..., Path]:
    """Builds a session folder of videos: make_session(n_frames=..., counts={camera: n}, sizes=..., fps=...)."""

    def make(
        n_frames: int = 12,
        *,
        name: str = "session",
        counts: dict[str, int] | None = None,
        sizes: dict[str, tuple[int, int]] | None = None,
        fps: dict[str, float] | None = None,
        skip: tuple[str, ...] = (),
    ) -> Path:
        root = tmp_path / name
        root.mkdir()
        write_calibration(root / "calibration.toml", rig)
        for i, camera in enumerate(rig):
            if camera.name in skip:
                continue
            size = (sizes or {}).get(camera.name, camera.size)
            n = (counts or {}).get(camera.name, n_frames)
            pictures = [frame_picture(size, f, i) for f in range(n)]
            write_video(root / "videos" / f"{camera.name}.mp4", pictures, (fps or {}).get(camera.name, 25.0))
        return root

    return make
