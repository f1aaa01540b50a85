"""The program around its commands: version, completion, Ctrl-C, and mistakes that are met with the right word."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from small_session import PLAIN, mocap, set_options

import mocap as library
import mocap.compare as compare_package
from mocap.pipeline.config import load_config
from mocap.portable import Stopped

ROOT = Path(library.__file__).resolve().parents[1]


def test_version_is_printed() -> None:
    said = mocap("--version")
    assert (said.code, said.err) == (0, "")
    assert said.out.startswith("mocap")


def test_the_shell_completes_commands() -> None:
    environment = {
        **os.environ,
        "PYTHONPATH": str(ROOT),
        "_MOCAP_COMPLETE": "complete_bash",
        "COMP_WORDS": "mocap convert",
        "COMP_CWORD": "1",
    }
    code = "import sys; sys.argv = ['mocap']; from mocap.cli import app; app(prog_name='mocap')"
    done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True)
    assert done.stdout.split() == ["convert-calibration"]
    assert "--install-completion" in mocap("--help").out


def test_lists_are_written_with_commas() -> None:
    assert load_config("default", ("output.formats=bvh,trc",)).output.formats == ("bvh", "trc")
    assert load_config("default", ("output.formats= c3d ",)).output.formats == ("c3d",)
    assert load_config("default", ("pose.level_particles=400,200",)).pose.level_particles == (400, 200)


def test_an_unknown_format_is_answered_with_the_known_ones_and_an_example(tmp_path: Path) -> None:
    said = mocap("run", tmp_path, "-o", tmp_path / "out", "--set", "output.formats=bvh,csv")
    assert said.code == 2
    assert "'trc', 'c3d', 'glb'" in said.err
    assert "got 'csv'" in said.err
    assert "for example --set output.formats=bvh,trc" in said.err


@pytest.mark.parametrize(
    ("setting", "words"),
    [("pose.n_partcles=5", "did you mean 'n_particles'?"), ("psoe.filter=sir", "did you mean 'pose'?")],
)
def test_a_mistyped_setting_is_guessed(tmp_path: Path, setting: str, words: str) -> None:
    assert words in mocap("run", tmp_path, "-o", tmp_path / "out", "--set", setting).err


def test_a_mistyped_key_of_session_toml_is_guessed(session: Path, tmp_path: Path) -> None:
    from small_session import copy_session

    copy = copy_session(session, tmp_path / "session")
    with (copy / "session.toml").open("a") as stream:
        stream.write("\nperson_heigth_m = 1.8\n")
    said = mocap("check", copy)
    assert said.code == 2
    assert "person_heigth_m is not known; did you mean 'person_height_m'?" in said.err


def test_a_mistyped_stage_is_guessed(tmp_path: Path) -> None:
    said = mocap("run", tmp_path, "-o", tmp_path / "out", "--until", "tracks")
    assert said.code == 2
    assert "--until is 'tracks'; did you mean 'track'?" in said.err


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("synth", "-o", "x", "--body", "any"), "--body is 'any'; did you mean 'anny'?"),
        (("synth", "-o", "x", "--scene", "wlak"), "did you mean 'walk'?"),
        (("export", "x", "-o", "y", "--what", "voxel"), "--what is 'voxel'; did you mean 'voxels'?"),
        (
            ("export", "x", "-o", "y", "--format", "obj"),
            "--format is 'obj'. Remedy: give one of ply, npz, glb",
        ),
        (("eval", "x", "y", "--truth-unit", "km"), "--truth-unit is 'km'"),
        (("convert-calibration", "x", "-o", "y", "--units", "km"), "--units is 'km'"),
        (
            ("run", "x", "-o", "y", "--observation", "voxel"),
            "--observation is 'voxel'; did you mean 'voxels'? Remedy: give one of auto, voxels",
        ),
        (
            ("run", "x", "-o", "y", "--device", "cdua"),
            "--device is 'cdua'; did you mean 'cuda'? Remedy: give one of auto, cpu, cuda",
        ),
        (("run", "x", "-o", "y", "--set", "pose.n_layers=0"), "Remedy: see docs/configuration.md"),
    ],
)
def test_a_wrong_value_is_answered_with_the_option_and_what_it_may_be(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, arguments: tuple[str, ...], words: str
) -> None:
    monkeypatch.chdir(tmp_path)
    said = mocap(*arguments)
    assert said.code == 2
    assert words in said.err
    assert list(tmp_path.iterdir()) == []


def test_a_calibration_of_unlikely_size_names_the_option(session: Path, tmp_path: Path) -> None:
    said = mocap(
        "convert-calibration", session / "calibration.toml", "-o", tmp_path / "new.toml", "--units", "mm"
    )
    assert said.code == 2
    assert "--units" in said.err
    assert "argument" not in said.err


def interrupt_after(stage: str) -> Callable[..., Any]:
    """run_session that works up to a stage, and is stopped by Ctrl-C in the next one."""
    from mocap.pipeline.run import run_session

    def run(*args: Any, **more: Any) -> None:
        heard = more["progress"]
        run_session(*args, **{**more, "until": stage})
        heard("carve", 1, 4)
        raise Stopped(signal.SIGINT)

    return run


def test_ctrl_c_in_a_run_says_what_is_kept_and_the_command_that_goes_on(
    session: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    import mocap.pipeline.stretches as pipeline

    out = tmp_path / "out"
    arguments = ("run", session, "-o", out, "--until", "carve", "--frames", ":4", *set_options(PLAIN))
    with monkeypatch.context() as patch:
        patch.setattr(pipeline, "run_session", interrupt_after("segment"))
        said = mocap(*arguments)
    assert said.code == 130
    assert f"mocap: stopped by SIGINT. Finished and kept in {out}: segment." in said.err
    assert "Traceback" not in said.err
    go_on = said.err.strip().partition("Go on with: mocap ")[2]
    assert go_on.endswith("--resume")
    again = mocap(*arguments, "--resume")
    assert again.code == 0, again.err
    assert "segment  reused" in again.out


def test_ctrl_c_anywhere_else_is_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def stop(*args: object) -> None:
        raise Stopped(signal.SIGINT)

    monkeypatch.setattr(compare_package, "compare", stop)
    said = mocap("eval", tmp_path, tmp_path)
    assert said.code == 130
    assert said.err.strip() == "mocap: stopped by SIGINT. It was not done; repeat the command."


@pytest.mark.parametrize("limit_mb", [60, 120, 400, 700])
def test_a_limit_of_memory_below_what_libraries_take_is_told(limit_mb: int) -> None:
    """Without the look beforehand the end is a traceback, a segmentation fault, or OpenBLAS's own words."""
    pytest.importorskip("resource", reason="limits of memory are a matter of POSIX")
    limits = "import resource as r; _, hard = r.getrlimit(r.RLIMIT_AS)"
    code = (
        f"{limits}; r.setrlimit(r.RLIMIT_AS, ({limit_mb} * 2**20, hard)); from mocap.cli import main; main()"
    )
    words = [sys.executable, "-c", code, "check", "nowhere"]
    done = subprocess.run(words, env={**os.environ, "PYTHONPATH": str(ROOT)}, capture_output=True, text=True)
    assert done.returncode == 2, done.stderr
    assert done.stderr.startswith(f"mocap: error: this shell lets a program use {limit_mb} MB of memory")
    assert "ulimit -v" in done.stderr
    assert done.stderr.count("\n") == 1


@pytest.mark.parametrize(
    "error",
    [
        MemoryError(),
        ImportError("cv2.abi3.so: failed to map segment from shared object"),
        OSError("Could not find/load shared object file 'libllvmlite.so'"),
        OSError(12, "Cannot allocate memory"),
        RuntimeError("can't start new thread"),
    ],
)
def test_whoever_runs_out_of_memory_reads_so(monkeypatch: pytest.MonkeyPatch, error: Exception) -> None:
    def fail(*arguments: object, **options: object) -> None:
        raise error

    monkeypatch.setattr("mocap.pipeline.doctor.examine", fail)
    said = mocap("doctor")
    assert said.code == 2
    assert said.err.startswith("mocap: error: out of memory. Remedy: ")


def test_other_failures_are_not_called_a_lack_of_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail() -> None:
        raise RuntimeError("a mistake of ours")

    monkeypatch.setattr("mocap.pipeline.doctor.examine", fail)
    with pytest.raises(RuntimeError, match="a mistake of ours"):
        mocap("doctor")
