"""docs/equations.toml against code and tests: nothing cited that is not registered, nothing claimed untested."""

from __future__ import annotations

import ast
import importlib
import inspect
import re
import tomllib
from collections import Counter
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
REGISTER = ROOT / "docs" / "equations.toml"

# What the sources number: chapter -> last equation; algorithms; tables.
EQUATIONS = {
    "CF": {"2": 8, "3": 22, "4": 36, "5": 9, "6": 26, "7": 29, "A": 14},
    "XN": {"2": 9, "3": 9, "4": 5, "5": 1, "6": 3},
}
ALGORITHMS = {"CF": ("1", "2", "3", "4"), "XN": ("2.1", "3.1", "3.2", "3.3", "3.4", "5.1", "6.1")}
TABLES = {
    "CF": ("4.1", "4.2", "4.3", "4.4", "4.5", "6.1", "6.2", "6.3", "6.4", "7.1", "8.1", "8.2"),
    "XN": ("4.1", "5.1", "6.1", "6.2"),
    "SW": ("1", "2", "3"),
}

_NUMBER = r"[A-Z]?\.?\d+(?:\.\d+)*"
_ITEM = rf"(?:(Eq\.|Alg\.|Table)\s+)?({_NUMBER})(?:\s*-\s*({_NUMBER}))?"
_CITATION = re.compile(rf"\b(CF|XN|SW)\s+({_ITEM}(?:,\s+{_ITEM})*)")


def citations(text: str) -> set[str]:
    """Keys that a text cites: "CF Eq. 4.2-4.4, 4.7, Table 4.1" gives five; bare sections (CF 2.2.4) give none."""
    keys = set()
    for match in _CITATION.finditer(re.sub(r"\s+", " ", text)):
        source, kind = match[1], ""
        for item in re.finditer(_ITEM, match[2]):
            kind = item[1] or kind
            first, last = item[2], item[3] or item[2]
            if not kind or first.count(".") > 1:
                continue
            if last == first:
                keys.add(f"{source} {kind} {first}")
                continue
            chapter = first.rpartition(".")[0]
            low, high = int(first.rpartition(".")[2]), int(last.rpartition(".")[2])
            prefix = f"{chapter}." if chapter else ""
            keys |= {f"{source} {kind} {prefix}{i}" for i in range(low, high + 1)}
    return keys


@cache
def register() -> tuple[dict[str, str], ...]:
    return tuple(tomllib.loads(REGISTER.read_text("utf-8"))["entry"])


def expected_keys() -> set[str]:
    keys = {
        f"{source} Eq. {chapter}.{i}"
        for source, chapters in EQUATIONS.items()
        for chapter, last in chapters.items()
        for i in range(1, last + 1)
    }
    keys |= {f"{source} Alg. {n}" for source, numbers in ALGORITHMS.items() for n in numbers}
    return keys | {f"{source} Table {n}" for source, numbers in TABLES.items() for n in numbers}


def resolve(dotted: str) -> object:
    """The object of a dotted path; ImportError or AttributeError when it is not there."""
    parts = dotted.split(".")
    for n in range(len(parts) - 1, 0, -1):
        try:
            thing: object = importlib.import_module(".".join(parts[:n]))
        except ModuleNotFoundError:
            continue
        for name in parts[n:]:
            thing = getattr(thing, name)
        return thing
    raise ImportError(dotted)


@cache
def functions_of(path: Path) -> frozenset[str]:
    tree = ast.parse(path.read_text("utf-8"))
    return frozenset(node.name for node in ast.walk(tree) if isinstance(node, ast.FunctionDef))


def docstrings_of(path: Path) -> str:
    """All strings and comments of a module."""
    text = path.read_text("utf-8")
    strings = [
        node.value
        for node in ast.walk(ast.parse(text))
        if isinstance(node, ast.Constant) and isinstance(node.value, str)
    ]
    return "\n\n".join([*strings, *re.findall(r"#.*", text)])


IMPLEMENTED = [e for e in register() if e["status"] in ("implemented", "departs")]


