"""docs/depth.md: the example runs and prints what it should."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

PAGE = Path(__file__).resolve().parents[2] / "docs" / "depth.md"


def test_the_example_comes_nearer_to_the_box(capsys: pytest.CaptureFixture[str]) -> None:
    (code,) = re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), flags=re.DOTALL)
    exec(compile(code, str(PAGE), "exec"), {"__name__": "depth_page"})
    silhouettes, depth, box = map(int, re.findall(r"(\d+) l", capsys.readouterr().out))
    assert box == 240
    assert 0.95 * box < depth < 0.85 * silhouettes
