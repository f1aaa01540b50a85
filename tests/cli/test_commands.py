"""The command line: quick help, lists, checks, conversions, and the README's example."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest
from small_session import CAMERAS, N_FRAMES, SETTINGS, copy_session, mocap, set_options

import mocap as library
from mocap.io.calibration import read_calibration

ROOT = Path(library.__file__).resolve().parents[1]
HEAVY = ("numba", "cv2", "scipy", "zarr", "matplotlib", "numpy", "pydantic", "trimesh", "rerun", "ezc3d")
COMMANDS = (
    *("demo", "run", "segment", "carve", "track", "pose", "eval", "check", "synth"),
    "convert-calibration",
)


def python(code: str, cwd: Path | None = None) -> str:
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=cwd, env=environment, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_help_lists_the_commands_and_imports_nothing_heavy() -> None:
    code = f"""
import sys
sys.argv = ["mocap", "--help"]
from mocap.cli import main
try:
    main()
except SystemExit as leave:
    assert not leave.code
print("HEAVY", *[m for m in {HEAVY!r} if m in sys.modules])
"""
    out = python(code)
    for command in COMMANDS:
        assert re.search(rf"^\W*{command}\b", out, re.M), command
    assert re.search(r"^HEAVY$", out, re.M), out.splitlines()[-1]


def test_no_word_of_the_help_is_taken_for_markup() -> None:
    """What stands in square brackets would not be shown: `[truth]` of a TOML file."""
    import typer

    from mocap.cli.app import app

    commands = typer.main.get_command(app).commands  # type: ignore[attr-defined]
    texts = {
        (name, str(param.name)): str(getattr(param, "help", None) or "")
        for name, command in commands.items()
        for param in command.params
    }
    texts |= {(name, ""): str(command.help or "") for name, command in commands.items()}
    assert ("import", "names") in texts
    assert [where for where, text in texts.items() if re.search(r"(?<!\\)\[[a-z/#@][^\[\]]*\]", text)] == []


def test_import_is_light() -> None:
    out = python(f"import sys, mocap; print(*[m for m in {HEAVY!r} if m in sys.modules])")
    assert out.strip() == ""


def test_every_public_name_can_be_imported() -> None:
    for name in library.__all__:
        assert getattr(library, name) is not None
    with pytest.raises(AttributeError, match="has no attribute 'nonsense'"):
        library.nonsense  # noqa: B018


@pytest.mark.parametrize("command", COMMANDS)
def test_help_of_every_command(command: str) -> None:
    said = mocap(command, "--help")
    assert said.code == 0
    assert "Usage" in said.out


def test_without_arguments_shows_help() -> None:
    assert "demo" in mocap().out + mocap().err


@pytest.mark.parametrize(
    ("arguments", "word"),
    [(("lunch",), "lunch"), (("run",), "SESSION"), (("run", "x", "--speed", "1"), "--speed")],
)
def test_wrong_usage_is_code_2(arguments: tuple[str, ...], word: str) -> None:
    said = mocap(*arguments)
    assert said.code == 2
    assert word in said.err
    assert "Traceback" not in said.err


def test_list_filters_prints_one_name_per_line() -> None:
    said = mocap("run", "--list-filters")
    names = said.out.splitlines()
    assert said.code == 0
    assert {"sir", "apf"} <= set(names)
    assert all(re.fullmatch(r"[a-z0-9-]+", name) for name in names)
    assert len(names) == len(set(names))


def test_list_scenes_prints_one_name_per_line() -> None:
    said = mocap("synth", "--list")
    names = said.out.splitlines()
    assert said.code == 0
    assert {"demo", "walk"} <= set(names)
    assert names == sorted(p.stem for p in (ROOT / "mocap" / "synth" / "scenes").rglob("*.toml"))


def test_run_says_what_it_found(session: Path, tmp_path: Path) -> None:
    said = mocap(
        *("run", session, "-o", tmp_path / "out", "--until", "track", "--frames", ":4", "--threads", 1),
        *set_options(SETTINGS),
    )
    assert said.code == 0, said.err
    assert said.out.splitlines()[0] == f"session: 4 frames, {len(CAMERAS)} cameras, 1 person"
    assert "segment: 4/4" in said.err  # plain lines where there is no terminal
    assert json.loads((tmp_path / "out" / "run.json").read_text())["frames"] == [0, 4]


def test_check(session: Path, tmp_path: Path) -> None:
    said = mocap("check", session)
    assert said.code == 0, said.err
    assert "0 errors" in said.out
    assert all(camera in said.out for camera in CAMERAS)
    assert f"{N_FRAMES} frames per camera" in said.out
    turned = copy_session(session, tmp_path / "session")
    text = (turned / "calibration.toml").read_text()
    # The cameras look up into the sky.
    (turned / "calibration.toml").write_text(
        re.sub(r"rotation = \[.*?\]", "rotation = [0.0, 0.0, 0.0]", text, flags=re.S)
    )
    assert mocap("check", turned).code == 2


def test_convert_calibration(session: Path, tmp_path: Path) -> None:
    said = mocap("convert-calibration", session / "calibration.toml", "-o", tmp_path / "new.toml")
    assert said.code == 0, said.err
    assert f"{len(CAMERAS)} cameras" in said.out
    old, new = read_calibration(session / "calibration.toml").rig, read_calibration(tmp_path / "new.toml").rig
    assert old.names == new.names
    for a, b in zip(old, new, strict=True):
        np.testing.assert_array_equal(a.K, b.K)
        np.testing.assert_array_equal(a.t, b.t)
    assert mocap("convert-calibration", tmp_path / "none.toml", "-o", tmp_path / "x.toml").code == 2
    assert not (tmp_path / "x.toml").exists()


def test_synth_from_a_file(tmp_path: Path) -> None:
    pytest.importorskip("embreex", reason="rendering needs the extra synth (embreex)")
    scene = tmp_path / "tiny.toml"
    scene.write_text(
        "seed = 4\nn_frames = 2\nfps = 10\nmasks_only = true\n[rig]\nn_cameras = 2\nsize_px = [64, 64]\n"
        '[[persons]]\nseed = 5\nmotion = { kind = "stand" }\n'
    )
    said = mocap("synth", "--scene", scene, "-o", tmp_path / "session", "--workers", 1)
    assert said.code == 0, said.err
    assert len(list((tmp_path / "session" / "masks").rglob("*.png"))) == 4
    assert (tmp_path / "session" / "truth" / "landmarks.csv").exists()


def test_presets_are_valid_and_have_a_configuration_file() -> None:
    from mocap.pipeline.config import load_config, presets

    assert {"default", "realtime", "reference"} <= set(presets())
    for preset in presets():
        load_config(preset)
        tomllib.loads((ROOT / "mocap" / "presets" / f"{preset}.toml").read_text())


def library_example() -> str:
    page = (ROOT / "docs" / "library.md").read_text(encoding="utf-8")
    return re.findall(r"^```python\n(.*?)^```", page, flags=re.S | re.M)[0]


def test_library_example_runs(session: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As it stands, on the small session in the place of the demo's."""
    code = library_example()
    assert "out/demo/session" in code
    (tmp_path / "out" / "demo").mkdir(parents=True)
    (tmp_path / "out" / "demo" / "session").symlink_to(session)
    monkeypatch.chdir(tmp_path)
    exec(compile(code, "library.md", "exec"), {"__name__": "__main__"})
