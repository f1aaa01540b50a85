"""The list of mutants and what it must fulfil."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
LIST = Path(__file__).with_name("mutants.toml")


@dataclass(frozen=True)
class Mutant:
    """One mistake.  file : path below the checkout.  old, new : the text that stands once in it, and what replaces it.

    tests : arguments of pytest that must fail with it.  is_compiled : the tests need the compiler; without it they run
    as plain Python, so that a change of one kernel is seen by all that call it.
    """

    name: str
    file: str
    old: str
    new: str
    tests: tuple[str, ...]
    is_compiled: bool = False

    def problems(self, root: Path = ROOT) -> list[str]:
        """What keeps the mutant from being tried, one line each."""
        found = []
        n = (root / self.file).read_text("utf-8").count(self.old) if (root / self.file).is_file() else -1
        if n < 0:
            found.append(f"{self.name}: {self.file} does not exist")
        elif n != 1:
            found.append(f"{self.name}: its text stands {n} times in {self.file}, expected once")
        if self.old == self.new:
            found.append(f"{self.name}: changes nothing")
        for test in self.test_files:
            if not (root / test).is_file():
                found.append(f"{self.name}: {test} does not exist")
        return found

    @property
    def test_files(self) -> list[str]:
        """The files among the arguments of pytest."""
        return [t.partition("::")[0] for t in self.tests if t.startswith("tests/")]


def load_mutants(path: Path = LIST) -> list[Mutant]:
    """All mutants of a list, in its order.  Raises ValueError for a name that comes twice."""
    entries = tomllib.loads(path.read_text("utf-8"))["mutant"]
    mutants = [Mutant(**{**entry, "tests": tuple(entry["tests"])}) for entry in entries]
    names = [m.name for m in mutants]
    twice = sorted({n for n in names if names.count(n) > 1})
    if twice:
        raise ValueError(f"mutants that come twice: {', '.join(twice)}")
    return mutants
