"""The catalogue of scores: it knows every number, units are those of the keys, every list of scores is part of it."""

from __future__ import annotations

from pathlib import Path

import pytest

from eval import pose_sessions
from mocap.cli import scores as cli_scores
from mocap.compare import detailed_scores, evaluate
from mocap.compare.page import _HEADLINE as PAGE_HEADLINE
from mocap.metrics.catalogue import CATALOGUE, heading, score_at, score_hint, score_of, score_text
from mocap.pipeline.cluster.tables import _FIRST_SCORES, page
from mocap.view import REPORT_SCORES

ROOT = Path(__file__).resolve().parents[2]
NOTHING = evaluate([], [], None, None) | detailed_scores([], None)
UNIT_OF_ENDING = {
    "_mm": "mm",
    "_px": "px",
    "_percent": "%",
    "_deg": "deg",
    "_m_s2": "m/s²",
    "_m_s3": "m/s³",
}


def test_every_number_has_a_name_and_a_meaning() -> None:
    tables = ("sweep", "aligned", "angles", "per_", "pck_percent", "epsilon_search", "offset_calibration")
    others = ("reliability", "image", "unit_warning")
    numbers = [key for key in NOTHING if not key.startswith((*tables, *others))]
    assert len(numbers) > 30
    assert [key for key in numbers if key not in CATALOGUE] == []
    assert [
        key for key, score in CATALOGUE.items() if not (score.name and score.meaning and score.label)
    ] == []


@pytest.mark.parametrize("key", CATALOGUE)
def test_units_are_those_of_the_key(key: str) -> None:
    unit = next((u for ending, u in UNIT_OF_ENDING.items() if key.endswith(ending)), "")
    assert CATALOGUE[key].unit == unit


def test_errors_are_better_small_and_shares_large() -> None:
    for key, score in CATALOGUE.items():
        if "error" in key or "lost_wrist" in key:
            assert score.better == "lower", key
        if key.endswith(("mmta_percent", "mota_percent", "hota_percent", "iou")):
            assert score.better == "higher", key


def test_every_key_is_explained_in_the_documents() -> None:
    text = "".join((ROOT / "docs" / name).read_text("utf-8") for name in ("outputs.md", "metrics.md"))
    assert [key for key in CATALOGUE if key.partition(".")[0] not in text] == []


def test_every_list_of_scores_is_part_of_it() -> None:
    lists = (
        REPORT_SCORES,
        PAGE_HEADLINE,
        cli_scores.RUN_SCORES,
        cli_scores.MORE_SCORES,
        pose_sessions.SCORES,
        _FIRST_SCORES,
    )
    assert {key for keys in lists for key in keys} <= set(CATALOGUE)


def test_words_of_a_score() -> None:
    assert heading("mmta_percent") == "MMTA (%)"
    assert heading("misses") == "Misses"
    assert score_hint("volume_iou").endswith("1 is identical. Higher is better.")
    assert score_hint("frames").startswith("Frames scored.")
    assert score_text(12.345, score_of("mean_error_mm")) == "12.3"
    assert score_text(0.5, score_of("volume_iou")) == "0.500"
    assert score_text(3, score_of("misses")) == "3"
    assert score_text(float("nan"), score_of("misses")) == score_text(None, score_of("misses")) == "unknown"


def test_an_unknown_key_speaks_for_itself() -> None:
    score = score_of("elbow_error_mm")
    assert (score.name, score.unit, score.meaning) == ("elbow error mm", "mm", "")
    assert score_text(2.0, score_of("n_things")) == "2"
    assert score_text(0.25, score_of("n_things")) == "0.250"


def test_a_dotted_key_is_a_path() -> None:
    scores = {"aligned": {"root": {"mean_error_mm": 4.0}}, "image": None}
    assert score_at(scores, "aligned.root.mean_error_mm") == 4.0
    assert score_at(scores, "image.mean_error_px") is None
    assert score_at(scores, "mmta_percent") is None


def test_tables_of_a_sweep_say_what_a_column_means() -> None:
    text = page("t", [{"status": "done", "mmtp_mm": 3.0}], [{"mmtp_mm": 3.0}], ["seed"])
    assert f'<th title="{score_hint("mmtp_mm")}">mmtp_mm</th>' in text
    assert "<th>status</th>" in text
