"""What depth cameras of a session measure, as files; and a depth camera put where it stands."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from mocap.cli import app
from mocap.data import CameraRig
from mocap.errors import MocapError
from mocap.io.calibration import read_calibration, write_calibration
from mocap.io.session import open_session
from mocap.pipeline.measured import (
    export_clouds,
    export_room,
    register_session,
    write_registered,
)

SCENE = {
    "name": "small",
    "seed": 22,
    "n_frames": 5,
    "fps": 10.0,
    "masks_only": True,
    "rig": {"n_cameras": 7, "size_px": [320, 240]},
    "depth": {"cameras": ["cam_0", "cam_1"]},
    "room": {
        "furniture": [
            {"kind": "table", "center_m": [0.2, 0.7], "size_m": [1.1, 0.6], "heading_deg": 25, "solid": True},
            {"kind": "chair", "center_m": [-0.9, -0.4], "heading_deg": 100, "solid": True},
            {
                "kind": "table",
                "center_m": [0.7, -0.8],
                "size_m": [0.5, 0.5],
                "height_m": 1.3,
                "heading_deg": 70,
                "solid": True,
            },
        ]
    },
    "persons": [{"seed": 5, "motion": {"kind": "walk", "radii_m": [0.3, 0.3]}}],
}
# Of two cameras with 320 x 240 pixels that stand 51 degrees apart, 4 m from what they measure.
PLACE_M, DIRECTION_DEG = 0.03, 0.5


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Path:
    pytest.importorskip("embreex", reason="rendering needs the extra synth (embreex)")
    from mocap.synth import synthesise
    from mocap.synth.scene import scene_from_dict

    return synthesise(scene_from_dict(SCENE), tmp_path_factory.mktemp("measured") / "session", workers=1)


def points_of(path: Path) -> np.ndarray:
    head, _, body = path.read_bytes().partition(b"end_header\n")
    points = np.frombuffer(body, dtype=[("xyz", "<f4", 3), ("rgb", "u1", 3)])
    assert f"element vertex {len(points)}\n".encode() in head
    return points["xyz"]


def test_clouds_show_floor_furniture_and_the_person(session: Path, tmp_path: Path) -> None:
    written = export_clouds(session, tmp_path / "clouds", frames=(1, 3))
    assert [path.name for path in written] == ["cloud_000001.ply", "cloud_000002.ply"]
    points = points_of(written[0])
    assert len(points) > 50_000
    table = np.linalg.norm(points[:, :2] - [0.2, 0.7], axis=1) < 0.2
    assert np.median(points[table, 2]) == pytest.approx(0.74, abs=0.03)
    assert np.quantile(points[:, 2], 0.02) > -0.2  # nothing under the floor but noise
    (walker,) = np.loadtxt(session / "truth" / "tracks.csv", delimiter=",", skiprows=1)[[1], 3:5]
    near = np.linalg.norm(points[:, :2] - walker, axis=1) < 0.3
    assert np.quantile(points[near, 2], 0.99) > 1.4


def test_mistakes_are_told(session: Path, tmp_path: Path) -> None:
    with pytest.raises(MocapError, match=r"no depth camera cam_5; did you mean"):
        register_session(session, "cam_5")
    one = tmp_path / "one"
    shutil.copytree(session, one)
    shutil.rmtree(one / "depth" / "cam_1")
    with pytest.raises(MocapError, match=r"no other camera .*camera cam_0.*--refine"):
        register_session(one, "cam_0")
    shutil.rmtree(one / "depth")
    for call in (lambda: export_clouds(one, tmp_path / "x"), lambda: export_room(one, tmp_path / "x.ply")):
        with pytest.raises(MocapError, match="no camera of the session measures depth"):
            call()
    assert not (tmp_path / "x").exists()


def test_the_commands(session: Path, tmp_path: Path) -> None:
    done = CliRunner().invoke(app, ["depth", str(session), "-o", str(tmp_path / "clouds"), "--frames", "0:1"])
    assert done.exit_code == 0, done.output
    assert "1 file: " in done.output
    out = str(tmp_path / "new.toml")
    alone = CliRunner().invoke(app, ["calibrate", "--camera", "cam_0", "-o", out])
    assert "--register must be given" in str(alone.exception)
    mixed = CliRunner().invoke(
        app, ["calibrate", "--register", str(session), "--camera", "cam_0", "--height-m", "1.8", "-o", out]
    )
    assert "--height-m has no meaning" in str(mixed.exception)


@pytest.mark.usefixtures("open3d")
def test_a_camera_is_put_where_it_stands(session: Path, tmp_path: Path) -> None:
    true = open_session(session).rig
    wrong = tmp_path / "wrong.toml"
    camera = true["cam_0"]
    moved = replace(camera, R=np.eye(3), t=np.array([0.0, 0.0, 0.3]))  # looks up from under the floor
    write_calibration(wrong, CameraRig(tuple(moved if c.name == "cam_0" else c for c in true)))
    registered = register_session(session, "cam_0", calibration=wrong)
    write_registered(tmp_path / "right.toml", registered)
    found = read_calibration(tmp_path / "right.toml").rig
    assert np.linalg.norm(found["cam_0"].center - camera.center) < PLACE_M
    assert np.degrees(np.arccos(found["cam_0"].R[2] @ camera.R[2])) < DIRECTION_DEG
    assert (found["cam_1"].t == true["cam_1"].t).all()


@pytest.mark.usefixtures("open3d")
def test_the_room_is_without_the_person(session: Path, tmp_path: Path) -> None:
    assert export_room(session, tmp_path / "room" / "room.ply", voxel_m=0.04) > 1000
    assert (tmp_path / "room" / "room.ply").read_bytes().startswith(b"ply")
