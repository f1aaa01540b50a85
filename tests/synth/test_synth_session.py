"""A whole small session: the pictures, the truth, and that they agree."""

from __future__ import annotations

import hashlib
import json
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.ndimage import distance_transform_edt

pytest.importorskip("embreex", reason="rendering needs the extra synth (embreex)")

from mocap.data import LANDMARKS, VoxelGrid
from mocap.errors import MocapError
from mocap.io.session import open_session
from mocap.io.tables import read_landmarks_csv, read_tracks_csv
from mocap.io.video import iter_clip
from mocap.synth import preview_sheet, scene_sheet, synthesise
from mocap.synth.render import CameraView, make_sensor
from mocap.synth.scene import Scene, scene_from_dict
from mocap.synth.world import World, build_world

W, H, C, T = 160, 120, 3, 5


def _scene(**more: object) -> Scene:
    document: dict[str, object] = {
        "name": "small",
        "seed": 21,
        "n_frames": T,
        "n_background_frames": 4,
        "rig": {"n_cameras": C, "size_px": [W, H]},
        "persons": [{"seed": 5, "motion": {"kind": "walk", "radii_m": [0.8, 0.7], "start_deg": 70}}],
    }
    return scene_from_dict({**document, **more})


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return synthesise(_scene(), tmp_path_factory.mktemp("synth") / "small", workers=1)


@pytest.fixture(scope="module")
def world() -> World:
    return build_world(_scene())


def _masks(session: Path, camera: str) -> np.ndarray:
    return np.unpackbits(np.load(session / "truth" / "masks" / f"{camera}.npz")["masks"], axis=2).astype(bool)


def _digest(folder: Path) -> dict[str, str]:
    files = sorted(p for p in folder.rglob("*") if p.is_file())
    return {str(p.relative_to(folder)): hashlib.sha256(p.read_bytes()).hexdigest() for p in files}


def _dilate(mask: np.ndarray, radius: int) -> np.ndarray:
    kernel = np.ones((2 * radius + 1, 2 * radius + 1), np.uint8)
    return cv2.dilate(mask.astype(np.uint8), kernel).astype(bool)


def test_session_opens_as_any_other(session: Path) -> None:
    found = open_session(session)
    assert len(found.rig) == C
    assert found.rig[0].size == (W, H)
    assert len(found.frames) == T
    assert found.person_height_m is None
    assert set(found.background_sources) == set(found.rig.names)
    assert found.room_bounds_m is not None


def test_calibration_is_the_rig_that_was_rendered(session: Path, world: World) -> None:
    read = open_session(session).rig
    for camera in world.rig:
        assert np.allclose(read[camera.name].K, camera.K)
        assert np.allclose(read[camera.name].R, camera.R)
        assert np.allclose(read[camera.name].dist, camera.dist)


def test_landmarks_project_into_the_silhouettes(session: Path) -> None:
    rig = open_session(session).rig
    (motion,) = read_landmarks_csv(session / "truth" / "landmarks.csv")
    assert motion.landmarks.shape == (T, len(LANDMARKS), 3)
    for camera in rig:
        masks = _masks(session, camera.name)
        for frame in range(T):
            uv, _ = camera.project(motion.landmarks[frame])
            uv = uv[camera.contains(uv)]
            column, row = np.rint(uv).astype(int).T
            assert _dilate(masks[frame], 1)[row, column].all()


def test_silhouettes_equal_the_projected_mesh_within_a_pixel(world: World) -> None:
    for camera in world.rig:
        mask = CameraView(camera, world.room).silhouette(world.at(2, with_light=False))
        vertices, _ = world.actors[0].posed(2)
        uv, _ = camera.project(vertices)
        drawn = np.zeros((H, W), np.uint8)
        for triangle in uv[world.bodies[0].faces]:
            cv2.fillConvexPoly(drawn, np.rint(triangle * 16).astype(np.int32), 1, cv2.LINE_8, 4)
        assert not (mask & ~_dilate(drawn > 0, 1)).any()
        # What is thinner than a pixel may fall between the rays.
        assert np.count_nonzero((drawn > 0) & ~_dilate(mask, 1)) <= 2
        assert mask.sum() > 100


