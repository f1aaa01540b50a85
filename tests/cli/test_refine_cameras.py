"""`mocap calibrate --refine` and `--place`: cameras put right, or placed, by somebody who walks; what is refused."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from small_session import mocap

from eval.bench.scene import person_mask, ring
from eval.refine_rig import disturbed, pair_angles_deg, place_errors
from mocap.calibrate import Lens
from mocap.calibrate.lens import rig_of_lenses
from mocap.data import Camera, CameraRig
from mocap.io.calibration import read_calibration, write_calibration
from mocap.io.session import open_session
from mocap.volume import choose_grid

SIZE, FPS, N = (320, 240), 30.0, 90
RIG = ring(5, SIZE)
HEIGHT_M = 1.75  # of the drawn person, to some centimetres
PUSHED, STILL = 16, 21  # frames: when a camera is pushed, and from which on it stands still
# A pixel of these small pictures is 0.27 degrees and 1.5 cm; discs of whole pixels are drawn.
ANGLE_DEG, PLACE_M = 0.5, 0.015


def write_session(root: Path, *, walks: bool = True, empty: str = "", pushed: Camera | None = None) -> Path:
    """A person who walks, by a calibration that is off.  pushed : how a camera stands from frame PUSHED on."""
    for camera in RIG:
        (root / "masks" / camera.name).mkdir(parents=True)
        for k in range(N):
            a = 1.6 * k / FPS if walks else 0.0
            own = pushed if pushed is not None and camera.name == pushed.name and k >= PUSHED else camera
            mask = person_mask(own, np.array([0.7 * np.cos(a), 0.5 * np.sin(2 * a)]), a + np.pi / 2)
            if camera.name == empty:
                mask = np.zeros_like(mask)
            cv2.imwrite(str(root / "masks" / camera.name / f"{k:04d}.png"), mask.astype(np.uint8) * 255)
    (root / "session.toml").write_text(f"fps = {FPS}\n", encoding="utf-8")
    write_calibration(root / "calibration.toml", disturbed(RIG, 2.0, 0.03, np.random.default_rng(3)))
    return root


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_session(tmp_path_factory.mktemp("refine") / "session")


def test_a_wrong_calibration_is_put_right_and_told(session: Path, tmp_path: Path) -> None:
    out, picture = tmp_path / "refined.toml", tmp_path / "moves.png"
    before = (session / "calibration.toml").read_bytes()
    done = mocap("calibrate", "--refine", session, "-o", out, "--picture", picture)
    assert done.code == 0, done.err
    assert done.out.count("turned by") == len(RIG)
    assert cv2.imread(str(picture)) is not None
    assert (session / "calibration.toml").read_bytes() == before
    found = read_calibration(out)
    assert pair_angles_deg(found.rig, RIG).max() < ANGLE_DEG
    assert place_errors(found.rig, RIG)[0].max() < PLACE_M
    assert 'source = "mocap calibrate --refine"' in out.read_text(encoding="utf-8")

    again = mocap("calibrate", "--refine", session, "-o", out)
    assert again.code == 2
    assert "not written over" in again.err

    kept = mocap("calibrate", "--refine", session, "-o", tmp_path / "twice.toml", "--calibration", out)
    assert kept.code == 2
    assert "nothing is gained" in kept.err
    assert not (tmp_path / "twice.toml").exists()


def test_a_stated_height_sets_the_scale(session: Path, tmp_path: Path) -> None:
    sizes = []
    for height in (HEIGHT_M, 1.04 * HEIGHT_M):
        out = tmp_path / f"{height}.toml"
        done = mocap("calibrate", "--refine", session, "-o", out, "--height-m", height)
        assert done.code == 0, done.err
        centers = np.array([c.center for c in read_calibration(out).rig])
        sizes.append(np.linalg.norm(centers - centers.mean(axis=0)))
    assert sizes[1] / sizes[0] == pytest.approx(1.04, abs=1e-6)
    done = mocap("calibrate", "--refine", session, "-o", tmp_path / "no.toml", "--height-m", 1.0)
    assert done.code == 2
    assert "stated are 1.00 m" in done.err


def test_a_camera_that_sees_nobody_is_named(tmp_path: Path) -> None:
    root = write_session(tmp_path / "session", empty=RIG.names[3])
    done = mocap("calibrate", "--refine", root, "-o", tmp_path / "refined.toml")
    assert done.code == 2
    assert f"camera {RIG.names[3]}" in done.err
    assert "cameras = [...]" in done.err
    assert not (tmp_path / "refined.toml").exists()


def test_somebody_who_stands_still_is_not_enough(tmp_path: Path) -> None:
    root = write_session(tmp_path / "session", walks=False)
    done = mocap("calibrate", "--refine", root, "-o", tmp_path / "refined.toml")
    assert done.code == 2
    assert "the motion says too little" in done.err


def test_exchanged_cameras_are_no_refinement(session: Path, tmp_path: Path) -> None:
    rig = list(read_calibration(session / "calibration.toml").rig)
    text = (session / "calibration.toml").read_text(encoding="utf-8")
    a, b = f'name = "{rig[0].name}"', f'name = "{rig[2].name}"'
    text = text.replace(a, "name = @").replace(b, a).replace("name = @", b)
    (tmp_path / "exchanged.toml").write_text(text, encoding="utf-8")
    done = mocap(
        *("calibrate", "--refine", session, "-o", tmp_path / "no.toml"),
        *("--calibration", tmp_path / "exchanged.toml"),
    )
    assert done.code == 2
    assert "no places of the cameras explain" in done.err or "shares" in done.err


def pushed_camera() -> Camera:
    """The third camera after somebody has pushed it by 3 degrees and 3 cm."""
    camera = RIG[2]
    R = Rotation.from_rotvec(np.radians([1.0, 2.7, 0.8])).as_matrix() @ camera.R
    return replace(camera, R=R, t=-R @ (camera.center + np.array([0.02, 0.02, -0.01])))


@pytest.fixture(scope="module")
def pushed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = write_session(tmp_path_factory.mktemp("pushed") / "session", pushed=pushed_camera())
    write_calibration(root / "calibration.toml", RIG)
    return root


def test_a_camera_that_was_pushed_is_found_again(pushed: Path) -> None:
    name, out = RIG[2].name, pushed / "from_21.toml"
    order = ("calibrate", "--refine", pushed, "--moved", name, "--from-frame", STILL)
    done = mocap(*order, "-o", out)
    assert done.code == 0, done.err
    assert done.out.count("turned by") == 1
    assert f"from frame {STILL} on" in done.out

    before, after = open_session(pushed), open_session(pushed, frames=(STILL, None))
    assert before.stretches == (range(STILL), range(STILL, N))
    assert after.stretches == (range(STILL, N),)
    assert before.calibration_path.name == "calibration.toml"
    assert after.calibration_path == out
    for camera in after.rig:
        true = pushed_camera() if camera.name == name else RIG[camera.name]
        off_deg = np.degrees(Rotation.from_matrix(camera.R @ true.R.T).magnitude())
        off_m = np.linalg.norm(camera.center - true.center)
        is_pushed = camera.name == name
        assert off_deg < (ANGLE_DEG if is_pushed else 1e-5)
        assert off_m < (2 * PLACE_M if is_pushed else 1e-9)
    # The room is that of before, whatever the camera sees now.
    room = choose_grid(before.rig, 0.05)
    assert before.room_bounds_m == after.room_bounds_m
    np.testing.assert_allclose(before.room_bounds_m, [room.origin, room.upper], atol=0.05)

    said = mocap("check", pushed)
    assert (
        f"from frame {STILL} on the cameras stand as in from_21.toml: camera {name} was turned by" in said.out
    )
    assert f"ok: from frame {STILL} on, people agree with the calibration" in said.out
    # As a whole, by the calibration of before, that camera would not fit.
    whole = mocap("check", pushed, "--calibration", pushed / "calibration.toml", "--frames", f"{STILL}:{N}")
    assert "people agree" not in whole.out

    other = mocap(*order, "-o", pushed / "again.toml")
    assert other.code == 2
    assert "stands where its calibration says" in other.err


@pytest.mark.parametrize(
    ("camera", "frame", "words"),
    [
        (RIG[1].name, STILL, "stands where its calibration says"),
        (RIG[2].name, N - 8, "it shares"),
        ("cam_9", STILL, "the session has no camera cam_9"),
        (RIG[2].name, N + 5, "frame range"),
    ],
)
def test_what_is_no_push_is_refused(
    camera: str, frame: int, words: str, pushed: Path, tmp_path: Path
) -> None:
    root = tmp_path / "session"
    shutil.copytree(pushed / "masks", root / "masks")
    write_calibration(root / "calibration.toml", RIG)
    before = (root / "session.toml").write_text(f"fps = {FPS}\n", encoding="utf-8")
    out = root / "from.toml"
    done = mocap("calibrate", "--refine", root, "--moved", camera, "--from-frame", frame, "-o", out)
    assert done.code == 2
    assert words in done.err
    assert not out.exists()
    assert (root / "session.toml").stat().st_size == before


def test_who_stands_still_does_not_tell_where_a_pushed_camera_stands(tmp_path: Path) -> None:
    root = write_session(tmp_path / "session", walks=False, pushed=pushed_camera())
    write_calibration(root / "calibration.toml", RIG)
    order = ("calibrate", "--refine", root, "--moved", RIG[2].name, "--from-frame", STILL)
    done = mocap(*order, "-o", root / "from.toml")
    assert done.code == 2
    assert "says too little" in done.err


def lenses(path: Path) -> Path:
    """The lenses of the rig, whose cameras are said to stand in a row."""
    places = (replace(camera, R=np.eye(3), t=np.array([k, 0.0, 0.0])) for k, camera in enumerate(RIG))
    write_calibration(path, CameraRig(tuple(places)))
    return path


def test_cameras_are_placed_from_nothing(session: Path, tmp_path: Path) -> None:
    out = tmp_path / "placed.toml"
    given = ("--lenses", lenses(tmp_path / "lenses.toml"), "--height-m", HEIGHT_M)
    done = mocap("calibrate", "--place", session, "-o", out, *given)
    assert done.code == 0, done.err
    assert done.out.count("looks there") == len(RIG)
    found = read_calibration(out)
    assert pair_angles_deg(found.rig, RIG).max() < 2 * ANGLE_DEG
    places, scale = place_errors(found.rig, RIG)
    assert places.max() < 2 * PLACE_M
    assert abs(scale) < 0.04
    assert [c.center[2] for c in found.rig] == pytest.approx([c.center[2] for c in RIG], abs=0.1)
    text = out.read_text(encoding="utf-8")
    assert 'source = "mocap calibrate --place"' in text
    assert 'lenses_from = "lenses.toml"' in text
    again = mocap("calibrate", "--place", session, "-o", out, *given)
    assert again.code == 2
    assert "not written over" in again.err


def test_who_stands_still_places_no_camera(tmp_path: Path) -> None:
    root = write_session(tmp_path / "session", walks=False)
    done = mocap("calibrate", "--place", root, "-o", tmp_path / "placed.toml", "--height-m", HEIGHT_M)
    assert done.code == 2
    assert "one person alone walks" in done.err
    assert not (tmp_path / "placed.toml").exists()


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--place", "SESSION"), "--height-m must be given"),
        (("--place", "SESSION", "--height-m", "1.8", "--floor-frame", "3"), "--floor-frame has no meaning"),
        (
            ("--place", "SESSION", "--height-m", "1.8", "--lenses", "SESSION"),
            "--board, --square-mm must be given",
        ),
        (("--refine", "SESSION", "--place", "SESSION"), "--place has no meaning"),
        (("--refine", "SESSION", "--board", "7x5"), "--board has no meaning"),
        (("CLIPS", "--refine", "SESSION"), "BOARD has no meaning"),
        (("CLIPS", "--board", "7x5"), "--square-mm must be given"),
        (("--height-m", "1.8"), "--height-m has no meaning"),
        (("--refine", "nowhere"), "no such session folder"),
        (("--refine", "SESSION", "--moved", "cam_2"), "--from-frame must be given"),
        (("--refine", "SESSION", "--from-frame", "9"), "--moved must be given"),
        (
            ("--refine", "SESSION", "--moved", "cam_2", "--from-frame", "9", "--height-m", "1.8"),
            "--height-m has no",
        ),
        (("--place", "SESSION", "--height-m", "1.8", "--moved", "cam_2"), "--moved has no meaning"),
    ],
)
def test_options_that_do_not_go_together(
    options: tuple[str, ...], words: str, session: Path, tmp_path: Path
) -> None:
    given = [str(session) if option == "SESSION" else option for option in options]
    done = mocap("calibrate", *given, "-o", tmp_path / "out.toml")
    assert done.code == 2
    assert words in done.err


def test_lenses_of_a_board_are_a_calibration_whose_places_mean_nothing(tmp_path: Path) -> None:
    path = tmp_path / "lenses.toml"
    write_calibration(path, rig_of_lenses({camera.name: Lens.of(camera) for camera in RIG}))
    read = read_calibration(path).rig
    assert read.names == RIG.names
    for own, true in zip(read, RIG, strict=True):
        np.testing.assert_allclose(own.K, true.K)
        assert own.size == true.size
