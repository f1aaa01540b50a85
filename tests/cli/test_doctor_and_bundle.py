"""`mocap doctor` and `mocap bundle`, and places in which little may be written."""

from __future__ import annotations

import os
import stat
import subprocess
import sys
import zipfile
from pathlib import Path

import numpy as np
import pytest
from small_session import PLAIN, copy_session, mocap

import mocap as library
from mocap import portable
from mocap.data import Motion
from mocap.io.formats import write_c3d
from mocap.pipeline import doctor
from mocap.pipeline.bundle import without_places, write_bundle
from mocap.pipeline.config import load_config
from mocap.pipeline.run import run_session

ROOT = Path(library.__file__).resolve().parents[1]


def test_doctor_finds_nothing_wrong_here() -> None:
    said = mocap("doctor")
    assert said.code == 0, said.out
    assert said.out.endswith("All is well.\n")
    for what in (
        "versions",
        "machine",
        "extra synth",
        "temporary files",
        "kernels",
        "video .mp4",
        "store",
        "self-test",
    ):
        assert f"  {what}: " in said.out


def test_doctor_says_what_is_to_be_mended(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(doctor, "_BALL_EXCESS", (2.0, 3.0))
    monkeypatch.setattr(doctor, "_requirements", lambda: ["numpy>=99.1", "zarr>=1", "no-such-package>=1"])
    said = mocap("doctor")
    assert said.code == 2
    assert "wrong  numpy: " in said.out
    assert "at least 99.1 is needed" in said.out
    assert "wrong  no-such-package: is not installed" in said.out
    assert said.out.endswith("3 things to mend.\n")


def test_a_bundle_holds_numbers_and_neither_pictures_nor_folders(session: Path, tmp_path: Path) -> None:
    root = tmp_path / "Jörg's films"
    root.mkdir()
    copied = copy_session(session, root / "session", masks=True, n_frames=4)
    out = root / "out"
    settings = (*PLAIN, "volume.voxel_size_m=0.05", 'output.formats=["bvh", "report"]')
    run_session(copied, out, config=load_config("default", settings), command=f"mocap run {copied} -o {out}")
    said = mocap("bundle", out, copied, "-o", tmp_path / "bundle.zip")
    assert said.code == 0, said.err
    with zipfile.ZipFile(tmp_path / "bundle.zip") as archive:
        found = {name: archive.read(name) for name in archive.namelist()}
    for name in (
        "run.json",
        "doctor.txt",
        "tracks.csv",
        "landmarks.csv",
        "pose.npz",
        "session/calibration.toml",
    ):
        assert found[name], name
    assert "store/carve/zarr.json" in found
    endings = {Path(name).suffix for name in found}
    assert endings <= {".json", ".txt", ".csv", ".npz", ".toml"}
    assert b"mocap run $SESSION -o $OUT" in found["run.json"]
    for name, content in found.items():
        assert "Jörg".encode() not in content, name
        assert str(tmp_path).encode() not in content, name
        assert str(ROOT).encode() not in content, name


def test_a_bundle_of_no_run_is_refused(tmp_path: Path) -> None:
    said = mocap("bundle", tmp_path, "-o", tmp_path / "b.zip")
    assert said.code == 2
    assert "there is no run in this folder" in said.err
    assert not (tmp_path / "b.zip").exists()


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("/home/eva/films/a.mp4", "$HOME/films/a.mp4"),
        ("file /data/secret project/x.csv, frame 3", "file $ELSEWHERE/x.csv, frame 3"),
        ('{"path": "C:\\\\Users\\\\eva\\\\a.mp4"}', '"$ELSEWHERE/a.mp4"}'),
        ("25 frames/s, m/s2, and/or", "25 frames/s, m/s2, and/or"),
        ("see https://example.org/a/b", "see https://example.org/a/b"),
    ],
)
def test_what_is_left_of_a_path(text: str, expected: str) -> None:
    left = without_places(text.encode(), {"/home/eva": "$HOME"}).decode()
    assert expected in left
    for word in ("eva", "secret", "Users"):
        assert word not in left


def test_kernels_are_compiled_where_nothing_can_be_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    assert portable.kernel_cache_dir() is not None
    monkeypatch.setattr(portable, "_may_be_written", lambda folder: str(tmp_path) in str(folder))
    monkeypatch.setattr(portable.tempfile, "mkdtemp", lambda prefix: str(tmp_path / prefix))
    monkeypatch.setattr(portable.atexit, "register", lambda *args, **kwargs: None)
    assert portable.kernel_cache_dir() is None
    portable.find_kernel_cache()
    assert os.environ["NUMBA_CACHE_DIR"] == str(tmp_path / "mocap-kernels-")
    assert portable.kernel_cache_dir() == tmp_path / "mocap-kernels-"


def test_the_private_folder_for_kernels_is_private_and_goes_with_its_process() -> None:
    """Kernels are unpickled: nobody else may put some there."""
    code = (
        "import os, stat; from mocap import portable\n"
        "portable._may_be_written = lambda folder: False\n"
        "portable.find_kernel_cache(); place = os.environ['NUMBA_CACHE_DIR']\n"
        "print(place, stat.S_IMODE(os.stat(place).st_mode))"
    )
    environment = {k: v for k, v in os.environ.items() if k != "NUMBA_CACHE_DIR"} | {"PYTHONPATH": str(ROOT)}
    done = subprocess.run(
        [sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True
    )
    place, mode = done.stdout.split()
    assert int(mode) == stat.S_IRWXU
    assert not Path(place).exists()


ASCII = {"LC_ALL": "C", "PYTHONCOERCECLOCALE": "0", "PYTHONUTF8": "0", "PYTHONIOENCODING": ""}


@pytest.mark.skipif(os.name == "nt", reason="locales of Unix")
def test_names_with_umlauts_under_a_locale_that_has_none(tmp_path: Path) -> None:
    pytest.importorskip("ezc3d")
    folder = tmp_path / "Grüße"
    folder.mkdir()
    rng = np.random.default_rng(2)
    motion = Motion(1, np.arange(3), np.arange(3) / 30, rng.normal(size=(3, 15, 3)))
    write_c3d(tmp_path / "here.c3d", motion, 30.0)
    code = (
        "import os, sys, numpy as np\n"
        "from pathlib import Path\n"
        "from mocap.data import Motion\n"
        "from mocap.io.formats import write_bvh, write_c3d, write_trc\n"
        "rng = np.random.default_rng(2)\n"
        "motion = Motion(1, np.arange(3), np.arange(3) / 30, rng.normal(size=(3, 15, 3)))\n"
        "write_c3d(Path(os.fsdecode(sys.argv[1])) / 'there.c3d', motion, 30.0)\n"
        "write_trc(Path(os.fsdecode(sys.argv[1])) / 'there.trc', motion, 30.0)\n"
    )
    environment = {**os.environ, **ASCII, "PYTHONPATH": str(ROOT)}
    done = subprocess.run(
        [sys.executable, "-c", code, str(folder)],
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert (folder / "there.c3d").read_bytes() == (tmp_path / "here.c3d").read_bytes()
    assert (folder / "there.trc").exists()


def test_the_bundle_says_what_the_doctor_says(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "run.json").write_text("{}")
    monkeypatch.setattr("mocap.pipeline.bundle.examine", lambda: [doctor.Finding("x", "wrong", "is broken")])
    names = write_bundle(tmp_path, tmp_path / "b.zip")
    assert names == ["README.txt", "doctor.txt", "run.json"]
    with zipfile.ZipFile(tmp_path / "b.zip") as archive:
        assert archive.read("doctor.txt") == b"   wrong  x: is broken\n"