def test_solid_lies_inside_the_hull_of_the_silhouettes(session: Path) -> None:
    rig = open_session(session).rig
    data = np.load(session / "truth" / "voxels.npz")
    grid = VoxelGrid(data["origin_m"], tuple(data["shape"]), float(data["voxel_size_m"]))
    truth = json.loads((session / "truth" / "truth.json").read_text())
    for frame in range(T):
        voxels = data["voxels"][data["offsets"][frame] : data["offsets"][frame + 1]]
        volume = len(voxels) * grid.voxel_size_m**3
        assert abs(volume / truth["persons"][0]["volume_m3"] - 1) < 0.03
        for camera in rig:
            uv, _ = camera.project(grid.centers(voxels))
            uv = uv[camera.contains(uv)]
            column, row = np.rint(uv).astype(int).T
            assert _dilate(_masks(session, camera.name)[frame], 1)[row, column].all()


def test_track_is_the_centroid_of_the_solid(session: Path) -> None:
    tracks = read_tracks_csv(session / "truth" / "tracks.csv")
    data = np.load(session / "truth" / "voxels.npz")
    grid = VoxelGrid(data["origin_m"], tuple(data["shape"]), float(data["voxel_size_m"]))
    for frame in range(T):
        voxels = data["voxels"][data["offsets"][frame] : data["offsets"][frame + 1]]
        assert np.linalg.norm(grid.centers(voxels).mean(axis=0) - tracks.xyz[frame]) < 0.008


def test_pictures_show_the_person_and_keep_the_room(session: Path) -> None:
    for camera in open_session(session).rig:
        empty = np.mean(list(iter_clip(session / "background" / f"{camera.name}.mp4")), axis=0)
        masks = _masks(session, camera.name)
        for frame, picture in enumerate(iter_clip(session / "videos" / f"{camera.name}.mp4")):
            change = np.abs(picture.astype(float) - empty).mean(axis=2)
            far = ~_dilate(masks[frame], 30)
            assert np.median(change[masks[frame]]) > 3 * np.median(change[far])
            assert np.median(change[far]) < 6


def test_floor_is_darker_beside_the_feet(world: World) -> None:
    darker = []
    for camera in world.rig:
        view = CameraView(camera, world.room)
        picture, mask = view.render(world.at(1), world.bodies, world.looks)
        outside = ~_dilate(mask, 2)
        change = (picture / np.maximum(view.empty, 1)).mean(axis=2)
        assert change[outside].max() < 1.02  # a body takes light away, it adds none
        darker.append(change[outside].min())
    assert min(darker) < 0.85


def test_noise_is_as_configured(world: World) -> None:
    grey = np.full((H, W, 3), 120, np.float32)
    sensor = make_sensor(
        T, (W, H), noise_levels=3.0, light_drift=0.0, colour_cast=0.0, fps=30.0, rng=np.random.default_rng(0)
    )
    image = sensor.expose(grey, 0, rng=np.random.default_rng(1)).astype(float)
    assert abs(image.mean() - 120) < 0.1
    assert abs(image.std() - np.hypot(3.0, 1 / np.sqrt(12))) < 0.06  # sensor noise and rounding


def test_same_seed_same_bytes_for_any_number_of_workers(session: Path, tmp_path: Path) -> None:
    again = synthesise(_scene(), tmp_path / "again", workers=2)
    assert _digest(again) == _digest(session)
    assert synthesise(_scene(), again, workers=1) == again  # replaces an earlier session
    assert _digest(again) == _digest(session)


def test_other_seed_other_person_and_rig(world: World) -> None:
    other = build_world(_scene(), seed=99)
    assert not np.allclose(other.rig[0].R, world.rig[0].R)
    assert other.bodies[0].figure.stature_m != world.bodies[0].figure.stature_m


def test_masks_only_session_has_the_true_silhouettes(tmp_path: Path) -> None:
    scene = _scene(masks_only=True, n_frames=2)
    folder = synthesise(scene, tmp_path / "m", workers=1)
    found = open_session(folder)
    assert not found.image_sources
    assert set(found.mask_sources) == set(found.rig.names)
    for name in found.rig.names:
        picture = cv2.imread(str(folder / "masks" / name / "000001.png"), cv2.IMREAD_GRAYSCALE)
        assert np.array_equal(picture > 0, _masks(folder, name)[1])


