"""The page on markers: its example runs, and its marker set file is one."""

from __future__ import annotations

import csv
import re
import textwrap
from pathlib import Path

import pytest

from mocap.body import load_body_model, scale_body
from mocap.body.markers import load_marker_set, place_markers

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs" / "markers.md"


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


def test_the_tables_of_conditions_are_the_committed_results() -> None:
    """Both tables, number by number: means of both actions in the first, MMTA (mean error) by action in the second."""
    with (ROOT / "eval" / "results" / "markers_conditions.csv").open(newline="", encoding="utf-8") as stream:
        rows = {(row["condition"], row["action"]): row for row in csv.DictReader(stream)}
    text = PAGE.read_text("utf-8")
    first, together = text.split("### One condition at a time")[1].split("### Conditions together")

    def words(line: str) -> list[str]:
        return [cell.strip() for cell in line.strip("|").split("|")]

    tables = [
        {w[0]: w[1:] for w in map(words, re.findall(r"^\| (?:table|source).*$", part, re.M))}
        for part in (first, together.split("Whole runs")[0])
    ]
    assert [len(table) for table in tables] == [21, 17]
    for name, cells in tables[0].items():
        own = [rows[name, action] for action in ("walk", "jog")]
        mean, mmta = (sum(float(r[f]) for r in own) / 2 for f in ("mean_error_mm", "mmta_percent"))
        assert cells == [f"{mean:.0f}", f"{mmta:.0f}", *(f"{float(r['mmta_percent']):.0f}" for r in own)], (
            name
        )
    for name, cells in tables[1].items():
        for action, cell in zip(("walk", "jog"), cells, strict=True):
            if cell == "-":
                assert (name, action) not in rows
                continue
            row = rows[name, action]
            assert cell == f"{float(row['mmta_percent']):.0f} ({float(row['mean_error_mm']):.0f})", name
