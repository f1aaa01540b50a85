"""Result files appear whole or not at all, and the committed ones are whole."""

from __future__ import annotations

import ast
import csv
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import pytest

from eval import whole
from eval.ddma_lost_limbs import FILTERS as LOST_LIMB_FILTERS
from eval.hull_clips import MASKS
from eval.shbm_against_apf import FILTERS as STRUCTURAL_FILTERS
from eval.whole import kept_rows, write_csv, write_text

ROOT = Path(__file__).resolve().parents[2]
RESULTS = ROOT / "eval" / "results"


def rows_until_an_error() -> Iterator[dict[str, int]]:
    yield {"a": 1, "b": 2}
    raise KeyboardInterrupt


def test_what_breaks_off_leaves_the_file_as_it_was(tmp_path: Path) -> None:
    path = tmp_path / "found.csv"
    with pytest.raises(KeyboardInterrupt):
        write_csv(path, ("a", "b"), rows_until_an_error())
    assert list(tmp_path.iterdir()) == []
    write_csv(path, ("a", "b"), [{"a": 1, "b": 2}])
    assert path.read_bytes() == b"a,b\n1,2\n"
    with pytest.raises(KeyboardInterrupt):
        write_csv(path, ("a", "b"), rows_until_an_error())
    with pytest.raises(ValueError, match="c"):
        write_csv(path, ("a", "b"), [{"a": 1, "c": 2}])
    assert path.read_bytes() == b"a,b\n1,2\n"
    assert list(tmp_path.iterdir()) == [path]
    write_text(path, "new")
    assert path.read_text() == "new"


def test_rows_are_kept_for_the_program_that_made_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made = iter(range(10))

    def found(*, again: bool = False) -> str:
        return kept_rows(tmp_path / "rows.csv", ("a",), lambda: [{"a": next(made)}], again=again)[0]["a"]

    assert [found(), found(), found(again=True), found()] == ["0", "0", "1", "1"]
    monkeypatch.setattr(whole, "code_hash", lambda: "another")
    assert [found(), found()] == ["2", "2"]
    monkeypatch.undo()
    assert found() == "1"


def test_studies_write_in_no_other_way() -> None:
    """Files that grow on purpose are opened with "a" and lie in out/; `same_bytes` records where it is told to, and
    `mutants` writes sources that it puts back."""
    found = []
    for path in sorted((ROOT / "eval").rglob("*.py")):
        if path.name in ("whole.py", "same_bytes.py") or path.parent.name == "mutants":
            continue
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if not isinstance(node, ast.Call) or not isinstance(node.func, ast.Attribute):
                continue
            mode = node.args[0] if node.args else None
            opens = node.func.attr == "open" and isinstance(mode, ast.Constant) and "w" in str(mode.value)
            in_out = "stage_seconds" in ast.unparse(node.func)  # of the study's own work folder
            if opens or (node.func.attr in ("write_text", "savefig") and not in_out):
                found.append(f"{path.relative_to(ROOT)}:{node.lineno}")
    assert found == []


@pytest.mark.parametrize(
    ("name", "filters"),
    [("ddma_lost_limbs", LOST_LIMB_FILTERS), ("shbm_against_apf", STRUCTURAL_FILTERS)],
)
def test_a_comparison_of_filters_has_all_of_them(name: str, filters: tuple[str, ...]) -> None:
    """A run in progress has the first filters only; it was committed once."""
    path = RESULTS / f"{name}.csv"
    with path.open(newline="", encoding="utf-8") as stream:
        rows = list(csv.DictReader(stream))
    runs = Counter((row["scene"], row["masks"], row["filter"]) for row in rows)
    assert {masks for _, masks, _ in runs} == set(MASKS)
    assert set(runs) == {(s, m, f) for s in {s for s, _, _ in runs} for m in MASKS for f in filters}
    assert len(set(runs.values())) == 1, "every filter has all seeds"
