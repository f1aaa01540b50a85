"""The pose stage's key knows what is in the files that the configuration names."""

from importlib import resources
from pathlib import Path

import numpy as np
import pytest

from mocap.data import Camera, CameraRig
from mocap.io.calibration import write_calibration
from mocap.io.session import Session, open_session
from mocap.pipeline.config import load_config
from mocap.pipeline.keys import stage_keys

PRESETS = {
    "body.model": "presets/thesis.toml",
    "body.marker_set": "marker_sets/markers_20.toml",
    "pose.hierarchy": "scalable/model1.toml",
    "pose.limbs": "scalable/limbs.toml",
}


@pytest.fixture
def session(tmp_path: Path) -> Session:
    K = np.array([[90.0, 0.0, 47.5], [0.0, 90.0, 39.5], [0.0, 0.0, 1.0]])
    R = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, -1.0], [-1.0, 0.0, 0.0]])
    names = ("left", "right")
    centres = np.array([[3.0, 0.0, 1.2], [3.0, 0.5, 1.3]])
    rig = CameraRig(
        tuple(Camera(n, (96, 80), K, np.zeros(5), R, -R @ c) for n, c in zip(names, centres, strict=True))
    )
    write_calibration(tmp_path / "calibration.toml", rig)
    (tmp_path / "detections").mkdir()
    for name in names:
        (tmp_path / "detections" / f"{name}.csv").write_text("frame,u_px,v_px\n0,20.0,30.0\n1,21.0,31.0\n")
    (tmp_path / "session.toml").write_text("fps = 10\n")
    return open_session(tmp_path)


@pytest.mark.parametrize("kind", ["voxels", "markers"])
@pytest.mark.parametrize("key", PRESETS)
def test_editing_a_named_file_makes_the_poses_stale(
    session: Session, tmp_path: Path, key: str, kind: str
) -> None:
    own = tmp_path / "own.toml"
    text = (resources.files("mocap.body") / PRESETS[key]).read_text("utf-8")
    own.write_text(text)
    config = load_config("default", (f"{key}={own}",))
    before = stage_keys(session, config, 0, kind)
    assert stage_keys(session, config, 0, kind) == before
    own.write_text(text.replace('source = "', 'source = "Edited. ', 1))
    after = stage_keys(session, config, 0, kind)
    assert after["pose"] != before["pose"]
    assert {k: v for k, v in after.items() if k != "pose"} == {k: v for k, v in before.items() if k != "pose"}
