"""The 3D recording: written whole, bounded in size, and a missing extra is one clear message."""

from __future__ import annotations

import builtins
import importlib.util
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import view_world as world
from scipy.spatial.transform import Rotation

from mocap.data import Camera, Tracks
from mocap.errors import MocapError
from mocap.view import scene
from mocap.view.scene import CodedPictures, SceneFrame, ScenePictures, write_rrd

needs_rerun = pytest.mark.skipif(
    importlib.util.find_spec("rerun") is None, reason="rerun-sdk is not installed"
)
BOUNDS = ((-2.0, -1.5, 0.0), (2.0, 1.5, 2.2))


@pytest.fixture(scope="module")
def frame() -> SceneFrame:
    landmarks = world.pose(0.2)
    parts = world.body(landmarks)
    masks = [world.silhouette(c, parts) for c in world.rig()]
    return SceneFrame(4, 0.2, world.hull(world.rig(), masks, 0.06), {1: landmarks}, {1: parts})


def noise(rng: np.random.Generator) -> dict[str, np.ndarray]:
    """Pictures of all cameras that no format makes small."""
    return {c.name: rng.integers(0, 255, (*c.size[::-1], 3), dtype=np.uint8) for c in world.rig()}


def coded(frame: int, **files: bytes) -> CodedPictures:
    return CodedPictures(frame, frame / 30, files)


@needs_rerun
def test_writes_a_recording(tmp_path: Path, frame):
    path = tmp_path / "scene.rrd"
    unknown = np.full((15, 3), np.nan)
    frames = [
        frame,
        replace(frame, frame=5, hull=None),
        replace(frame, frame=6, persons={1: unknown, 2: frame.persons[1]}, parts={}),
        SceneFrame(7, 0.3),
    ]
    table = Tracks(np.arange(4), np.ones(4, int), np.arange(4) / 30, np.arange(12.0).reshape(4, 3))
    write_rrd(path, world.rig(), frames, tracks=table, bounds_m=BOUNDS)
    content = path.read_bytes()
    assert content[:4] == b"RRF2"
    assert len(content) > 10_000
    files = ScenePictures(world.rig(), 4).fitting(noise(np.random.default_rng(1)))
    assert files is not None
    write_rrd(path, world.rig(), frames, pictures=lambda: [coded(4, **files)], tracks=table, bounds_m=BOUNDS)
    assert len(path.read_bytes()) > len(content) + 0.9 * sum(len(file) for file in files.values())
    assert [p.name for p in tmp_path.iterdir()] == ["scene.rrd"]


@needs_rerun
def test_the_viewer_opens_with_our_layout(tmp_path: Path):
    write_rrd(tmp_path / "a.rrd", world.rig(), [])
    printed = subprocess.run(
        [sys.executable, "-m", "rerun", "rrd", "print", str(tmp_path / "a.rrd")],
        capture_output=True,
        text=True,
        timeout=60,
        check=True,
    )
    (active,) = [line for line in printed.stdout.splitlines() if "BlueprintActivationCommand" in line]
    assert "make_active: true" in active
    assert printed.stdout.count("ViewBlueprint:space_origin") == 1 + len(world.rig())


@needs_rerun
def test_cameras_alone_make_a_recording(tmp_path: Path):
    write_rrd(tmp_path / "a.rrd", world.rig(), [])
    assert (tmp_path / "a.rrd").stat().st_size > 500


@needs_rerun
def test_long_sessions_stay_below_the_limit(tmp_path: Path, frame):
    rng = np.random.default_rng(2)
    limit = 4_000_000

    coder = ScenePictures(world.rig(), 60, max_bytes=limit)
    stride = coder.stride(noise(rng))
    assert 2 < stride < 60
    kept = [files for files in (coder.fitting(noise(rng)) for _ in range(0, 60, stride)) if files]
    assert 0.7 * 60 / stride < len(kept)
    write_rrd(
        tmp_path / "a.rrd",
        world.rig(),
        (replace(frame, frame=i) for i in range(60)),
        pictures=lambda: [coded(k * stride, **files) for k, files in enumerate(kept)],
        max_bytes=limit,
    )
    assert (tmp_path / "a.rrd").stat().st_size < 1.2 * limit
    assert [coder.fitting(noise(rng)) for _ in range(60)][-1] is None
    crowded = ScenePictures(world.rig(), 60, n_others=60, max_bytes=limit)
    assert crowded.stride(noise(rng)) > stride


@needs_rerun
def test_failure_leaves_the_earlier_file(tmp_path: Path, frame):
    path = tmp_path / "a.rrd"
    path.write_bytes(b"earlier")
    with pytest.raises(ValueError, match="nobody"):
        write_rrd(path, world.rig(), [frame], pictures=lambda: [coded(4, nobody=b"")])
    assert path.read_bytes() == b"earlier"
    assert [p.name for p in tmp_path.iterdir()] == ["a.rrd"]
    with pytest.raises(MocapError, match="Remedy"):
        write_rrd(tmp_path / "missing" / "a.rrd", world.rig(), [frame])


def test_missing_extra_is_one_clear_message(tmp_path: Path, monkeypatch):
    real = builtins.__import__

    def without_rerun(name, *args, **kwargs):
        if name.startswith("rerun"):
            raise ImportError(name)
        return real(name, *args, **kwargs)

    monkeypatch.setattr(builtins, "__import__", without_rerun)
    with pytest.raises(MocapError, match=r"mocap-volumes\[view\]"):
        write_rrd(tmp_path / "a.rrd", world.rig(), [])
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("is_fisheye", [False, True])
def test_shown_picture_agrees_with_its_pinhole(is_fisheye):
    base = world.rig()["front"]
    camera = Camera("a", base.size, base.K, [-0.1, 0.02, 0.0, 0.0], base.R, base.t, is_fisheye)
    lens, pinhole = scene._Lens.of(camera, 200), scene._Pinhole.of(camera, 200)
    assert pinhole.size == (200, round(244 * 200 / 320))
    columns, rows = np.meshgrid(np.arange(320), np.arange(244))
    filmed_at = lens.apply(np.stack([columns // 2, rows, 0 * rows], axis=2).astype(np.uint8))
    for point in (np.array([0.0, 0.1, 1.0]), np.array([0.4, -0.5, 0.3])):
        in_camera = camera.R @ point + camera.t
        shown = pinhole.K @ (in_camera / in_camera[2])
        u, v = np.rint(shown[:2]).astype(int)
        filmed = camera.project(point)[0]
        # every filmed pixel holds its own place (half of the column, to fit a byte)
        assert np.hypot(2.0 * filmed_at[v, u, 0] + 0.5 - filmed[0], filmed_at[v, u, 1] - filmed[1]) < 2.2


def test_turn_from_z_turns_z():
    rng = np.random.default_rng(3)
    directions = rng.normal(size=(20, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    for direction in [*directions, np.array([0.0, 0, 1]), np.array([0.0, 0, -1])]:
        turn = Rotation.from_quat(scene._turn_from_z(direction))
        assert np.allclose(turn.apply([0.0, 0, 1]), direction, atol=1e-9)
