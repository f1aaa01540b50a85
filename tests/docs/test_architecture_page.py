"""docs/architecture.md: every file and name that its tables point to exists, and the rooms are those of the source."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from docs.make_architecture import BEGIN, END, PAGE, arrows, floors, table

ROOT = Path(__file__).resolve().parents[2]
TEXT = PAGE.read_text("utf-8")


def answers() -> list[tuple[str, tuple[str, ...]]]:
    """File and names of every row of the table of questions."""
    rows = re.findall(r"^\|[^|]*\| `([^`]+)` \|([^|]*)\|$", TEXT.partition("## Where is")[2], re.M)
    return [(path, tuple(re.findall(r"`(\w+)`", names))) for path, names in rows]


def test_there_are_many_answers() -> None:
    assert len(answers()) > 30


@pytest.mark.parametrize(("path", "names"), answers())
def test_an_answer_leads_somewhere(path: str, names: tuple[str, ...]) -> None:
    text = (ROOT / path).read_text("utf-8")
    for name in names:
        assert re.search(rf"^(class|def) {name}\b|^{name}\b.*=", text, re.M), f"{path} defines no {name}"


def test_the_rooms_are_those_of_the_source() -> None:
    written = TEXT.partition(BEGIN)[2].partition(END)[0].strip()
    assert written == table(arrows()), "run python -m docs.make_architecture"


def test_every_room_stands_above_what_it_imports() -> None:
    graph = arrows()
    floor = floors(graph)
    assert all(floor[room] > floor[below] for room, all_below in graph.items() for below in all_below)


PAGES = sorted([*ROOT.glob("*.md"), *ROOT.glob("docs/*.md")])
# Files of an example that a reader writes himself.
EXAMPLES = {"mocap/filters/elite.py"}


@pytest.mark.parametrize("page", PAGES, ids=lambda path: path.name)
def test_pages_name_files_and_modules_that_exist(page: Path) -> None:
    text = page.read_text("utf-8")
    files = set(re.findall(r"\b((?:mocap|eval|tests)/[\w/]+\.(?:py|toml))\b", text))
    modules = {
        m.replace(".", "/") for m in re.findall(r"\bpython -m ((?:mocap|eval|docs)(?:\.\w+)+)(?![\w*])", text)
    }
    missing = [m for m in modules if not (ROOT / m).is_dir() and not (ROOT / f"{m}.py").is_file()]
    assert [f for f in files - EXAMPLES if not (ROOT / f).is_file()] + missing == []