def test_every_number_of_the_sources_is_listed_once() -> None:
    counts = Counter(e["key"] for e in register())
    doubled = [k for k, n in counts.items() if n > 1]
    assert not doubled
    assert set(counts) == expected_keys()


def test_entries_are_well_formed() -> None:
    for entry in register():
        assert entry["status"] in ("implemented", "departs", "skipped"), entry
        assert entry["note"].endswith("."), entry
        wanted = {"key", "status", "note"}
        if entry["status"] != "skipped":
            wanted |= {"function", "test"}
        assert set(entry) == wanted, entry


@pytest.mark.parametrize("function", sorted({e["function"] for e in IMPLEMENTED}))
def test_the_function_exists_and_cites_its_keys(function: str) -> None:
    thing = resolve(function)
    source = inspect.getsource(getattr(thing, "py_func", thing))  # type: ignore[arg-type]
    cited = citations(source)
    for entry in IMPLEMENTED:
        if entry["function"] == function:
            assert entry["key"] in cited, f"{function} does not cite {entry['key']}"


@pytest.mark.parametrize("test", sorted({e["test"] for e in IMPLEMENTED}))
def test_the_test_exists(test: str) -> None:
    file, _, name = test.partition("::")
    assert name.startswith("test_")
    assert (ROOT / file).is_file(), file
    assert name in functions_of(ROOT / file), test


def test_every_citation_in_the_code_is_registered_as_implemented() -> None:
    """Functions that merely mention a number count too: whoever cites, registers."""
    known = {e["key"]: e["status"] for e in register()}
    wrong = []
    for path in sorted((ROOT / "mocap").rglob("*.py")):
        for key in sorted(citations(docstrings_of(path))):
            where = f"{path.relative_to(ROOT)}: {key}"
            if key not in known:
                wrong.append(f"{where} is not in the register")
            elif known[key] == "skipped":
                wrong.append(f"{where} is registered as skipped")
    assert not wrong, "\n".join(wrong)


def test_departures_are_said_in_the_code() -> None:
    """A function registered as departing says so."""
    for entry in IMPLEMENTED:
        if entry["status"] == "departs":
            source = inspect.getsource(resolve(entry["function"]))  # type: ignore[arg-type]
            assert re.search(r"[Dd]eparts", source), entry


def test_departures_that_the_code_says_are_registered() -> None:
    """What a function says it departs from is not registered as implemented to the letter."""
    wrong = []
    for entry in IMPLEMENTED:
        source = re.sub(r"\s+", " ", inspect.getsource(resolve(entry["function"])))  # type: ignore[arg-type]
        said = {
            key
            for words in re.findall(r"[Dd]eparts from ((?:CF|XN|SW) [^:]*)", source)
            for key in citations(words)
        }
        if entry["key"] in said and entry["status"] != "departs":
            wrong.append(entry["key"])
    assert not wrong


@pytest.mark.parametrize(
    ("text", "keys"),
    [
        ("Source: CF Eq. 6.1.", {"CF Eq. 6.1"}),
        ("CF Eq. 3.9-3.11 and more", {"CF Eq. 3.9", "CF Eq. 3.10", "CF Eq. 3.11"}),
        ("Source: CF Alg. 3,\n    Eq. 3.18-3.19.", {"CF Alg. 3", "CF Eq. 3.18", "CF Eq. 3.19"}),
        ("CF 4.2.3, Eq. 4.2-4.3, 4.7. Departs", {"CF Eq. 4.2", "CF Eq. 4.3", "CF Eq. 4.7"}),
        ("CF Eq. 5.9, 5.3.2 (gate of CF 5.4)", {"CF Eq. 5.9"}),
        ("CF 6.3.4, Table 6.1.", {"CF Table 6.1"}),
        ("CF Eq. A.5-A.7", {"CF Eq. A.5", "CF Eq. A.6", "CF Eq. A.7"}),
        ("XN Alg. 5.1 and SW Table 2", {"XN Alg. 5.1", "SW Table 2"}),
        ("CF 2.2.4 (voxel coloring)", set()),
    ],
)
def test_citations_are_read_as_people_write_them(text: str, keys: set[str]) -> None:
    assert citations(text) == keys
