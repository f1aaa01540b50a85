"""Tables of few cameras: which sets are tried, how cells are made, and that the pages say what was measured."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from marker_world import ring

from docs import make_few_cameras
from eval.few_cameras import camera_sets, some_cameras
from eval.whole import with_table


@pytest.mark.parametrize("which", make_few_cameras.PAGES)
def test_the_pages_say_what_the_tables_say(which: str) -> None:
    page = make_few_cameras.PAGES[which].read_text(encoding="utf-8")
    text = make_few_cameras.table(make_few_cameras.rows(), which)
    assert len(text.splitlines()) == 2 + (4 if which == "short" else 8)
    assert with_table(page, "few cameras", text) == page


def test_the_page_says_what_the_tables_among_furniture_say() -> None:
    page = make_few_cameras.PAGES["all"].read_text(encoding="utf-8")
    text = make_few_cameras.table_of_rooms(make_few_cameras.rows(make_few_cameras.FURNISHED))
    assert "nan" not in text
    assert with_table(page, "among furniture", text) == page


def row(session: str, n: int, places: str, seed: int, raw: float) -> dict[str, str]:
    return {
        "session": session, "n_cameras": str(n), "places": places, "seed": str(seed),
        "mean_error_mm": str(raw), "after_offset_mm": str(raw / 2), "mmta_percent": "98",
    }  # fmt: skip


def test_cells_are_means_over_seeds_and_pairs_go_by_the_angle_that_was_looked_for() -> None:
    found = [row("walk", 2, "104 degrees apart", seed, 20.0 + 10 * seed) for seed in range(2)]
    found += [row("walk", 4, "all round", 0, 10.0), row("walk", 2, "52 degrees apart", 0, 40.0)]
    lines = make_few_cameras.table(found, "all").splitlines()
    assert lines[2] == "| two, 100 degrees apart | 25.0 (12.5), 20.0 to 30.0; 98.0 % |"
    assert lines[3] == "| four, all round | 10.0 (5.0); 98.0 % |"
    short = make_few_cameras.table(found, "short").splitlines()
    assert short[2:] == ["| two, 100 degrees apart | 25 mm, 98 % |", "| four, all round | 10 mm, 98 % |"]


def test_sets_of_a_ring_are_what_their_words_say() -> None:
    rig = ring(8, size=(640, 496))
    sets = dict(camera_sets(rig, np.zeros(2)))
    assert {len(names) for words, names in sets.items() if "degrees" in words} == {2}
    assert sets["all"] == rig.names
    found = [(words, len(names)) for words, names in camera_sets(rig, np.zeros(2))]
    assert found[3:] == [(w, n) for n in (3, 4) for w in ("all round", "side by side")] + [("all", 8)]


def test_some_cameras_are_the_same_session_with_a_list(tmp_path: Path) -> None:
    own = tmp_path / "own"
    (own / "videos").mkdir(parents=True)
    (own / "session.toml").write_text("fps = 30\n", encoding="utf-8")
    root = some_cameras(own, ("b", "c"), tmp_path / "work")
    assert (root / "session.toml").read_text(encoding="utf-8") == 'cameras = ["b", "c"]\nfps = 30\n'
    assert (root / "videos").resolve() == (own / "videos").resolve()
