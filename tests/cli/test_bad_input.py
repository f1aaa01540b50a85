"""Every kind of bad input: one message with file, camera or frame and remedy, code 2, earlier results untouched."""

from __future__ import annotations

import errno
import os
import re
import shutil
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from small_session import (
    CAMERAS,
    PLAIN,
    SETTINGS,
    Said,
    copy_session,
    digests,
    full_disk,
    mocap,
    read_clip,
    set_options,
    write_clip,
)

from mocap.data import LANDMARKS, Motion
from mocap.errors import MocapError
from mocap.io.formats import write_c3d

Damage = Callable[[Path], object]


@pytest.fixture(scope="module")
def finished(session: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path, dict[str, str]]:
    """A session that tests may not change, the output of a run on it, and the digests of that output."""
    out = tmp_path_factory.mktemp("finished") / "out"
    said = mocap("run", session, "-o", out, *set_options(SETTINGS))
    assert (said.code, said.err.count("error")) == (0, 0), said.err
    return session, out, digests(out)


def assert_refused(said: Said, *words: str) -> None:
    assert said.code == 2, said
    message = said.err.strip().splitlines()[-1]
    assert message.startswith("mocap: error: "), said.err
    assert said.err.count("mocap: error:") == 1
    assert "Traceback" not in said.err
    assert "Remedy: " in message
    for word in words:
        assert word in message, message


def rewrite(root: Path, file: str, pattern: str, new: str) -> None:
    """Replace the first match of a pattern in a text file; the pattern must be there."""
    path = root / file
    text, n = re.subn(pattern, new, path.read_text(), count=1, flags=re.S)
    assert n == 1, f"{pattern} is not in {file}"
    path.write_text(text)


def keep_frames(n: int) -> Damage:
    def damage(root: Path) -> None:
        path = root / "videos" / "cam_1.mp4"
        write_clip(path, read_clip(path)[:n])

    return damage


def cut_file(name: str, share: float) -> Damage:
    def damage(root: Path) -> None:
        path = root / name
        data = path.read_bytes()
        path.write_bytes(data[: int(len(data) * share)])

    return damage


