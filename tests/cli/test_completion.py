"""What the shell completes are the names that the program takes."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from small_session import mocap

import mocap as library
from mocap.cli import complete
from mocap.pipeline.config import load_config

ROOT = Path(library.__file__).resolve().parents[1]


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        ("mocap run x --filter shbm", ["shbm-apf", "shbm-ddma-pf"]),
        ("mocap edit x ex", ["exchange"]),
    ],
)
def test_the_shell_completes_values(words: str, expected: list[str]) -> None:
    environment = {
        **os.environ,
        "PYTHONPATH": str(ROOT),
        "_MOCAP_COMPLETE": "complete_bash",
        "COMP_WORDS": words,
        "COMP_CWORD": str(len(words.split()) - 1),
    }
    code = "import sys; sys.argv = ['mocap']; from mocap.cli import app; app(prog_name='mocap')"
    done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True)
    assert done.stdout.split() == expected


def test_settings_are_completed_to_what_can_be_set() -> None:
    keys = complete.settings("")
    assert {"pose.n_particles=", "observation=", "method.repair.jump_m="} <= set(keys)
    assert not [key for key in keys if key.startswith("edits")]
    assert complete.settings("pose.n_part") == ["pose.n_particles="]
    assert complete.settings("pose.refine=") == ["pose.refine=true", "pose.refine=false"]
    assert complete.settings("output.formats=bvh,t") == ["output.formats=bvh,trc"]
    assert complete.settings("volume.n_faulty_views=a") == ["volume.n_faulty_views=auto"]
    assert complete.settings("no.such=x") == []
    for key in keys:
        for setting in complete.settings(key):
            load_config("default", (setting,))


def test_every_word_that_is_completed_is_taken() -> None:
    assert "default" in complete.presets("")
    assert complete.presets("ref") == ["reference", "reference_markers", "reference_shbm"]
    assert complete.observations("v") == ["voxels"]
    assert complete.devices("c") == ["cpu", "cuda"]
    assert complete.stages("t") == ["track"]
    assert "demo" in complete.scenes("d")
    assert complete.landmarks("left_w") == ["left_wrist"]


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (
            ("run", "x", "-o", "y", "--preset", "refrence"),
            "--preset is 'refrence'; did you mean 'reference'?",
        ),
        (("run", "x", "-o", "y", "--filter", "apff"), "--filter is 'apff'; did you mean 'apf'?"),
        (("run", "x", "-o", "y", "--frames", "5"), "--frames is '5', no range of frames"),
        (("run", "x", "-o", "y", "--set", "output.formats=bvh,trk"), "got 'trk'; did you mean 'trc'?"),
        (("run", "sesion", "-o", "y"), "no such session folder; did you mean 'session'?"),
    ],
)
def test_a_slip_is_answered_with_the_option_and_the_nearest_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, words: tuple[str, ...], told: str
) -> None:
    (tmp_path / "session").mkdir()
    monkeypatch.chdir(tmp_path)
    said = mocap(*words)
    assert said.code == 2
    assert told in said.err
    assert "?." not in said.err
