"""The example of the segmentation page runs and finds what the page says."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from mocap.foreground import quality
from mocap.foreground.quality import MaskQuality

PAGE = Path(__file__).resolve().parents[2] / "docs" / "segmentation.md"


def test_the_example_runs(capsys: pytest.CaptureFixture[str]) -> None:
    (example,) = re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.S)
    exec(compile(example, PAGE.name, "exec"), {"__name__": "docs"})
    said = capsys.readouterr().out
    found = re.search(r"(\d+) of 1440 pixels", said)
    assert found is not None
    assert 1300 < int(found.group(1)) <= 1500
    assert "flicker 0.0%" in said
    assert "advice: none" in said


def test_the_page_names_every_number_and_its_limit() -> None:
    text = PAGE.read_text(encoding="utf-8")
    names = [n for n in MaskQuality.__dataclass_fields__ if n not in ("camera", "advice")]
    assert [n for n in names if f"`{n}`" not in text] == []
    for name, limit in (
        ("flicker", quality.MAX_FLICKER),
        ("leakage", quality.MAX_LEAKAGE),
        ("border_share", quality.MAX_BORDER_SHARE),
        ("unusable_share", quality.MAX_UNUSABLE_SHARE),
        ("residual", quality.MAX_RESIDUAL),
    ):
        (row,) = [line for line in text.splitlines() if line.startswith(f"| `{name}`")]
        assert row.endswith(f"| {limit:.0%} |".replace("%", " %"))