def cut_avi(root: Path) -> None:
    """An AVI whose end is missing: its header promises frames that are not there."""
    pictures = read_clip(root / "videos" / "cam_2.mp4") * 4
    path = root / "videos" / "cam_2.avi"
    height, width = pictures[0].shape[:2]
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), 10.0, (width, height))
    for picture in pictures:
        writer.write(picture)
    writer.release()
    data = path.read_bytes()
    path.write_bytes(data[: len(data) // 2])
    (root / "videos" / "cam_2.mp4").unlink()
    for camera in ("cam_0", "cam_1", "cam_3"):
        other = root / "videos" / f"{camera}.mp4"
        write_clip(other, read_clip(other) * 4)


def shrink_video(root: Path) -> None:
    path = root / "videos" / "cam_1.mp4"
    write_clip(path, [cv2.resize(p, (160, 120)) for p in read_clip(path)])


def pictures_with_one(bad: Callable[[Path], None]) -> Damage:
    """Camera 3 as a folder of pictures, one of them bad, discovered in the midst of the run."""

    def damage(root: Path) -> None:
        video = root / "videos" / "cam_3.mp4"
        folder = root / "images" / "cam_3"
        folder.mkdir(parents=True)
        for i, picture in enumerate(read_clip(video)):
            cv2.imwrite(str(folder / f"{i:03d}.png"), picture)
        video.unlink()
        bad(folder / "007.png")

    return damage


def cut_picture(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:100])


def small_picture(path: Path) -> None:
    cv2.imwrite(str(path), np.zeros((20, 30, 3), dtype=np.uint8))


BAD_SESSIONS: dict[str, tuple[Damage, tuple[str, ...]]] = {
    "missing camera": (lambda r: (r / "videos/cam_2.mp4").unlink(), ("camera cam_2", "no video")),
    "extra camera": (
        lambda r: (r / "videos/cam_9.mp4").write_bytes((r / "videos/cam_0.mp4").read_bytes()),
        ("cam_9", "the calibration does not know"),
    ),
    "name mismatch": (
        lambda r: (r / "videos/cam_1.mp4").rename(r / "videos/Kamera1.mp4"),
        ("Kamera1", "cam_1", "camera_map"),
    ),
    "one camera": (
        lambda r: [(r / f"videos/{c}.mp4").unlink() for c in CAMERAS[1:]],
        ("only camera cam_0", "at least two"),
    ),
    "fewer frames": (keep_frames(7), ("different numbers of frames", "cam_1: 7", "--frames 0:7")),
    "one frame less": (keep_frames(11), ("different numbers of frames", "camera cam_1", "--frames 0:11")),
    "other size than calibrated": (shrink_video, ("160 x 120, expected 240 x 184", "cam_1.mp4", "calibrat")),
    "video is no video": (
        lambda r: (r / "videos/cam_3.mp4").write_bytes(b"this is not a video" * 50),
        ("cam_3.mp4", "camera cam_3", "cannot be read"),
    ),
    "truncated mp4": (cut_file("videos/cam_0.mp4", 0.6), ("cam_0.mp4", "camera cam_0")),
    "truncated avi": (cut_avi, ("cam_2.avi", "truncated", "--frames 0:")),
    "empty video file": (lambda r: (r / "videos/cam_3.mp4").write_bytes(b""), ("cam_3.mp4", "empty")),
    "empty picture folder": (
        lambda r: ((r / "videos/cam_3.mp4").unlink(), (r / "images/cam_3").mkdir(parents=True)),
        ("cam_3", "empty"),
    ),
    "damaged picture in the midst": (pictures_with_one(cut_picture), ("007.png", "camera cam_3", "frame 7")),
    "picture of another size in the midst": (
        pictures_with_one(small_picture),
        ("007.png", "camera cam_3", "frame 7", "30 x 20"),
    ),
    "damaged background": (cut_file("background/cam_1.mp4", 0.5), ("background/cam_1.mp4", "camera cam_1")),
    "NaN in the calibration": (
        lambda r: rewrite(r, "calibration.toml", r"translation = \[[^,]*,", "translation = [nan,"),
        ("calibration.toml", "camera cam_0", "translation"),
    ),
    "singular camera matrix": (
        lambda r: rewrite(
            r, "calibration.toml", r"matrix = \[.*?\]\s*\]", "matrix = [[0,0,0],[0,0,0],[0,0,1]]"
        ),
        ("calibration.toml", "camera cam_0", "matrix"),
    ),
    "zero cameras": (
        lambda r: (r / "calibration.toml").write_text('[metadata]\nunits = "m"\n'),
        ("calibration.toml", "no camera"),
    ),
    "calibration is no TOML": (lambda r: (r / "calibration.toml").write_text("[[["), ("calibration.toml",)),
    "no calibration": (lambda r: (r / "calibration.toml").unlink(), ("no calibration",)),
    "no pictures at all": (
        lambda r: [(r / f"videos/{c}.mp4").unlink() for c in CAMERAS],
        ("no pictures and no masks",),
    ),
    "session.toml is no TOML": (lambda r: (r / "session.toml").write_text("fps = "), ("session.toml",)),
    "session.toml is no text": (lambda r: (r / "session.toml").write_bytes(b"\xff\xfe\0"), ("session.toml",)),
    "unknown key in session.toml": (
        lambda r: (r / "session.toml").write_text("fsp = 30\n"),
        ("session.toml", "fsp"),
    ),
    "room without size": (
        lambda r: (r / "session.toml").write_text("room_bounds_m = [[0, 0, 0], [0, 1, 1]]\n"),
        ("session.toml", "room_bounds_m"),
    ),
    "room that nobody can compute": (
        lambda r: (r / "session.toml").write_text("room_bounds_m = [[-900, -900, 0], [900, 900, 900]]\n"),
        ("room_bounds_m",),
    ),
}


@pytest.mark.parametrize("case", BAD_SESSIONS)
def test_bad_session(case: str, finished: tuple[Path, Path, dict[str, str]], tmp_path: Path) -> None:
    session, out, before = finished
    damage, words = BAD_SESSIONS[case]
    damaged = copy_session(session, tmp_path / "session")
    damage(damaged)
    assert_refused(mocap("run", damaged, "-o", out, *set_options(SETTINGS)), *words)
    assert digests(out) == before
    fresh = tmp_path / "fresh"
    assert mocap("run", damaged, "-o", fresh, *set_options(SETTINGS)).code == 2
    assert {p.name for p in fresh.glob("*")} <= {"store.zarr"}


def drop_one_mask(root: Path) -> None:
    (root / "masks" / "cam_1" / "0011.png").unlink()


BAD_MASKS: dict[str, tuple[Damage, tuple[str, ...]]] = {
    "one mask less": (drop_one_mask, ("different numbers of frames", "cam_1: 11")),
    "mask of another size": (
        lambda r: [small_picture(p) for p in (r / "masks/cam_2").iterdir()],
        ("cam_2", "30 x 20, expected 240 x 184"),
    ),
    "one mask of another size": (
        lambda r: small_picture(r / "masks/cam_2/0005.png"),
        ("0005.png", "camera cam_2", "frame 5"),
    ),
    "damaged mask": (
        lambda r: cut_picture(r / "masks/cam_0/0004.png"),
        ("0004.png", "camera cam_0", "frame 4"),
    ),
    "masks of an unknown camera": (
        lambda r: (r / "masks/cam_1").rename(r / "masks/left"),
        ("left", "the calibration does not know"),
    ),
    "camera without masks": (
        lambda r: [p.unlink() for p in (r / "masks/cam_1").iterdir()] and (r / "masks/cam_1").rmdir(),
        ("camera cam_1", "no video, pictures or masks"),
    ),
}


@pytest.mark.parametrize("case", BAD_MASKS)
def test_bad_masks(case: str, finished: tuple[Path, Path, dict[str, str]], tmp_path: Path) -> None:
    session, out, before = finished
    damage, words = BAD_MASKS[case]
    damaged = copy_session(session, tmp_path / "session", masks=True)
    damage(damaged)
    assert_refused(mocap("run", damaged, "-o", out, *set_options(SETTINGS)), *words)
    assert digests(out) == before


BAD_OPTIONS: dict[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    "unknown preset": (("--preset", "fastest"), ("fastest", "default")),
    "preset is no TOML": (("--preset", __file__), ("test_bad_input.py",)),
    "unknown section": (("--set", "poses.n_layers=3"), ("poses", "unknown key", "volume")),
    "unknown key": (("--set", "pose.n_layer=3"), ("pose.n_layer", "unknown key", "n_layers")),
    "bad value": (("--set", "pose.n_layers=many"), ("pose.n_layers",)),
    "value out of range": (("--set", "volume.voxel_size_m=-1"), ("volume.voxel_size_m",)),
    "setting without value": (("--set", "pose.n_layers"), ("pose.n_layers", "section.key=value")),
    "too many faulty views": (("--set", "volume.n_faulty_views=4"), ("n_faulty_views", "4")),
    "unknown filter": (("--filter", "kalman"), ("kalman", "apf")),
    "part by part with one likelihood": (
        ("--filter", "pfcr", "--set", "likelihood.factorised=false"),
        ("pfcr", "likelihood.factorised"),
    ),
    "unknown body": (("--set", "body.model=robot"), ("robot",)),
    "unknown stage": (("--until", "lunch"), ("lunch", "segment")),
    "frames without colon": (("--frames", "5"), ("--frames a:b",)),
    "frames in words": (("--frames", "a:b"), ("--frames a:b",)),
    "negative frames": (("--frames", "-5:3"), ("--frames",)),
    "frames beyond the end": (("--frames", "3:99"), ("3:99", "--frames 0:12")),
    "no frames": (("--frames", "5:5"), ("5:5", "empty")),
    "absent calibration": (("--calibration", "nowhere.toml"), ("nowhere.toml",)),
}


@pytest.mark.parametrize("case", BAD_OPTIONS)
def test_bad_options(case: str, finished: tuple[Path, Path, dict[str, str]]) -> None:
    session, out, before = finished
    options, words = BAD_OPTIONS[case]
    assert_refused(mocap("run", session, "-o", out, *set_options(SETTINGS), *options), *words)
    assert digests(out) == before


def test_absent_session(finished: tuple[Path, Path, dict[str, str]], tmp_path: Path) -> None:
    _, out, before = finished
    for command in ("run", "segment", "carve", "track", "pose"):
        assert_refused(mocap(command, tmp_path / "nowhere", "-o", out), "nowhere", "no such session folder")
    assert_refused(mocap("check", tmp_path / "nowhere"), "nowhere")
    assert digests(out) == before


def test_eval_without_truth_or_result(session: Path, tmp_path: Path) -> None:
    bare = copy_session(session, tmp_path / "session", masks=True)
    assert_refused(mocap("eval", tmp_path / "nothing", bare), "landmarks.csv", "mocap run")
    (bare / "truth" / "landmarks.csv").unlink()
    assert_refused(mocap("eval", tmp_path / "nothing", bare), "landmarks.csv", "truth")


def test_unknown_scene_and_occupied_folder(tmp_path: Path) -> None:
    assert_refused(mocap("synth", "--scene", "ballroom", "-o", tmp_path / "s"), "ballroom", "walk")
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "diary.txt").write_text("dear diary")
    assert_refused(mocap("synth", "-o", tmp_path / "mine"), "mine", "not a synthetic session")
    assert (tmp_path / "mine" / "diary.txt").read_text() == "dear diary"


