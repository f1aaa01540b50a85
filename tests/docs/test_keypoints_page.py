"""docs/keypoints.md: the example runs and prints what it should."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

PAGE = Path(__file__).resolve().parents[2] / "docs" / "keypoints.md"


def test_the_examples_find_the_person_and_read_a_detectors_points(capsys: pytest.CaptureFixture[str]) -> None:
    page: dict[str, object] = {"__name__": "keypoints_page"}
    for code in re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), flags=re.DOTALL):
        exec(compile(code, str(PAGE), "exec"), page)
    said = capsys.readouterr().out
    height, frames = re.findall(r"a person of (\d\.\d+) m over (\d+) frames", said)[0]
    assert "1 person, then 0; the left wrist at (256, 228)" in said  # MediaPipe's point 15
    assert float(height) == pytest.approx(1.75, abs=0.05)
    assert int(frames) == 10
