"""`mocap init` on heaps as people have them: flat, a folder per camera, phones, pictures, mixed sizes."""

from __future__ import annotations

import os
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from small_session import mocap

from eval.bench.scene import person_mask, ring
from mocap.io import open_session
from mocap.io.calibration import write_calibration
from mocap.io.session.reading import pictures_of
from mocap.io.session.settings import read_session_settings

SIZE, N = (160, 120), 12
RIG = ring(4, SIZE)
Pictures = list[NDArray[np.uint8]]


def wall(camera: int, size: tuple[int, int] = SIZE) -> NDArray[np.uint8]:
    """What stands still before a camera."""
    rough = np.random.default_rng(camera).integers(40, 200, (6, 8, 3), dtype=np.uint8)
    return np.asarray(cv2.resize(rough, size, interpolation=cv2.INTER_CUBIC), dtype=np.uint8)


def people(camera: int, n: int = N, size: tuple[int, int] = SIZE) -> Pictures:
    """Somebody walks before the wall."""
    pictures = []
    for k in range(n):
        mask = person_mask(RIG[camera], np.array([0.8 * np.cos(k / 4), 0.8 * np.sin(k / 4)]), k / 4)
        mask = cv2.resize(mask.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST) > 0
        pictures.append(np.where(mask[:, :, None], np.uint8(250), wall(camera, size)))
    return pictures


def empty(camera: int, n: int = 6, size: tuple[int, int] = SIZE) -> Pictures:
    return [wall(camera, size)] * n


def board() -> Pictures:
    """A checkerboard of 6 x 4 inner corners."""
    squares = np.indices((5, 7)).sum(axis=0) % 2 * 255
    picture = np.full((SIZE[1], SIZE[0], 3), 255, dtype=np.uint8)
    picture[10:110, 10:150] = np.kron(squares, np.ones((20, 20)))[:, :, None]
    return [picture] * 5


def video(path: Path, pictures: Pictures, fps: float = 30.0) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    codec = "MJPG" if path.suffix.lower() == ".avi" else "mp4v"
    size = pictures[0].shape[1], pictures[0].shape[0]
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*codec), fps, size)  # type: ignore[attr-defined]
    for picture in pictures:
        writer.write(picture)
    writer.release()
    return path


def folder(path: Path, pictures: Pictures) -> None:
    path.mkdir(parents=True)
    for k, picture in enumerate(pictures):
        cv2.imwrite(str(path / f"{k:03d}.png"), picture)


def files_in(root: Path) -> list[str]:
    return sorted(str(p.relative_to(root)) for p in root.rglob("*") if not p.is_dir() or p.is_symlink())


def test_a_flat_folder_with_words_in_the_names(tmp_path: Path) -> None:
    heap = tmp_path / "heap"
    for c in range(4):
        video(heap / f"Cam{c:02d}_walk.mp4", people(c))
        video(heap / f"Cam{c:02d}_empty.mp4", empty(c))
    write_calibration(heap / "calibration.toml", RIG)
    before = files_in(heap)
    done = mocap("init", heap)
    assert done.code == 0, done.err
    root = heap / "session"
    assert files_in(root) == sorted(
        ["calibration.toml", "session.toml"]
        + [f"{where}/cam_{c}.mp4" for c in range(4) for where in ("background", "videos")]
    )
    assert (root / "videos" / "cam_2.mp4").is_symlink()
    assert not os.path.isabs(os.readlink(root / "videos" / "cam_2.mp4"))
    assert [f for f in files_in(heap) if not f.startswith("session")] == before
    assert "Cam02 is called cam_2" in done.out
    session = open_session(root)
    assert session.rig.names == RIG.names
    assert set(session.background_sources) == set(RIG.names)
    assert "Cam02_walk.mp4, 160 x 120 px, 12 frames, 30.000" in (root / "session.toml").read_text("utf-8")

    again = mocap("init", heap)
    assert again.code == 2
    assert "session.toml already" in again.err