def test_output_is_a_file(session: Path, tmp_path: Path) -> None:
    (tmp_path / "out").write_text("precious")
    for out in (tmp_path / "out", tmp_path / "out" / "below"):
        assert_refused(mocap("run", session, "-o", out), str(out), "cannot be written")
    assert (tmp_path / "out").read_text() == "precious"


def test_output_where_nobody_may_write(session: Path) -> None:
    if not Path("/proc/self").exists():
        pytest.skip("needs a file system that refuses even the superuser")
    assert_refused(mocap("run", session, "-o", "/proc/mocap"), "/proc/mocap", "cannot be written")


def test_no_permission(session: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(self: Path, data: bytes) -> int:
        raise PermissionError(errno.EACCES, "Permission denied", str(self))

    monkeypatch.setattr(Path, "write_bytes", refuse)
    assert_refused(mocap("run", session, "-o", tmp_path / "out"), "Permission denied", "cannot be written")


def without_store(folder: Path) -> dict[str, str]:
    return {name: digest for name, digest in digests(folder).items() if "store.zarr" not in name}


# Limits that break, in this order: the probe, the first product, masks, tables.
@pytest.mark.parametrize("n_bytes", [0, 200, 3_000, 10_000])
def test_full_disk(n_bytes: int, finished: tuple[Path, Path, dict[str, str]], tmp_path: Path) -> None:
    session, earlier, _ = finished
    out = tmp_path / "out"
    shutil.copytree(earlier, out)
    before = without_store(out)
    with full_disk(n_bytes):
        said = mocap("run", session, "-o", out, "--seed", 1, *set_options(SETTINGS))
    assert_refused(said, str(out), "writ")
    assert without_store(out) == before
    assert not list(out.rglob("*.part*"))
    # Once there is room again the run goes on, to the result of the earlier run.
    assert mocap("run", session, "-o", out, "--resume", *set_options(SETTINGS)).code == 0
    same = ("tracks.csv", "landmarks.csv", "person_1.bvh")
    assert {k: without_store(out)[k] for k in same} == {k: before[k] for k in same}


# Room for every table, whether a gait cycle is seen (cycles.csv 157 kB) or none; the smallest of the others has 325 kB.
@pytest.mark.parametrize("n_bytes", [200_000, 400_000])
def test_a_full_disk_costs_the_large_files_alone(
    n_bytes: int, finished: tuple[Path, Path, dict[str, str]], tmp_path: Path
) -> None:
    session, earlier, _ = finished
    out = tmp_path / "out"
    shutil.copytree(earlier, out)
    with full_disk(n_bytes):
        said = mocap("run", session, "-o", out, "--resume", *set_options(SETTINGS))
    assert said.code == 0, said.err
    lost = without_store(earlier).keys() - without_store(out).keys()
    assert lost
    assert lost <= {"scene.rrd", "report.html", "person_1.glb"}
    for name in lost:
        assert f"{name} was not written" in said.out
    assert not list(out.rglob("*.part*"))


@pytest.mark.parametrize("n_bytes", [100, 2_000, 4_000])
def test_full_disk_while_ezc3d_writes(n_bytes: int, tmp_path: Path) -> None:
    """The library writes half a file without a word; we must not take it for a whole one."""
    pytest.importorskip("ezc3d", reason="C3D needs the extra export")
    path = tmp_path / "person_1.c3d"
    rng = np.random.default_rng(1)
    motion = Motion(1, np.arange(12), np.arange(12) / 10, rng.normal(size=(12, len(LANDMARKS), 3)))
    write_c3d(path, motion, 10.0)
    before = path.read_bytes()
    assert len(before) > 4_000
    with full_disk(n_bytes), pytest.raises(MocapError, match="No space left"):
        write_c3d(path, motion, 10.0)
    assert path.read_bytes() == before
    assert list(tmp_path.iterdir()) == [path]


def test_no_space_left(finished: tuple[Path, Path, dict[str, str]], monkeypatch: pytest.MonkeyPatch) -> None:
    session, out, before = finished

    def refuse(source: str, target: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device", str(target))

    monkeypatch.setattr(os, "replace", refuse)
    said = mocap("run", session, "-o", out, "--resume", *set_options(PLAIN))
    assert_refused(said, str(out), "the disk is full")
    assert digests(out) == before


def test_person_never_visible(session: Path, tmp_path: Path) -> None:
    """No mistake, but a result: empty tables, a warning, code 0; exports of an earlier run are gone."""
    empty = copy_session(session, tmp_path / "session", masks=True)
    out = tmp_path / "out"
    assert mocap("run", empty, "-o", out, *set_options(SETTINGS)).code == 0
    assert (out / "person_1.bvh").exists()
    for mask in (empty / "masks").rglob("*.png"):
        cv2.imwrite(str(mask), np.zeros_like(cv2.imread(str(mask))))
    said = mocap("run", empty, "-o", out, *set_options(SETTINGS))
    assert said.code == 0, said.err
    assert "no person was found" in said.out
    assert "no foreground in any frame" in said.out
    for table in ("tracks.csv", "landmarks.csv"):
        assert len((out / table).read_text().splitlines()) == 1
    assert "std_x_m" in (out / "landmarks.csv").read_text()
    with np.load(out / "pose.npz", allow_pickle=False) as poses:
        assert poses["persons"].shape == (0,)
    assert not list(out.glob("person_*"))
    assert "no person" in (out / "report.html").read_text()
    scores = mocap("eval", out, empty)
    assert scores.code == 0, scores.err
