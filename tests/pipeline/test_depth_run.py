"""A run on a session with a depth camera: less volume, the store's new arrays, keys, and no trace without depth."""

from __future__ import annotations

import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest
from keypoint_world import keypoint_world
from small_session import PLAIN

from mocap.body.markers import marker_positions
from mocap.io.calibration import write_calibration
from mocap.io.session import open_session
from mocap.io.store import StageStore
from mocap.pipeline.config import load_config
from mocap.pipeline.keys import stage_keys
from mocap.pipeline.people_check import check_people
from mocap.pipeline.run import run_session
from mocap.products.hulls import measured_from_arrays
from mocap.products.occluders import stored_occluders
from mocap.volume.known_persons import flesh_along
from mocap.volume.residuals import silhouette

SCENE = {
    "name": "small",
    "seed": 21,
    "n_frames": 4,
    "fps": 10.0,
    "masks_only": True,
    "rig": {"n_cameras": 3, "size_px": [240, 184]},
    "room": {"capture_m": [[-1.4, -1.3, 0.0], [1.4, 1.3, 2.1]]},
    "depth": {"cameras": ["cam_1"], "noise_per_m": 0.0003},
    "persons": [{"seed": 5, "motion": {"kind": "gesture", "heading_deg": 70}}],
}

SETTINGS = (*PLAIN, "volume.depth_noise_per_m=0.0003")  # of a time-of-flight camera


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Path:
    pytest.importorskip("embreex", reason="rendering needs the extra synth (embreex)")
    from mocap.synth import synthesise
    from mocap.synth.scene import scene_from_dict

    return synthesise(scene_from_dict(SCENE), tmp_path_factory.mktemp("depth") / "session", workers=1)


def without_depth(session: Path, to: Path) -> Path:
    shutil.copytree(session, to)
    shutil.rmtree(to / "depth")
    return to


def carved(session: Path, out: Path) -> StageStore:
    run_session(session, out, config=load_config("default", SETTINGS), until="carve")
    return StageStore(out / "store.zarr")


def test_depth_takes_free_space_out_and_says_where_the_surface_is(session: Path, tmp_path: Path) -> None:
    plain = carved(without_depth(session, tmp_path / "plain"), tmp_path / "a").reader("carve")
    deep = carved(session, tmp_path / "b").reader("carve")
    camera = open_session(session).rig["cam_1"]
    for frame in (0, 3):
        before, after = plain.read(frame), deep.read(frame)
        assert measured_from_arrays(before) is None
        assert set(after["voxels"]) < set(before["voxels"])
        assert len(after["voxels"]) < 0.99 * len(before["voxels"])
        measured = measured_from_arrays(after)
        assert measured is not None
        found = np.isfinite(measured[:, 0])
        assert found.sum() > 100
        assert after["is_surface"][found].all()
        # They are places of the map's readings: within its noise (7 mm at 3.5 m) and a voxel's slope.
        depth_m = (
            cv2.imread(str(session / "depth" / "cam_1" / f"{frame:06d}.png"), cv2.IMREAD_UNCHANGED) / 1000
        )
        uv, z = camera.project(measured[found].astype(np.float64))
        u, v = np.rint(uv).astype(int).T
        read = depth_m[v, u]
        assert np.median(np.abs(read - z)[read > 0]) < 0.02


def test_poses_are_found_with_depth(session: Path, tmp_path: Path) -> None:
    (person,) = run_session(session, tmp_path / "out", config=load_config("default", SETTINGS)).poses
    assert len(person.frames) == 4


def test_maps_and_their_unit_are_in_the_keys(session: Path, tmp_path: Path) -> None:
    copy = tmp_path / "copy"
    shutil.copytree(session, copy)
    config = load_config("default", SETTINGS)
    before = stage_keys(open_session(copy), config, 0)
    text = (copy / "session.toml").read_text()
    (copy / "session.toml").write_text(text + "\n[depth]\nunit_mm = 1.01\n")
    other_unit = stage_keys(open_session(copy), config, 0)
    assert other_unit["segment"] == before["segment"]
    assert other_unit["carve"] != before["carve"]
    (copy / "session.toml").write_text(text)
    shutil.copy(copy / "depth" / "cam_1" / "000000.png", copy / "depth" / "cam_1" / "000002.png")
    assert stage_keys(open_session(copy), config, 0)["carve"] != before["carve"]


