"""docs/keypoints.md: the example runs and prints what it should."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

PAGE = Path(__file__).resolve().parents[2] / "docs" / "keypoints.md"


def test_the_example_finds_the_person(capsys: pytest.CaptureFixture[str]) -> None:
    (code,) = re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), flags=re.DOTALL)
    exec(compile(code, str(PAGE), "exec"), {"__name__": "keypoints_page"})
    height, frames = re.findall(r"a person of (\d\.\d+) m over (\d+) frames", capsys.readouterr().out)[0]
    assert float(height) == pytest.approx(1.75, abs=0.05)
    assert int(frames) == 10