def test_furniture_hides_the_person() -> None:
    table = {"lower_m": [-0.9, -0.9, 0.0], "upper_m": [0.9, 0.9, 0.7]}
    free = build_world(_scene())
    hidden = build_world(_scene(room={"furniture": [table]}))
    for camera in free.rig:
        open_mask = CameraView(camera, free.room).silhouette(free.at(0, with_light=False))
        mask = CameraView(camera, hidden.room).silhouette(hidden.at(0, with_light=False))
        assert not (mask & ~open_mask).any()
        assert mask.sum() < open_mask.sum()


def test_an_empty_room_is_a_session(tmp_path: Path) -> None:
    folder = synthesise(_scene(persons=[], n_frames=2), tmp_path / "e", workers=1)
    assert len(read_tracks_csv(folder / "truth" / "tracks.csv")) == 0
    assert not _masks(folder, "cam_0").any()


def test_a_folder_that_is_no_session_is_left_alone(tmp_path: Path) -> None:
    (tmp_path / "mine.txt").write_text("keep")
    with pytest.raises(MocapError, match="not a synthetic session"):
        synthesise(_scene(), tmp_path, workers=1)
    assert (tmp_path / "mine.txt").read_text() == "keep"


def test_preview_sheet_has_a_row_per_camera(session: Path, tmp_path: Path) -> None:
    path = preview_sheet(session, tmp_path / "sheet.png", n_moments=2, width_px=64)
    picture = cv2.imread(str(path))
    assert picture.shape == (18 + C * 48, 3 * 64, 3)  # a line of frame numbers above


def test_a_scene_sheet_shows_what_the_session_would(session: Path, tmp_path: Path) -> None:
    scene = _scene(picture={"container": "png"})
    path = scene_sheet(scene, tmp_path / "sheet.png", moments=[1, 4], cameras=["cam_1"], width_px=W)
    shown = cv2.imread(str(path))[18:]
    assert shown.shape == (H, 2 * W, 3)
    clip = list(iter_clip(session / "videos" / "cam_1.mp4"))
    below = slice(20, None)  # without the camera's name
    for k, frame in enumerate((1, 4)):
        rendered = shown[below, k * W : (k + 1) * W, ::-1].astype(float)
        assert np.abs(rendered - clip[frame][below]).mean() < 6  # the video is compressed


def test_a_picture_name_without_suffix_is_refused(session: Path, tmp_path: Path) -> None:
    with pytest.raises(MocapError, match="cannot be written"):
        preview_sheet(session, tmp_path / "sheet", n_moments=1, width_px=64)


def test_points_deeper_than_half_a_pixel_diagonal_are_in_every_silhouette(session: Path) -> None:
    """The ray of the nearest pixel passes within half a pixel diagonal of a point: a deeper one is surely hit."""
    rig = open_session(session).rig
    data = np.load(session / "truth" / "voxels.npz")
    grid = VoxelGrid(data["origin_m"], tuple(data["shape"]), float(data["voxel_size_m"]))
    voxels = data["voxels"][data["offsets"][2] : data["offsets"][3]]
    solid = np.zeros(grid.shape, bool)
    solid.ravel()[voxels] = True
    # To the next voxel outside, less the half diagonal of a voxel, is at most the distance to the skin.
    depth = (distance_transform_edt(solid) - np.sqrt(3) / 2).ravel()[voxels] * grid.voxel_size_m
    n_tested = 0
    for camera in rig:
        uv, distance = camera.project(grid.centers(voxels))
        # The lens squeezes the rim of the picture by up to a fifth.
        radius = 1.2 * np.sqrt(0.5) * distance / camera.K[0, 0]
        surely = (depth > radius) & camera.contains(uv)
        column, row = np.rint(uv[surely]).astype(int).T
        assert _masks(session, camera.name)[2][row, column].all()
        n_tested += np.count_nonzero(surely)
    assert n_tested > 1000


def test_missing_embree_names_the_remedy(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "embreex", None)
    with pytest.raises(MocapError, match=r"mocap-volumes\[synth\]"):
        synthesise(_scene(), tmp_path / "s", workers=1)
    assert not (tmp_path / "s").exists()