def test_furniture_that_is_measured_stands_in_the_way(tmp_path: Path) -> None:
    pytest.importorskip("embreex", reason="rendering needs the extra synth (embreex)")
    from mocap.synth import synthesise
    from mocap.synth.scene import scene_from_dict

    box = {"lower_m": [-0.3, -0.3, 0.0], "upper_m": [0.3, 0.3, 0.8]}
    person = {"seed": 5, "motion": {"kind": "walk", "radii_m": [1.0, 0.9]}}
    scene = {**SCENE, "n_frames": 8, "rig": {"n_cameras": 4, "size_px": [320, 240]}, "persons": [person]}
    scene["room"] = {"capture_m": [[-1.4, -1.3, 0.0], [1.4, 1.3, 2.1]], "furniture": [box]}
    session = synthesise(scene_from_dict(scene), tmp_path / "session", workers=1)
    rig = open_session(session).rig
    found = stored_occluders(carved(session, tmp_path / "a"), rig)
    assert set(found.shares) == set(rig.names)
    camera = rig["cam_1"]
    inside = np.random.default_rng(0).uniform(box["lower_m"], box["upper_m"], (500, 3))
    towards = inside - camera.center
    towards /= np.linalg.norm(towards, axis=1, keepdims=True)
    # In eight frames people leave a part of the box free to be measured.
    assert found.hides(camera, inside + towards).mean() > 0.25
    assert not found.hides(camera, inside - 1.2 * towards).any()
    ignored = load_config("default", (*SETTINGS, "volume.occluders=ignore"))
    run_session(session, tmp_path / "b", config=ignored, until="occluders")
    assert stored_occluders(StageStore(tmp_path / "b" / "store.zarr"), rig).is_empty


@pytest.mark.parametrize("is_mirrored", [False, True])
def test_mirrored_maps_are_found_beside_the_silhouettes(is_mirrored: bool, tmp_path: Path) -> None:
    """Masks of the second camera of three, whose maps show who marches on the floor, before a wall 6 m away."""
    world = keypoint_world(30, n_cameras=3)
    camera = world.rig.cameras[1]
    write_calibration(tmp_path / "calibration.toml", world.rig)
    (tmp_path / "session.toml").write_text("fps = 25.0\n\n[depth]\nunit_mm = 1.0\n")
    for own in world.rig:
        (tmp_path / "masks" / own.name).mkdir(parents=True)
    (tmp_path / "depth" / camera.name).mkdir(parents=True)
    # Beside the middle of the picture, where a mirrored person would be the same.
    aside = 0.9 * camera.R[0]
    w, h = camera.size
    rays = camera.rays(np.stack(np.meshgrid(np.arange(w), np.arange(h)), axis=-1).astype(np.float64))
    with np.errstate(divide="ignore"):
        floor_m = np.where(rays[..., 2] < 0, -camera.center[2] / rays[..., 2], np.inf) * (rays @ camera.R[2])
    room = 1000 * np.minimum(floor_m, 6.0)
    for frame, points in enumerate(marker_positions(world.body, world.markers, world.states[0])):
        flesh = flesh_along(points + aside)[0]
        for own in world.rig:
            mask = silhouette(own, flesh, 0.12)
            cv2.imwrite(str(tmp_path / "masks" / own.name / f"{frame:06d}.png"), 255 * mask.astype(np.uint8))
            if own is camera:
                z = float(np.median(own.project(flesh)[1]))
                depth = np.where(mask, 1000 * z, room).astype(np.uint16)
                name = f"{frame:06d}.png"
                cv2.imwrite(
                    str(tmp_path / "depth" / own.name / name), depth[:, ::-1] if is_mirrored else depth
                )
    said = [f for f in check_people(open_session(tmp_path)) if "depth maps" in f.message]
    assert [(f.severity, f.camera) for f in said] == [("error", camera.name)] * is_mirrored
    assert all("mirrored, left for right" in f.message for f in said)
