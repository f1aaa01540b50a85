"""The page on markers: its example runs, and its marker set file is one."""

from __future__ import annotations

import re
import textwrap
from pathlib import Path

import pytest

from mocap.body import load_body_model, scale_body
from mocap.body.markers import load_marker_set, place_markers

PAGE = Path(__file__).resolve().parents[2] / "docs" / "markers.md"


def test_the_example_runs(capsys: pytest.CaptureFixture[str]) -> None:
    (example,) = re.findall(r"^```python\n(.*?)^```", PAGE.read_text("utf-8"), re.M | re.S)
    exec(compile(example, PAGE.name, "exec"), {"__name__": "docs"})
    assert capsys.readouterr().out.startswith("20 head ")


def test_the_marker_set_of_the_page_is_read(tmp_path: Path) -> None:
    (block,) = re.findall(r'^( {4}name = "my_set"\n(?: {4}.*\n)+)', PAGE.read_text("utf-8"), re.M)
    path = tmp_path / "set.toml"
    path.write_text(textwrap.dedent(block), encoding="utf-8")
    markers = place_markers(load_marker_set(path), scale_body(load_body_model("anthropometric"), 1.7))
    assert markers.names == ("left_knee",)


def test_the_names_of_the_set_are_on_the_page() -> None:
    text = PAGE.read_text("utf-8")
    for marker in load_marker_set("markers_20").marker:
        assert marker.name.removeprefix("left_").removeprefix("right_") in text
