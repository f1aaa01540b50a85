"""Tables over sessions: which sessions, and rows that do not all have the same columns."""

from __future__ import annotations

import csv
from pathlib import Path

import pytest

from eval import session_tables
from eval.session_tables import names_of, session_of, session_parser, write_table


def test_sessions_that_are_named_come_before_those_of_the_set() -> None:
    parser = session_parser("What it does.\n\nMore.", "out/somewhere")
    assert parser.description == "What it does."
    assert names_of(parser.parse_args([]), ("walk",), ("jog_test",)) == ("walk",)
    assert names_of(parser.parse_args(["--test"]), ("walk",), ("jog_test",)) == ("jog_test",)
    assert names_of(parser.parse_args(["--test", "a", "b"]), ("walk",), ("jog_test",)) == ["a", "b"]


def test_a_folder_is_the_session_itself(tmp_path: Path) -> None:
    assert session_of(str(tmp_path), Path("nowhere")) == tmp_path


def test_rows_have_the_columns_of_all(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(session_tables, "RESULTS", tmp_path)
    options = session_parser("", "out").parse_args(["--test"])
    write_table("judged", options, [{"a": 1, "b": None}, {"a": 2, "c": 3.5}])
    with (tmp_path / "judged_test.csv").open(encoding="utf-8", newline="") as file:
        assert list(csv.DictReader(file)) == [{"a": "1", "b": "", "c": ""}, {"a": "2", "b": "", "c": "3.5"}]
    options.name = "own"
    write_table("judged", options, [{"a": 1}])
    assert (tmp_path / "judged_own.csv").read_text(encoding="utf-8") == "a\n1\n"
