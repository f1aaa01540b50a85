"""Few cameras, and one whose picture ends above somebody's knees: the others keep his legs."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import pytest
from small_session import CAMERAS, PLAIN, SIZE, copy_session, small_session

from mocap.data import CameraRig
from mocap.io.calibration import read_calibration, write_calibration
from mocap.io.store import StageStore
from mocap.pipeline.config import load_config
from mocap.pipeline.run import run_session
from mocap.products.hulls import read_hulls

SEEN_ROWS = SIZE[1] // 2  # of the picture that is cut


@pytest.fixture(scope="module")
def cut(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The small session with the lower half of a camera's pictures missing."""
    base = small_session(tmp_path_factory.getbasetemp())
    root = copy_session(base, tmp_path_factory.mktemp("cut") / "session", masks=True, n_frames=4)
    for path in (root / "masks" / CAMERAS[0]).iterdir():
        mask = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
        assert mask[SEEN_ROWS:].any(), "the person reaches below"
        cv2.imwrite(str(path), mask[:SEEN_ROWS])
    rig = read_calibration(root / "calibration.toml").rig
    cameras = [replace(c, size=(SIZE[0], SEEN_ROWS)) if c.name == CAMERAS[0] else c for c in rig]
    write_calibration(root / "calibration.toml", CameraRig(tuple(cameras)))
    return root


def lowest_m(session: Path, out: Path, *settings: str) -> list[float]:
    """Height of the lowest voxel of every frame."""
    run_session(session, out, config=load_config("default", (*PLAIN, *settings)), until="carve")
    hulls = dict(read_hulls(StageStore(out / "store.zarr")))
    assert len(hulls) == 4
    return [float(hull.grid.centers(hull.voxels)[:, 2].min()) for hull in hulls.values()]


def test_what_hangs_on_a_person_needs_one_camera_less(cut: Path, tmp_path: Path) -> None:
    assert max(lowest_m(cut, tmp_path / "auto")) < 0.1


def test_cameras_that_were_asked_for_are_asked(cut: Path, tmp_path: Path) -> None:
    assert min(lowest_m(cut, tmp_path / "four", "volume.min_views=4")) > 0.4
