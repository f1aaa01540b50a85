"""The list of mutants fits the code it mutates. Whether tests notice them is tried by `make mutants`."""

from pathlib import Path

import pytest

from eval.mutants.registry import Mutant, load_mutants


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


def test_names_are_unique(tmp_path: Path) -> None:
    entry = '[[mutant]]\nname = "a"\nfile = "f"\nold = "x"\nnew = "y"\ntests = []\n'
    path = tmp_path / "list.toml"
    path.write_text(entry * 2)
    with pytest.raises(ValueError, match="twice: a"):
        load_mutants(path)
