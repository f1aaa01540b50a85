"""The list of mutants fits the code it mutates. Whether tests notice them is tried by `make mutants`."""

import csv
import json
from pathlib import Path

import pytest

from eval.mutants.__main__ import RESULTS, WANTED_SHARE, kept_of
from eval.mutants.registry import Mutant, load_mutants
from eval.mutants.trial import checkout_digest, try_all


def test_every_mutant_can_be_planted() -> None:
    mutants = load_mutants()
    problems = [p for m in mutants for p in m.problems()]
    assert not problems, "\n".join(problems)
    assert len(mutants) >= 80


def test_the_whole_numerical_core_is_tried() -> None:
    rooms = {m.file.split("/")[1] for m in load_mutants()}
    assert rooms >= {
        "geometry",
        "data",
        "body",
        "likelihood",
        "filters",
        "volume",
        "tracking",
        "metrics",
        "pose",
    }


def test_what_cannot_be_planted_is_said(tmp_path: Path) -> None:
    (tmp_path / "a.py").write_text("x = 1\nx = 1\ny = 2\n")
    (tmp_path / "tests").mkdir()
    (tmp_path / "tests" / "test_a.py").write_text("")
    good = Mutant("good", "a.py", "y = 2", "y = 3", ("tests/test_a.py", "-k", "y"))
    assert good.problems(tmp_path) == []
    for bad, message in (
        (Mutant("twice", "a.py", "x = 1", "x = 2", ("tests/test_a.py",)), "2 times"),
        (Mutant("gone", "b.py", "x = 1", "x = 2", ("tests/test_a.py",)), "b.py does not exist"),
        (Mutant("same", "a.py", "y = 2", "y = 2", ("tests/test_a.py",)), "changes nothing"),
        (Mutant("untested", "a.py", "y = 2", "y = 3", ("tests/test_b.py",)), "test_b.py does not exist"),
    ):
        assert message in "\n".join(bad.problems(tmp_path))


def test_the_committed_run_was_whole_and_good_enough() -> None:
    with RESULTS.open(newline="", encoding="utf-8") as stream:
        rows = list(csv.DictReader(stream))
    assert {row["noticed"] for row in rows} <= {"yes", "no"}
    noticed = [row["mutant"] for row in rows if row["noticed"] == "yes"]
    assert len(noticed) >= WANTED_SHARE * len(rows)
    assert len(rows) >= 0.9 * len(load_mutants())  # mutants may have come since


def test_names_are_unique(tmp_path: Path) -> None:
    entry = '[[mutant]]\nname = "a"\nfile = "f"\nold = "x"\nnew = "y"\ntests = []\n'
    path = tmp_path / "list.toml"
    path.write_text(entry * 2)
    with pytest.raises(ValueError, match="twice: a"):
        load_mutants(path)


def test_what_is_known_counts_until_the_checkout_changes(tmp_path: Path) -> None:
    (tmp_path / "mocap").mkdir()
    (tmp_path / "mocap" / "a.py").write_text("x = 1\n")
    before = checkout_digest(tmp_path)
    store = tmp_path / "mutants.json"
    assert kept_of(before, store) == {}
    store.write_text(json.dumps({"of": before, "noticed": {"a": True, "b": False}}))
    assert kept_of(checkout_digest(tmp_path), store) == {"a": True, "b": False}
    (tmp_path / "mocap" / "a.py").write_text("x = 2\n")
    assert kept_of(checkout_digest(tmp_path), store) == {}


def test_a_mutant_that_is_known_is_not_tried_again(tmp_path: Path) -> None:
    known = Mutant("known", "no_such_file.py", "x", "y", ("tests/no_such_test.py",))
    kept = {"known": False}
    try_all([known], tmp_path, kept, lambda: pytest.fail("nothing was tried"))
    assert kept == {"known": False}
