"""The edits page: its file is read, its commands are those of the program, its example runs."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from mocap.pipeline.edits.model import KINDS, parse_edits
from mocap.pose.method import EditSettings

PAGE = Path(__file__).resolve().parents[2] / "docs" / "edits.md"


def text() -> str:
    return PAGE.read_text(encoding="utf-8")


def test_the_file_of_the_page_is_read() -> None:
    (file,) = re.findall(r"```toml\n(.*?)```", text(), re.S)
    assert [edit.do for edit in parse_edits(file, PAGE).edit] == ["swap", "pin"]


def test_every_edit_is_on_the_page_as_command_and_in_the_table() -> None:
    for kind in KINDS:
        assert re.search(rf"^    mocap edit OUT {kind} ", text(), re.M), kind
        assert re.search(rf"^\| `{kind}` \|", text(), re.M), kind


def test_the_numbers_are_those_of_the_method() -> None:
    numbers = EditSettings()
    assert f"to {100 * numbers.pin_std_m:.0f} cm" in text()
    assert f"more than {100 * numbers.reach_m:.0f} cm" in text()


def test_the_example_mends_the_track(capsys: pytest.CaptureFixture[str]) -> None:
    (example,) = re.findall(r"```python\n(.*?)```", text(), re.S)
    exec(compile(example, PAGE.name, "exec"), {"__name__": "docs"})
    before, after = capsys.readouterr().out.splitlines()
    assert before == "person 1 before: [-1. -1.  1.  1. -1.]"
    assert after == "person 1 after:  [-1. -1. -1. -1. -1.]"
