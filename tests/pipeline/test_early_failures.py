"""What would cost a computed run is found before it is computed, and one failed file costs no other."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from small_session import PLAIN, copy_session, mocap, small_session

import mocap as library
from mocap.errors import MocapError
from mocap.io.session import open_session
from mocap.pipeline import checks, outputs, run
from mocap.pipeline.config import Config, load_config
from mocap.pipeline.run import run_session

SMALL = (*PLAIN, "volume.voxel_size_m=0.05")


def config(*settings: str) -> Config:
    return load_config("default", (*SMALL, *settings))


@pytest.fixture(scope="module")
def base(tmp_path_factory: pytest.TempPathFactory) -> Path:
    small = small_session(tmp_path_factory.getbasetemp())
    return copy_session(small, tmp_path_factory.mktemp("early") / "session", masks=True, n_frames=3)


@pytest.fixture
def session(base: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(base, tmp_path / "session"))


def refused(session: Path, out: Path, plain: Config | None = None, **options: object) -> MocapError:
    """The error, which comes before the first stage."""
    stages = []
    with pytest.raises(MocapError) as caught:
        run_session(
            session, out, config=plain or config(), progress=lambda *said: stages.append(said), **options
        )
    assert stages == []
    assert not (out / "store.zarr").exists()
    return caught.value


def damaged_archive(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:100] if path.exists() else b"PK\x03\x04 no archive")


def half_an_archive(path: Path) -> None:
    np.savez(path, shape=np.ones(3))


@pytest.mark.parametrize(
    ("name", "damage"),
    [
        ("landmarks.csv", lambda path: path.write_text("person,frame\nx,y\n")),
        ("landmarks.csv", lambda path: path.write_bytes(b"\xff\xfe\x00")),
        ("tracks.csv", lambda path: path.write_text("nothing of a table\n")),
        ("voxels.npz", damaged_archive),
        ("voxels.npz", half_an_archive),
        ("voxels.npz", lambda path: path.write_bytes(b"")),
    ],
)
@pytest.mark.parametrize("until", ["pose", "report"])
def test_damaged_truth_is_found_before_the_first_stage(
    session: Path, tmp_path: Path, name: str, damage: object, until: str
) -> None:
    damage(session / "truth" / name)  # type: ignore[operator]
    error = refused(session, tmp_path / "out", until=until)
    assert "truth" in str(error)
    assert error.remedy


def test_truth_is_not_looked_at_where_nothing_is_scored(session: Path, tmp_path: Path) -> None:
    (session / "truth" / "landmarks.csv").write_text("x")
    run_session(session, tmp_path / "out", config=config(), until="segment")


@pytest.mark.parametrize("place", [".", "results", "masks/deep", "link"])
def test_results_do_not_go_into_the_session(session: Path, tmp_path: Path, place: str) -> None:
    out = session / place
    if place == "link":
        out = tmp_path / "link"
        out.symlink_to(session, target_is_directory=True)
    before = sorted(session.rglob("*"))
    with pytest.raises(MocapError, match="do not belong into the session") as caught:
        run_session(session, out, config=config())
    assert "-o" in caught.value.remedy
    assert sorted(session.rglob("*")) == before


def test_results_beside_or_around_the_session_are_fine(session: Path) -> None:
    run_session(session, session.parent, config=config(), until="segment")
    run_session(session, session.with_name("session_out"), config=config(), until="segment")


@pytest.mark.parametrize(
    ("setting", "words"),
    [
        ("pose.n_particles=1000000000000", "particles take"),
        ("pose.level_particles=[5, 1000000000000]", "particles take"),
        ("volume.voxel_size_m=0.0021", "voxel"),
        ("volume.voxel_size_m=0.2", "too thin"),
        ("pose.table_density=4", "too thin"),
        ("volume.n_faulty_views=4", "n_faulty_views is 4"),
    ],
)
def test_settings_beyond_this_machine_are_refused(
    session: Path, tmp_path: Path, setting: str, words: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(checks, "total_memory_bytes", lambda: 500_000_000)
    error = refused(session, tmp_path / "out", config(setting))
    assert words in error.message
    assert error.remedy


def test_the_same_settings_pass_where_there_is_memory(session: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(checks, "total_memory_bytes", lambda: 2**60)
    checks.check_config(config("pose.n_particles=1000000000000"), "voxels")
    checks.check_volume(open_session(session), config("volume.n_faulty_views=3"))
    monkeypatch.setattr(checks, "total_memory_bytes", lambda: None)
    checks.check_config(config("pose.n_particles=100000"), "voxels")


@pytest.mark.parametrize("value", ["inf", "nan", "-inf"])
@pytest.mark.parametrize(
    "key",
    ["segmentation.hold_s", "pose.outline_weight", "tracking.reid_s", "markers.sigma", "pose.jump_nats"],
)
def test_numbers_that_are_not_finite_are_refused(key: str, value: str) -> None:
    with pytest.raises(MocapError, match=key):
        config(f"{key}={value}")


@pytest.mark.parametrize("setting", ["volume.n_faulty_views=-1", "volume.min_views=0", "volume.min_views=-3"])
def test_counts_of_cameras_below_their_least_are_refused(setting: str) -> None:
    with pytest.raises(MocapError, match=r"volume\.(n_faulty|min)_views"):
        config(setting)


# --- one file costs no other ---


@pytest.mark.parametrize("name", ["write_bvh", "write_scene", "report", "gathering"])
@pytest.mark.parametrize(
    "error", [MocapError("cannot be done", remedy="none"), TypeError("ascii"), OSError(5, "broken")]
)
def test_a_failed_export_costs_no_other(
    session: Path, tmp_path: Path, name: str, error: Exception, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(path: Path, *_: object, **__: object) -> None:
        (path if isinstance(path, Path) else _[0]).write_text("half")  # type: ignore[union-attr]
        raise error

    if name == "report":
        monkeypatch.setattr(run, "write_run_report", lambda result, path, gathered: fail(path))
    elif name == "gathering":
        monkeypatch.setattr(run, "gather_report", lambda result, pictures: fail(tmp_path / "elsewhere"))
    else:
        monkeypatch.setattr(outputs, name, fail)
    failed = {"write_bvh": "person_1.bvh", "write_scene": "scene.rrd"}.get(name, "report.html")
    formats = 'output.formats=["bvh", "trc", "rrd", "report"]'
    result = run_session(session, tmp_path / "out", config=config(formats))
    written = {p.name for p in (tmp_path / "out").iterdir()}
    assert failed not in written
    wanted = {"run.json", "landmarks.csv", "person_1.trc", "person_1.bvh", "report.html"} - {failed}
    assert wanted <= written
    about = json.loads((tmp_path / "out" / "run.json").read_text())
    (said,) = [w for w in about["warnings"] if failed in w]
    assert str(getattr(error, "strerror", None) or error) in said
    assert said in result.warnings


def test_a_truth_that_fails_only_when_it_is_scored_costs_the_scores(
    session: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: object, **__: object) -> None:
        raise MocapError("the truth is of another world", remedy="none")

    monkeypatch.setattr(run, "score_run", fail)
    result = run_session(session, tmp_path / "out", config=config("output.formats=[]"))
    assert result.scores is None
    assert any("not scored" in w and "another world" in w for w in result.warnings)
    assert (tmp_path / "out" / "landmarks.csv").exists()


def test_names_that_are_no_utf_8_are_written_all_the_same(session: Path, tmp_path: Path) -> None:
    odd = tmp_path / os.fsdecode(b"s\xffion \xc3\xa4")
    try:
        session.rename(odd)
    except OSError:
        pytest.skip("the file system takes UTF-8 alone")
    out = tmp_path / os.fsdecode(b"out\xfe")
    result = run_session(
        odd, out, config=config('output.formats=["bvh", "report"]'), command=f"mocap run {odd}"
    )
    assert (out / "report.html").read_text("utf-8").count("s\ufffdion \u00e4") >= 1
    assert json.loads((out / "run.json").read_text("utf-8"))["session"] == "s\ufffdion \u00e4"
    assert not [w for w in result.warnings if "not written" in w]


# --- signals ---


@pytest.mark.skipif(os.name == "nt", reason="signals of Unix")
@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM", "SIGHUP"])
def test_a_signal_ends_with_a_message_and_without_litter(session: Path, tmp_path: Path, name: str) -> None:
    out = tmp_path / "out"
    # More frames than can be done before the signal comes.
    code = (
        "import signal, sys, time\nfrom mocap.pipeline.walk import Recorder\nreal = Recorder._write\n"
        # A shell that starts the tests in the background ignores some signals for them.
        "for name in ('SIGINT', 'SIGTERM', 'SIGHUP'):\n    signal.signal(getattr(signal, name), signal.SIG_DFL)\n"
        "def slow(self, rows):\n    time.sleep(0.5)\n    real(self, rows)\n"
        "Recorder._write = slow\nfrom mocap.cli import main\nmain()\n"
    )
    environment = {**os.environ, "PYTHONPATH": str(Path(library.__file__).parents[1])}
    command = [sys.executable, "-c", code, "run", str(session), "-o", str(out), "--until", "segment"]
    with subprocess.Popen(command, env=environment, stderr=subprocess.PIPE, text=True) as process:
        deadline = time.monotonic() + 60
        while not list(out.glob("store.zarr/.segment.partial")) and time.monotonic() < deadline:
            time.sleep(0.02)
        process.send_signal(getattr(signal, name))
        _, said = process.communicate(timeout=60)
    assert process.returncode == 128 + getattr(signal, name)
    assert f"stopped by {name}" in said
    assert "--resume" in said
    assert "Traceback" not in said
    assert [p.name for p in out.iterdir()] == ["store.zarr"]
    assert not list(out.glob("store.zarr/.*.partial"))


def test_the_command_line_says_it_in_one_line(session: Path, tmp_path: Path) -> None:
    (session / "truth" / "tracks.csv").write_text("x")
    said = mocap("run", session, "-o", tmp_path / "out")
    assert said.code == 2
    assert said.err.startswith("mocap: error: ")
    assert "Traceback" not in said.err


@pytest.mark.parametrize(
    ("extra", "words"),
    [
        (
            None,
            '--device cuda needs the package numba-cuda. Remedy: pip install "mocap-volumes[gpu]", or let the',
        ),
        (
            "numba_cuda",
            "--device cuda: no CUDA device answers. Remedy: see whether `nvidia-smi` lists one, or let the",
        ),
    ],
)
def test_a_device_that_does_not_answer_is_said(
    session: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, extra: str | None, words: str
) -> None:
    monkeypatch.setattr(checks, "device_name", lambda: None)
    monkeypatch.setattr(checks, "find_spec", lambda name: extra)
    said = str(refused(session, tmp_path / "out", config("likelihood.device=cuda")))
    assert words in said
    assert said.endswith("processor score: --device cpu.")


def test_no_device_is_asked_for_where_none_scores(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(checks, "begun", None)  # what asks
    checks.check_device(config())
    checks.check_device(config("likelihood.device=cpu"))


def test_a_device_that_answers_will_do(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(checks, "device_name", lambda: "a device")
    checks.check_device(config("likelihood.device=cuda"))
