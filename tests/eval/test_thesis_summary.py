"""The page of CF Tables 8.1 and 8.2: numbers of the source, ours from the committed files, and nothing between."""

from __future__ import annotations

import statistics

import pytest

from eval.decomposition.tables import read_csv
from eval.shbm_actions import FILTERS
from eval.thesis_summary import (
    ACTIONS,
    OWN,
    PAGE,
    PUBLISHED,
    RESULTS,
    on_five_actions,
    page,
    scores_of,
    table,
    with_average,
)


def test_published_numbers_stand_beside_ours() -> None:
    lines = table(lambda s: f"{s[1]:.0f} / {s[2]:.0f}")
    assert (
        "| *markerless APF, published* | 72 / 80 | 92 / 68 | 93 / 68 | 90 / 69 | 95 / 61 | 90 / 71 |" in lines
    )
    assert len(lines) == 2 + len(PUBLISHED) + len(OWN)
    # The averages of the source are over frames, so near the plain mean of its actions.
    for rows in PUBLISHED.values():
        for i in range(3):
            assert rows[-1][i] == pytest.approx(statistics.fmean(row[i] for row in rows[:-1]), rel=0.06)


def test_every_row_of_ours_finds_its_measurements() -> None:
    for own in OWN:
        lines = read_csv(RESULTS / f"{own.file}.csv")
        found = [scores_of(own, action, lines) for action in ACTIONS]
        assert sum(s is not None for s in found) >= 2, own.words
        assert own.answers in PUBLISHED


def test_averages_need_all_actions() -> None:
    one = (10.0, 20.0, 30.0)
    assert with_average((one, (20.0, 40.0, 50.0))) == (one, (20.0, 40.0, 50.0), (15.0, 30.0, 40.0))
    assert with_average((one, None)) == (one, None, None)


def test_the_page_is_that_of_the_committed_results() -> None:
    assert PAGE.read_text(encoding="utf-8") == page()


def test_five_actions_stand_beside_the_published_ones() -> None:
    """Means over seeds, and their spread; as many evaluations as the source in the first table, fewer in the second."""
    lines = [
        {"scene": action, "filter": name, "seed": str(seed), "mean_mm": str(40 + 2 * seed), "mmtp_mm": "30",
         "mmta_percent": "90"}
        for action in ACTIONS for name in FILTERS for seed in (0, 1)
    ]  # fmt: skip
    text = "\n".join(on_five_actions(lines))
    assert "| *SHBM-APF, model 1, published* | 42, 39 / 83 | 47, 43 / 75 |" in text
    assert "| APF, 4 x 550, ours | 41 ± 1, 30 / 90 |" in text
    assert "over\n2 seeds" in text
    assert "| shbm model2 | 30 / 90 | 30 / 90 | 30 / 90 |" in text
    assert on_five_actions([]) == []
