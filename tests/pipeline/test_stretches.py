"""Recordings in which a camera was pushed: a run of every stretch by its own calibration, joined to one."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from small_session import PLAIN, mocap

from eval.bench.scene import person_mask, ring
from mocap.data import Camera, CameraRig
from mocap.errors import MocapError
from mocap.io.calibration import write_calibration
from mocap.io.session import open_session
from mocap.pipeline.config import load_config
from mocap.pipeline.record import RunResult
from mocap.pipeline.stretches import pieces_of, run_recording
from mocap.products.hulls import stored_grid

SIZE, FPS, N, PUSHED = (160, 120), 30.0, 24, 12
RIG = ring(5, SIZE)
CONFIG = load_config("default", (*PLAIN, "volume.voxel_size_m=0.06", "body.height_m=1.75"))
TABLE = f'[calibration_from]\n{PUSHED} = "later.toml"\n'


def pushed_camera() -> Camera:
    """The third camera, pushed so far that its silhouettes miss the room's middle by half a metre."""
    R = Rotation.from_rotvec(np.radians([0.0, 9.0, 0.0])).as_matrix() @ RIG[2].R
    return replace(RIG[2], R=R, t=-R @ RIG[2].center)


def write_session(root: Path, toml: str = TABLE) -> Path:
    for camera in RIG:
        (root / "masks" / camera.name).mkdir(parents=True)
        for k in range(N):
            own = pushed_camera() if camera.name == RIG[2].name and k >= PUSHED else camera
            mask = person_mask(own, np.array([0.03 * k - 0.3, 0.0]), 0.0)
            cv2.imwrite(str(root / "masks" / camera.name / f"{k:04d}.png"), mask.astype(np.uint8) * 255)
    write_calibration(root / "calibration.toml", RIG)
    later = [pushed_camera() if camera.name == RIG[2].name else camera for camera in RIG]
    write_calibration(
        root / "later.toml", replace(RIG, cameras=tuple(later)), metadata={"note": "it was pushed"}
    )
    bounds = "room_bounds_m = [[-1.2, -1.2, 0.0], [1.2, 1.2, 2.1]]\n"
    (root / "session.toml").write_text(f"fps = {FPS}\n{bounds}{toml}", encoding="utf-8")
    return root


@pytest.fixture(scope="module")
def joined(tmp_path_factory: pytest.TempPathFactory) -> RunResult:
    base = tmp_path_factory.mktemp("stretches")
    return run_recording(write_session(base / "session"), base / "out", config=CONFIG, seed=3)


def test_every_stretch_is_run_by_its_own_calibration_and_joined(joined: RunResult) -> None:
    assert joined.record.is_joined
    assert joined.status == "complete"
    assert joined.record.frames == range(N)
    assert {path.name for path in (joined.out / "pieces").iterdir()} == {"0-18", "12-24"}
    assert any(
        f"from frame {PUSHED} on the cameras stand as in later.toml: it was pushed" in w
        for w in joined.warnings
    )
    (person,) = joined.poses
    assert person.frames.tolist() == list(range(N))
    # By the calibration of before that camera's silhouette would cut the volume away, or be left out.
    hulls = joined.found.store.reader("carve")
    sizes = np.array([len(arrays["voxels"]) for _, arrays in hulls])
    used = np.array([arrays["used"] for _, arrays in hulls])
    seam = joined.record.numbers["join"]["seams"][0]["frame"]
    # The earlier run knows too that the camera stands elsewhere from the frame of the table on.
    assert not used[PUSHED:seam, 2].any()
    assert used[seam:].all()
    assert PUSHED < seam < 18
    assert sizes[seam:].min() > 0.7 * np.median(sizes[:PUSHED])
    assert stored_grid(joined.found.store).shape == (40, 40, 35)