def test_a_folder_per_camera_with_names_of_action_cameras(tmp_path: Path) -> None:
    heap = tmp_path / "heap"
    for c in range(3):
        video(heap / f"left{c}" / f"GX01004{c}.mp4", people(c))
        video(heap / f"left{c}" / f"GX01005{c}.mp4", empty(c))
    done = mocap("init", heap, "-o", tmp_path / "session")
    assert done.code == 0, done.err
    found = files_in(tmp_path / "session")
    assert [f for f in found if f.startswith("videos")] == [f"videos/left{c}.mp4" for c in range(3)]
    # Nothing in their names says that they are empty.
    assert [f for f in found if f.startswith("background")] == [f"background/left{c}.mp4" for c in range(3)]
    assert "missing: cameras: there are 3" in done.out
    assert "take" not in done.out.split("missing")[0]
    assert "missing: a calibration" in done.out


def test_phones_in_one_folder_whose_empty_clips_are_told_by_their_pictures(tmp_path: Path) -> None:
    heap = tmp_path / "heap"
    for c in range(4):
        video(heap / f"IMG_12{c}0.mov", people(c))
        video(heap / f"IMG_34{3 - c}1.mov", empty(c))
    done = mocap("init", heap, "-o", tmp_path / "session")
    assert done.code == 0, done.err
    for c in range(4):
        target = (tmp_path / "session" / "background" / f"IMG_12{c}0.mov").resolve()
        assert target.name == f"IMG_34{3 - c}1.mov"


def test_folders_of_pictures_and_boards(tmp_path: Path) -> None:
    heap = tmp_path / "heap"
    for c in range(4):
        folder(heap / "frames" / f"view{c}", people(c))
        folder(heap / "second" / f"view{c}", board())
    done = mocap("init", heap)
    assert done.code == 0, done.err
    root = heap / "session"
    for c in range(4):
        assert (root / "images" / f"view{c}").is_dir()
        assert (root / "board" / f"view{c}").is_dir()
    assert f"mocap calibrate {root}/board" in done.out
    text = (root / "session.toml").read_text(encoding="utf-8")
    assert "# fps = 30.0" in text
    assert read_session_settings(root / "session.toml").fps is None


def test_mixed_sizes_rates_lengths_and_a_broken_clip(tmp_path: Path) -> None:
    heap = tmp_path / "heap"
    video(heap / "cam1.mp4", people(0))
    video(heap / "cam2.mp4", people(1, 20, (320, 240)), fps=60.0)
    video(heap / "cam3.mp4", people(2))
    video(heap / "cam2_background.mp4", empty(1))
    (heap / "cam4.mp4").write_bytes(b"no video")
    done = mocap("init", heap)
    assert done.code == 0, done.err
    assert "cam2: cam2.mp4, 320 x 240, 20 frames, 60 frames/s" in done.out
    assert "cam2_background.mp4 is left out: its size is not that of cam2's recording" in done.out
    assert "cam4.mp4 is left out" in done.out
    text = (heap / "session" / "session.toml").read_text(encoding="utf-8")
    assert "different rates" in text
    assert "`mocap sync`" in text


def test_several_takes(tmp_path: Path) -> None:
    heap = tmp_path / "heap"
    for c in range(3):
        video(heap / f"cam{c}_walk.mp4", people(c))
        video(heap / f"cam{c}_jump.mp4", people(c, 20))
    video(heap / "cam3_walk.mp4", people(3))
    said = mocap("init", heap, "--dry-run")
    assert said.code == 0, said.err
    assert "take walk; others: jump" in said.out
    assert not (heap / "session").exists()
    done = mocap("init", heap, "--take", "jump", "-o", tmp_path / "jump")
    assert done.code == 0, done.err
    assert (tmp_path / "jump" / "videos" / "cam1.mp4").resolve().name == "cam1_jump.mp4"
    wrong = mocap("init", heap, "--take", "run")
    assert wrong.code == 2
    assert "jump, walk" in wrong.err


