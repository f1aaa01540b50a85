"""The page on scoring: its example and its map run, it names every key, and its numbers are what the script prints."""

from __future__ import annotations

import importlib.util
import re
from pathlib import Path

import pytest

from mocap.compare import detailed_scores
from mocap.io.poses import read_map, skeletons_known

DOCS = Path(__file__).resolve().parents[2] / "docs"
TEXT = (DOCS / "metrics.md").read_text(encoding="utf-8")


def test_the_example_runs(capsys: pytest.CaptureFixture[str]) -> None:
    (example,) = re.findall(r"^```python\n(.*?)^```", TEXT, re.M | re.S)
    exec(compile(example, "metrics.md", "exec"), {"__name__": "docs"})
    assert re.fullmatch(r"\d\d mm, \d\d mm after alignment\n", capsys.readouterr().out)


def test_the_map_is_read(tmp_path: Path) -> None:
    (example,) = re.findall(r"^```toml\n(.*?)^```", TEXT, re.M | re.S)
    (tmp_path / "map.toml").write_text(example, encoding="utf-8")
    sides = read_map(tmp_path / "map.toml")
    assert sides["truth"].landmarks["pelvis"] == ("LASI", "RASI", "LPSI", "RPSI")


def test_every_key_and_skeleton_is_named() -> None:
    assert [
        key for key in detailed_scores([], None) if f"`{key}`" not in TEXT and f"`{key}." not in TEXT
    ] == []
    words = {w for name in skeletons_known() for w in re.split(r", | joint centres| markers| BVH", name) if w}
    assert sorted(w for w in words - {"mocap"} if w not in TEXT) == []


def test_the_numbers_are_those_of_the_script(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    spec = importlib.util.spec_from_file_location("make_metrics_pictures", DOCS / "make_metrics_pictures.py")
    assert spec is not None
    assert spec.loader is not None
    script = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(script)
    monkeypatch.setattr(script, "PICTURES", tmp_path)
    assert script.main() == 0
    said = capsys.readouterr().out
    for number in re.findall(r"(\d+) mm by", said):
        assert re.search(rf"find [^.]*\b{number}\b", TEXT)
    (factor,) = re.findall(r"multiplied by ([\d.]+)", said)
    assert f"found as {factor}" in TEXT
    ((low, high),) = re.findall(r"takes off (\d+) to (\d+) %", said)
    assert f"takes off {low} to {high} % of the" in TEXT
    for picture in tmp_path.iterdir():
        assert picture.read_bytes().startswith(b"\x89PNG")