def test_the_run_of_a_piece_is_that_of_its_frames(joined: RunResult, tmp_path: Path) -> None:
    root = joined.session.root
    alone = run_recording(root, tmp_path / "out", config=CONFIG, seed=3, frames=(PUSHED, N), until="carve")
    piece = joined.out / "pieces" / f"{PUSHED}-{N}" / "store.zarr"
    assert alone.session.calibration_path == root / "later.toml"
    assert not (tmp_path / "out" / "pieces").exists()
    kept = type(alone.found.store)(piece)
    for (_, a), (_, b) in zip(alone.found.store.reader("carve"), kept.reader("carve"), strict=True):
        np.testing.assert_array_equal(a["voxels"], b["voxels"])


def test_one_stage_or_a_run_without_volumes_takes_one_stretch(joined: RunResult, tmp_path: Path) -> None:
    root = joined.session.root
    with pytest.raises(MocapError, match="a single stage works with one") as caught:
        run_recording(root, tmp_path / "out", config=CONFIG, until="carve")
    assert "--frames 0:12 or --frames 12:24" in caught.value.remedy
    done = mocap("segment", root, "-o", tmp_path / "out")
    assert done.code == 2
    assert "another calibration holds from frame 12 on" in done.err


def test_pieces_share_what_two_runs_need_and_no_more_than_there_is(joined: RunResult) -> None:
    session = joined.session
    assert pieces_of(session) == [range(18), range(12, 24)]
    later = session.later_calibrations[PUSHED]
    long = replace(session, frames=range(10, 400), later_calibrations={100: later, 300: later})
    assert pieces_of(long) == [range(10, 160), range(100, 350), range(300, 400)]
    assert pieces_of(replace(session, later_calibrations={})) == [range(N)]


def test_cameras_stand_in_a_frame_as_its_calibration_says(joined: RunResult) -> None:
    session, name = joined.session, RIG[2].name
    assert session.rig_at(PUSHED - 1) is session.rig
    np.testing.assert_allclose(session.rig_at(PUSHED)[name].R, pushed_camera().R)
    assert session.is_pushed(PUSHED - 1).tolist() == [False] * 5
    assert session.is_pushed(PUSHED).tolist() == [False, False, True, False, False]
    small = replace(session, rig=CameraRig(tuple(camera.reduced(2) for camera in session.rig)))
    assert [c.size for c in small.rig_at(PUSHED)] == [c.size for c in small.rig]
    np.testing.assert_allclose(small.rig_at(PUSHED)[name].K, pushed_camera().reduced(2).K)


def test_the_empty_clip_of_before_is_not_of_a_camera_that_was_pushed(tmp_path: Path) -> None:
    root = write_session(tmp_path / "session")
    for camera in RIG:
        (root / "background").mkdir(exist_ok=True)
        picture = np.zeros((SIZE[1], SIZE[0], 3), dtype=np.uint8)
        cv2.imwrite(str(root / "background" / f"{camera.name}.png"), picture)
    assert set(open_session(root).background_sources) == set(RIG.names)
    late = open_session(root, frames=(PUSHED, None))
    assert set(late.background_sources) == set(RIG.names) - {RIG[2].name}


def test_a_calibration_that_is_named_holds_for_all_frames(joined: RunResult) -> None:
    root = joined.session.root
    session = open_session(root, calibration=root / "later.toml")
    assert session.stretches == (range(N),)
    assert session.calibration_path == root / "later.toml"


@pytest.mark.parametrize(
    ("toml", "words"),
    [
        ("[calibration_from]\n12 = 'none.toml'\n", "no such calibration file"),
        ("[calibration_from]\n0 = 'later.toml'\n", "calibration_from.0"),
        ("[calibration_from]\nsoon = 'later.toml'\n", "calibration_from.soon"),
        ("[calibration_from]\n12 = 7\n", "calibration_from.12"),
        ("calibration_from = 'later.toml'\n", "calibration_from is no table"),
        ("[calibration_from]\n12 = 'few.toml'\n", f"calibration_from.12 lacks camera {RIG[4].name}"),
    ],
)
def test_tables_that_make_no_sense_are_named(toml: str, words: str, tmp_path: Path) -> None:
    root = write_session(tmp_path / "session", toml)
    write_calibration(root / "few.toml", RIG.subset(RIG.names[:4]))
    with pytest.raises(MocapError) as caught:
        open_session(root)
    assert words in str(caught.value)