def test_a_folder_that_is_laid_out_already_gets_its_settings_only(tmp_path: Path) -> None:
    root = tmp_path / "session"
    for c, camera in enumerate(RIG):
        video(root / "videos" / f"{camera.name}.mp4", people(c))
    write_calibration(root / "calibration.toml", RIG)
    done = mocap("init", root)
    assert done.code == 0, done.err
    assert files_in(root) == sorted(
        ["calibration.toml", "session.toml", *(f"videos/{n}.mp4" for n in RIG.names)]
    )
    assert open_session(root).rig.names == RIG.names


def test_chapters_of_action_cameras_are_one_clip(tmp_path: Path) -> None:
    heap, walk = tmp_path / "heap", [people(c, 2 * N) for c in range(4)]
    for c, name in enumerate(RIG.names):
        first, second = ("GOPR", "GP01") if c == 3 else ("GX01", "GX02")
        video(heap / name / f"{first}004{c}.MP4", walk[c][:N])
        video(heap / name / f"{second}004{c}.MP4", walk[c][N:])
    write_calibration(heap / "calibration.toml", RIG)
    root = heap / "session"
    done = mocap("init", heap)
    assert done.code == 0, done.err
    assert "GX010040.MP4, GX020040.MP4 are chapters of one recording, and read as one clip" in done.out
    assert "GX010040.MP4 and 1 more chapter, 160 x 120, 24 frames" in done.out
    assert [f for f in files_in(root) if "cam_0" in f or "cam_3" in f] == [
        "videos/cam_0/GX010040.mp4",
        "videos/cam_0/GX020040.mp4",
        "videos/cam_3/GOPR0043.mp4",
        "videos/cam_3/GP010043.mp4",
    ]
    session = open_session(root)
    assert session.frames == range(2 * N)
    # The picture after the cut is the next one: nothing is lost or shown twice.
    with pictures_of(session, range(N - 1, N + 1)) as reader:
        for frame, pictures in reader:
            for c, picture in enumerate(pictures):
                apart = [np.abs(picture[:, :, ::-1].astype(float) - own).mean() for own in walk[c]]
                assert int(np.argmin(apart)) == frame
    checked = mocap("check", root)
    assert "0 errors" in checked.out


def test_chapters_of_which_some_are_missing_are_named(tmp_path: Path) -> None:
    video(tmp_path / "a" / "GX010042.MP4", people(0))
    video(tmp_path / "a" / "GX030042.MP4", people(0))
    video(tmp_path / "b" / "GX010043.MP4", people(1))
    video(tmp_path / "b" / "GX020044.MP4", people(1))  # of another recording
    done = mocap("init", tmp_path, "--dry-run")
    assert done.code == 0, done.err
    assert "GX010042.MP4, GX030042.MP4 are chapters of one recording, of which some are missing" in done.out
    assert "read as one clip" not in done.out


def test_copies_are_files_of_their_own(tmp_path: Path) -> None:
    for c in range(2):
        video(tmp_path / "heap" / f"cam{c}.mp4", people(c))
    done = mocap("init", tmp_path / "heap", "-o", tmp_path / "session", "--copy")
    assert done.code == 0, done.err
    assert not (tmp_path / "session" / "videos" / "cam0.mp4").is_symlink()


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda heap: None, "no such folder"),
        (lambda heap: heap.mkdir(), "holds no clips"),
        (lambda heap: video(heap / "cam0.mp4", empty(0)), "no clip shows people"),
        (lambda heap: (heap.mkdir(), (heap / "cam0.mp4").write_bytes(b"x")), "that can be read"),
    ],
)
def test_heaps_without_a_recording(make: object, words: str, tmp_path: Path) -> None:
    make(tmp_path / "heap")  # type: ignore[operator]
    done = mocap("init", tmp_path / "heap")
    assert done.code == 2
    assert words in done.err
    assert "Traceback" not in done.err


def test_a_folder_that_is_in_use(tmp_path: Path) -> None:
    video(tmp_path / "heap" / "cam0.mp4", people(0))
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "notes.txt").write_text("mine", encoding="utf-8")
    done = mocap("init", tmp_path / "heap", "-o", tmp_path / "out")
    assert done.code == 2
    assert "not empty" in done.err
