"""Faults of cameras and light: what each picture shows, and that the truth says it."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

pytest.importorskip("embreex", reason="rendering needs the extra synth (embreex)")

from mocap.data import Camera
from mocap.errors import MocapError
from mocap.io.session import open_session
from mocap.io.video import clip_info
from mocap.synth import preview_sheet, synthesise
from mocap.synth.faults import Timeline, moved_cameras, timeline
from mocap.synth.recorder import shutter
from mocap.synth.render import GAMMA, CameraView
from mocap.synth.scene import Scene, scene_from_dict
from mocap.synth.world import World, build_world

W, H, C, T, FPS = 96, 72, 8, 9, 30.0
FAULTS: list[dict[str, Any]] = [
    {"kind": "moved", "camera": "cam_1", "frame": 5, "rotate_deg": [1.0, 3.0, 2.0], "shift_m": [0.1, 0, 0]},
    {"kind": "lag", "camera": "cam_2", "frame": 3, "lag_frames": 2},
    {"kind": "frozen", "camera": "cam_3", "frame": 4, "n_frames": 3},
    {"kind": "dropped", "camera": "cam_4", "frame": 2, "n_frames": 3},
    {"kind": "off", "camera": "cam_5", "frame": 6},
    {"kind": "rate", "camera": "cam_6", "fps": 20.0},
    {"kind": "exposure", "camera": "cam_7", "frame": 3, "amplitude": 0.5, "period_s": 0.2},
]
EMPTY = np.zeros((H, W), bool)


def _scene(**more: object) -> Scene:
    document: dict[str, object] = {
        "name": "faulty",
        "seed": 31,
        "n_frames": T,
        "fps": FPS,
        "n_background_frames": 2,
        "rig": {"n_cameras": C, "size_px": [W, H]},
        "picture": {"container": "png", "noise_levels": 1.0},
        "persons": [{"seed": 5, "motion": {"kind": "walk", "radii_m": [0.8, 0.7], "speed_m_s": 1.6}}],
        "faults": FAULTS,
    }
    return scene_from_dict({**document, **more})


def _timeline(n_frames: int, *faults: dict[str, Any], camera: str = "cam_0") -> Timeline:
    named = [f if f["kind"] == "light" else {"camera": "cam_0", **f} for f in faults]
    scene = _scene(n_frames=n_frames, faults=named)
    return timeline(camera, scene.faults, n_frames, FPS)


@pytest.fixture(scope="module")
def world() -> World:
    return build_world(_scene())


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return synthesise(_scene(), tmp_path_factory.mktemp("faults") / "faulty", workers=1)


def _masks(session: Path, camera: str) -> np.ndarray:
    return np.unpackbits(np.load(session / "truth" / "masks" / f"{camera}.npz")["masks"], axis=2).astype(bool)


def _picture(session: Path, camera: str, frame: int) -> np.ndarray:
    return cv2.imread(str(session / "images" / camera / f"{frame:06d}.png"))


def _sees(world: World, camera: Camera, instant: float) -> np.ndarray:
    return CameraView(camera, world.room).silhouette(world.at(instant, with_light=False))


# --- clocks -------------------------------------------------------------------------------------------------


def test_without_faults_all_clocks_are_equal() -> None:
    time = timeline("cam_0", (), 5, FPS)
    assert np.array_equal(time.shot, np.arange(5))
    assert np.array_equal(time.instant, np.arange(5.0))
    assert not time.pose.any()
    assert not time.state.any()
    assert not time.is_off.any()
    assert (time.gain == 1).all()
    assert time.fps == FPS


def test_dropped_frames_are_missing_in_the_file() -> None:
    time = _timeline(8, {"kind": "dropped", "frame": 3, "n_frames": 2})
    assert time.instant.tolist() == [0, 1, 2, 5, 6, 7]
    refilled = _timeline(8, {"kind": "dropped", "frame": 3, "n_frames": 2, "refill": True})
    assert refilled.instant.tolist() == [0, 1, 2, 5, 6, 7, 8, 9]
    assert len(_timeline(8, {"kind": "dropped", "frame": 3, "n_frames": 2}, camera="cam_1")) == 8


def test_frozen_camera_repeats_the_picture_before() -> None:
    assert _timeline(7, {"kind": "frozen", "frame": 4}).shot.tolist() == [0, 1, 2, 3, 3, 3, 3]
    assert _timeline(7, {"kind": "frozen", "frame": 4, "n_frames": 2}).shot.tolist() == [0, 1, 2, 3, 3, 3, 6]


def test_lag_offset_drift_and_rate_shift_the_instant() -> None:
    assert _timeline(5, {"kind": "lag", "lag_frames": 1.5}).instant.tolist() == [-1.5, -0.5, 0.5, 1.5, 2.5]
    late = _timeline(5, {"kind": "lag", "frame": 3, "lag_frames": 2})
    assert late.instant.tolist() == [0, 1, 2, 1, 2]
    offset = _timeline(4, {"kind": "offset", "offset_s": 0.01, "drift_ms_per_s": 30.0})
    assert np.allclose(offset.instant, np.arange(4) + 0.3 + 0.03 * np.arange(4))
    slow = _timeline(10, {"kind": "rate", "fps": 20.0})
    assert slow.instant.tolist() == [0, 1.5, 3, 4.5, 6, 7.5, 9]  # none beyond the session's last frame
    assert slow.fps == 20.0
    assert len(_timeline(10, {"kind": "rate", "fps": 20.0, "refill": True})) == 10


def test_a_room_changes_as_often_as_it_likes() -> None:
    n = 70
    changes = [{"kind": "light", "frame": k, "n_frames": 1, "gain": 0.5, "lamp": 0} for k in range(n)]
    assert _timeline(n, *changes).state.tolist() == [1 << k for k in range(n)]


def test_light_acts_at_the_instant_that_a_picture_shows() -> None:
    time = _timeline(
        8, {"kind": "light", "frame": 3, "n_frames": 3, "gain": 0.5}, {"kind": "lag", "lag_frames": 2}
    )
    assert time.gain.tolist() == [1, 1, 1, 1, 1, 0.5, 0.5, 0.5]


def test_exposure_swings_by_its_amplitude() -> None:
    time = _timeline(90, {"kind": "exposure", "frame": 30, "amplitude": 0.3, "period_s": 1.0})
    assert (time.gain[:30] == 1).all()
    assert abs(time.gain.max() - 1.3) < 0.01
    assert abs(time.gain.min() - 0.7) < 0.01


def test_moves_add_up() -> None:
    K = np.array([[100.0, 0, 50], [0, 100, 40], [0, 0, 1]])
    camera = Camera("cam_0", (100, 80), K, np.zeros(4), np.eye(3), np.array([0.0, 0, 2]))
    scene = _scene(
        faults=[
            {"kind": "moved", "camera": "cam_0", "frame": 6, "shift_m": [0.5, 0.0, 0.0]},
            {"kind": "moved", "camera": "cam_0", "frame": 2, "rotate_deg": [0.0, 10.0, 0.0]},
        ]
    )
    first, panned, shifted = moved_cameras(camera, scene.faults)
    assert first is camera
    axis = panned.R[2]  # the optical axis has turned to the right, about the camera's own down axis
    assert np.allclose(axis, [np.sin(np.deg2rad(10)), 0, np.cos(np.deg2rad(10))])
    assert np.allclose(panned.center, camera.center)
    assert np.allclose(shifted.center, camera.center + np.array([0.5, 0, 0]))
    assert np.allclose(shifted.R, panned.R)


def test_shutter_shares() -> None:
    offsets, shares = shutter(0.0, 0.0, 7, 5)
    assert offsets.tolist() == [0.0]
    assert (shares == 1).all()
    offsets, shares = shutter(0.6, 0.0, 3, 5)
    assert np.allclose(offsets, [-0.2, 0, 0.2])
    assert np.allclose(shares, 1 / 3)
    offsets, shares = shutter(0.3, 0.9, 21, 11)
    assert np.allclose(shares.sum(axis=0), 1, atol=1e-6)
    assert np.allclose(offsets @ shares, 0.9 * (np.arange(11) / 10 - 0.5), atol=0.9 / 21)


# --- scene files --------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("fault", "expected"),
    [
        ({"kind": "lag", "camera": "cam_9", "lag_frames": 1}, "faults.1.camera: there is no camera 'cam_9'"),
        ({"kind": "frozen", "camera": "cam_1", "frame": 99}, "faults.1.frame: 99 is not within"),
        ({"kind": "frozen", "camera": "cam_1", "frame": 0}, "faults.1.frame: Input should be greater"),
        ({"kind": "moved", "camera": "cam_1", "frame": 2}, "rotate_deg or shift_m must differ from zero"),
        ({"kind": "lag", "camera": "cam_1", "lag": 3, "lag_frames": 1}, "faults.1.lag: unknown key"),
        ({"kind": "melted", "camera": "cam_1"}, "faults.1"),
        ({"kind": "dropped", "camera": "cam_1", "frame": 1, "n_frames": 9}, "camera cam_1 drops 9 of 9"),
        ({"kind": "light", "frame": 1, "gain": -1}, "faults.1.gain"),
    ],
)
def test_mistakes_are_named_by_their_path(fault: dict[str, Any], expected: str) -> None:
    with pytest.raises(MocapError) as caught:
        _scene(faults=[FAULTS[0], fault])
    assert expected in str(caught.value)


# --- pictures -----------------------------------------------------------------------------------------------


def test_moved_camera_shows_the_new_pose_and_keeps_the_old_calibration(session: Path, world: World) -> None:
    before, after = world.cameras["cam_1"]
    calibrated = open_session(session, frames=(0, 5)).rig["cam_1"]
    assert np.allclose(calibrated.R, before.R)
    masks = _masks(session, "cam_1")
    assert np.array_equal(masks[4], _sees(world, before, 4))
    assert np.array_equal(masks[5], _sees(world, after, 5))
    assert not np.array_equal(masks[5], _sees(world, before, 5))
    (fault,) = [
        f for f in json.loads((session / "truth/truth.json").read_text())["faults"] if f["kind"] == "moved"
    ]
    assert fault["frame"] == 5
    assert np.allclose(fault["before"]["R"], before.R)
    assert np.allclose(fault["after"]["center_m"], after.center)


def test_lagging_camera_shows_the_past(session: Path, world: World) -> None:
    masks = _masks(session, "cam_2")
    for frame, shown in ((2, 2), (3, 1), (8, 6)):
        assert np.array_equal(masks[frame], _sees(world, world.rig["cam_2"], shown))
    assert not np.array_equal(masks[8], _sees(world, world.rig["cam_2"], 8))


def test_frozen_pictures_are_equal_to_the_last_bit(session: Path) -> None:
    pictures = [_picture(session, "cam_3", f) for f in range(T)]
    masks = _masks(session, "cam_3")
    for frame in (4, 5, 6):
        assert np.array_equal(pictures[frame], pictures[3])
        assert np.array_equal(masks[frame], masks[3])
    assert not np.array_equal(pictures[7], pictures[3])  # it goes on: another noise, another pose
    assert not np.array_equal(pictures[3], pictures[2])


def test_dropped_frames_make_the_file_shorter(session: Path, world: World) -> None:
    masks = _masks(session, "cam_4")
    assert len(masks) == clip_info(session / "images" / "cam_4").n_frames == T - 3
    assert np.array_equal(masks[1], _sees(world, world.rig["cam_4"], 1))
    assert np.array_equal(masks[2], _sees(world, world.rig["cam_4"], 5))
    with pytest.raises(MocapError, match="different numbers of frames"):
        open_session(session)


def test_camera_off_is_black(session: Path) -> None:
    assert _picture(session, "cam_5", 5).mean() > 20
    assert not _picture(session, "cam_5", 6).any()
    assert np.array_equal(_masks(session, "cam_5")[8], EMPTY)


def test_other_rate_shows_instants_between_the_frames(session: Path, world: World) -> None:
    masks = _masks(session, "cam_6")
    assert len(masks) == 6
    between = masks[1]  # half-way from frame 1 to frame 2
    assert np.array_equal(between, _sees(world, world.rig["cam_6"], 1.5))
    assert not np.array_equal(between, _sees(world, world.rig["cam_6"], 1))
    assert not np.array_equal(between, _sees(world, world.rig["cam_6"], 2))


def test_between_two_frames_the_body_is_between(world: World) -> None:
    actor = world.actors[0]
    a, b = actor.landmarks_at(3), actor.landmarks_at(4)
    assert np.allclose(actor.landmarks_at(3.5), (a + b) / 2, atol=0.004)  # arcs, not chords
    assert np.allclose(a, actor.landmarks[3])


def test_exposure_scales_the_picture(session: Path, world: World) -> None:
    gain = world.timelines["cam_7"].gain
    far = ~cv2.dilate(_masks(session, "cam_7")[[0, 4]].any(axis=0).astype(np.uint8), np.ones((9, 9))) > 0
    ratio = _picture(session, "cam_7", 4)[far].mean() / _picture(session, "cam_7", 0)[far].mean()
    assert abs(ratio / gain[4] ** GAMMA - 1) < 0.03  # the light drifts by a percent
    assert gain[4] > 1.2


def test_truth_lists_every_picture(session: Path) -> None:
    with (session / "truth" / "pictures.csv").open() as file:
        rows = list(csv.DictReader(file))
    n = {f"cam_{i}": T for i in range(C)} | {"cam_4": T - 3, "cam_6": 6}
    assert len(rows) == sum(n.values())
    lag = [float(r["shows_frame"]) for r in rows if r["camera"] == "cam_2"]
    assert lag == [0, 1, 2, 1, 2, 3, 4, 5, 6]
    assert [int(r["n_moves"]) for r in rows if r["camera"] == "cam_1"] == [0] * 5 + [1] * 4
    assert [int(r["is_off"]) for r in rows if r["camera"] == "cam_5"] == [0] * 6 + [1] * 3


def test_preview_copes_with_files_of_different_length(session: Path, tmp_path: Path) -> None:
    sheet = cv2.imread(str(preview_sheet(session, tmp_path / "sheet.png", n_moments=3, width_px=48)))
    assert sheet.shape == (18 + C * 36, 4 * 48, 3)


# --- light and obstacles ------------------------------------------------------------------------------------


def test_light_switch_and_lamp(tmp_path: Path) -> None:
    faults = [
        {"kind": "light", "frame": 1, "n_frames": 1, "gain": 0.25},
        {"kind": "light", "frame": 2, "gain": 0.0, "lamp": 1},
    ]
    scene = _scene(
        n_frames=3,
        rig={"n_cameras": 2, "size_px": [W, H]},
        persons=[],
        picture={"container": "png", "noise_levels": 0.0, "light_drift": 0.0},
        faults=faults,
    )
    folder = synthesise(scene, tmp_path / "light", workers=1)
    usual, dim, lamp = (_picture(folder, "cam_0", f).astype(float) for f in range(3))
    bright = usual > 60
    assert abs((dim[bright] / usual[bright]).mean() - 0.25**GAMMA) < 0.01
    share = lamp[bright] / usual[bright]
    assert share.mean() < 0.95
    assert share.std() > 0.02  # not one factor: the lamp's own shading is gone


def test_obstacle_appears_and_hides() -> None:
    box = {"kind": "obstacle", "frame": 2, "lower_m": [-1.2, -1.2, 0.0], "upper_m": [1.2, 1.2, 0.5]}
    world = build_world(_scene(faults=[box]))
    assert world.timelines["cam_0"].state.tolist() == [0, 0] + [1] * (T - 2)
    with_box = CameraView(world.rig[0], world.room_in(1))
    moment = world.at(2, with_light=False)
    assert with_box.silhouette(moment).sum() < CameraView(world.rig[0], world.room).silhouette(moment).sum()
    assert len(world.room.furniture) == 0


def test_instant_and_open_shutter_agree_where_nothing_moves() -> None:
    from mocap.synth.recorder import Moments, Recorder

    def picture(**picture: object) -> np.ndarray:
        scene = _scene(persons=[], faults=[], picture={"noise_levels": 0.0, **picture})
        world = build_world(scene)
        recorder = Recorder(world, "cam_0", Path("unused"))
        return recorder.take(0, Moments(world, with_light=True))[0]

    still = picture()
    assert np.abs(picture(exposure_ms=20.0, readout_ms=10.0).astype(int) - still).max() <= 1


def test_compression_costs_detail(tmp_path: Path) -> None:
    def picture(quality: int | None) -> np.ndarray:
        scene = _scene(
            n_frames=1,
            faults=[],
            rig={"n_cameras": 2, "size_px": [W, H]},
            picture={"container": "png", "noise_levels": 0.0, "jpeg_quality": quality},
        )
        folder = synthesise(scene, tmp_path / f"q{quality}", workers=1)
        return _picture(folder, "cam_0", 0).astype(float)

    clean = picture(None)
    assert np.abs(picture(90) - clean).mean() < np.abs(picture(10) - clean).mean()


@pytest.mark.parametrize("lens", ["strong", "fisheye"])
def test_lenses_bend_the_picture_and_are_calibrated(lens: str, tmp_path: Path) -> None:
    scene = _scene(
        n_frames=2,
        faults=[],
        masks_only=True,
        rig={"n_cameras": 2, "size_px": [W, H], "lens": lens, "focal_px": 400},
    )
    rig = open_session(synthesise(scene, tmp_path / lens, workers=1)).rig
    world = build_world(scene)
    corner = np.array([[0.0, 0.0]])
    for read, made in zip(rig, world.rig, strict=True):
        assert read.is_fisheye == (lens == "fisheye")
        ray = made.rays(corner)
        assert np.allclose(read.project(read.center + ray)[0], corner, atol=0.01)
        straight = Camera("x", made.size, made.K, np.zeros(4), made.R, made.t)
        assert np.degrees(np.arccos((ray * straight.rays(corner)).sum())) > 1.0
