"""Tables of a sweep or batch: CSV and JSON of every cell, means over sessions and seeds, and a page to look at.

Nothing in them depends on how long a cell took or who ran it: the same cells give the same bytes. Times are in a
file of their own.
"""

from __future__ import annotations

import csv
import html
import io
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mocap.errors import MocapError
from mocap.io._files import atomic_text
from mocap.metrics.catalogue import CATALOGUE, score_hint
from mocap.pipeline.cluster.engine import Outcome

_FIRST_SCORES = ("mean_error_mm", "mmtp_mm", "mmta_percent", "angle_mean_deg", "motp_mm", "mota_percent")


@dataclass(frozen=True)
class Row:
    """A cell.  columns : what it was.  outcome : what it gave."""

    columns: Mapping[str, Any]
    outcome: Outcome

    @property
    def scores(self) -> dict[str, Any]:
        result = self.outcome.result or {}
        return dict(result.get("scores", {}))


def score_names(rows: Sequence[Row], wanted: Sequence[str] = ()) -> list[str]:
    """Columns of scores: those wanted, else every number that some row has, in the order they come.

    Raises MocapError for a wanted score that no scored row has.
    """
    found = list(dict.fromkeys(name for row in rows for name, v in row.scores.items() if _is_number(v)))
    known = {name for row in rows for name in row.scores}
    unknown = [name for name in wanted if known and name not in found]
    if unknown and known.isdisjoint(unknown):
        raise MocapError(
            f"there is no score named {unknown[0]!r}", remedy=f"scores of this sweep: {', '.join(found)}"
        )
    return list(wanted) or found


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def write_tables(
    out: Path,
    rows: Sequence[Row],
    *,
    groups: Sequence[str],
    over: Sequence[str],
    scores: Sequence[str] = (),
    title: str = "Sweep",
) -> list[Path]:
    """table.csv, table.json, summary.csv, table.html and times.csv; gives the files.

    groups : columns that a row of the summary stands for.  over : columns that it averages over.
    """
    names = score_names(rows, scores)
    table = [_flat_row(row, names) for row in rows]
    summary = summarise(rows, groups, names)
    document = [
        {**row.columns, "status": _status(row), **_without_times(row.outcome), "error": row.outcome.error}
        for row in rows
    ]
    files = {
        "table.csv": csv_text(table),
        "table.json": json.dumps(document, indent=1) + "\n",
        "summary.csv": csv_text(summary),
        "table.html": page(title, table, summary, over),
        "times.csv": csv_text([_times(row) for row in rows]),
    }
    for name, text in files.items():
        atomic_text(out / name, text)
    return [out / name for name in files]


def summarise(rows: Sequence[Row], groups: Sequence[str], names: Sequence[str]) -> list[dict[str, Any]]:
    """Mean and standard deviation of every score over the cells that agree in `groups`; failed cells are counted."""
    found: dict[str, list[Row]] = {}
    for row in rows:
        found.setdefault(json.dumps([row.columns.get(g) for g in groups]), []).append(row)
    summary = []
    for members in found.values():
        line: dict[str, Any] = {g: members[0].columns.get(g) for g in groups}
        line["n_cells"] = len(members)
        line["n_failed"] = sum(not row.outcome.is_done for row in members)
        for name in names:
            values = [v for row in members if (v := row.scores.get(name)) is not None]
            line[name], line[f"{name}_sd"] = _mean_and_deviation(values)
        summary.append(line)
    return summary


def _mean_and_deviation(values: Sequence[float]) -> tuple[float | None, float | None]:
    """Of the values there are; the deviation needs two."""
    if not values:
        return None, None
    mean = math.fsum(values) / len(values)
    if len(values) == 1:
        return mean, None
    return mean, math.sqrt(math.fsum((v - mean) ** 2 for v in values) / (len(values) - 1))


def csv_text(rows: Sequence[Mapping[str, Any]]) -> str:
    """Rows of one table, columns in the order they first come; empty where a row has none."""
    names = list(dict.fromkeys(name for row in rows for name in row))
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(names)
    writer.writerows([cell_text(row.get(name)) for name in names] for row in rows)
    return stream.getvalue()


def cell_text(value: Any) -> str:
    """A value in a table: six digits of a number, lists as JSON, nothing for None."""
    if value is None:
        return ""
    if isinstance(value, float):
        return f"{value:.6g}"
    return str(value) if isinstance(value, str | int) else json.dumps(value)


def plain_table(rows: Sequence[Mapping[str, Any]], n_scores: int = 6) -> str:
    """A table for the terminal, with the scores that are looked at first."""
    if not rows:
        return ""
    names = _terminal_columns(rows, n_scores)
    cells = [names] + [[_short(row.get(name)) for name in names] for row in rows]
    widths = [max(len(line[i]) for line in cells) for i in range(len(names))]
    return "\n".join("  ".join(t.rjust(w) for t, w in zip(line, widths, strict=True)) for line in cells)


def _terminal_columns(rows: Sequence[Mapping[str, Any]], n_scores: int) -> list[str]:
    """What a row is, and the scores that are looked at first; they begin behind the counts."""
    names = [name for name in dict.fromkeys(n for row in rows for n in row) if not name.endswith("_sd")]
    counts = [names.index(name) + 1 for name in ("n_failed", "n_persons") if name in names]
    at = max(counts, default=len(names))
    scores = sorted(names[at:], key=lambda name: name not in _FIRST_SCORES)
    return names[:at] + scores[:n_scores]


def page(
    title: str, table: Sequence[Mapping[str, Any]], summary: Sequence[Mapping[str, Any]], over: Sequence[str]
) -> str:
    """One self-contained HTML page; text of the user is escaped."""
    failed = sum(row["status"] == "failed" for row in table)
    words = f"{len(table)} cells" + (f", {failed} failed" if failed else "")
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        f"<title>{html.escape(title)}</title><style>"
        "body{font:15px/1.5 system-ui,sans-serif;margin:2rem;color:#222}"
        "table{border-collapse:collapse;font-variant-numeric:tabular-nums;margin-bottom:2rem}"
        "th,td{padding:.2rem .7rem;text-align:right;border-bottom:1px solid #ddd}"
        "th{position:sticky;top:0;background:#f4f4f4}.failed td{background:#fdecea}"
        "</style></head><body>"
        f"<h1>{html.escape(title)}</h1><p>{words}.</p>"
        f"<h2>Means over {html.escape(' and '.join(over))}</h2>{_html_table(summary)}"
        f"<h2>Every cell</h2>{_html_table(table)}</body></html>\n"
    )


def _html_table(rows: Sequence[Mapping[str, Any]]) -> str:
    names = list(dict.fromkeys(name for row in rows for name in row))
    head = "".join(_head_cell(name) for name in names)
    lines = []
    for row in rows:
        kind = ' class="failed"' if row.get("status") == "failed" else ""
        cells = "".join(f"<td>{html.escape(_short(row.get(name)))}</td>" for name in names)
        lines.append(f"<tr{kind}>{cells}</tr>")
    return f"<table><thead><tr>{head}</tr></thead><tbody>\n" + "\n".join(lines) + "\n</tbody></table>"


def _head_cell(name: str) -> str:
    """The head of a column; what a score means is shown when the pointer rests on it."""
    hint = f' title="{html.escape(score_hint(name))}"' if name in CATALOGUE else ""
    return f"<th{hint}>{html.escape(name)}</th>"


def _short(value: Any) -> str:
    return f"{value:.4g}" if isinstance(value, float) else cell_text(value)


def _status(row: Row) -> str:
    return "done" if row.outcome.is_done else "failed"


def _flat_row(row: Row, names: Sequence[str]) -> dict[str, Any]:
    result = row.outcome.result or {}
    return {
        **row.columns,
        "status": _status(row),
        "n_frames": result.get("n_frames"),
        "n_persons": result.get("n_persons"),
        **{name: row.scores.get(name) for name in names},
        "error": row.outcome.error,
    }


def _without_times(outcome: Outcome) -> dict[str, Any]:
    return {k: v for k, v in (outcome.result or {}).items() if k not in ("timings_s", "peak_memory_mb")}


def _times(row: Row) -> dict[str, Any]:
    """Seconds of a cell and of each stage that ran in it, and what its process needed; shared stages ran elsewhere."""
    result = row.outcome.result or {}
    stages = {f"{stage}_s": seconds for stage, seconds in result.get("timings_s", {}).items()}
    peak = {"peak_memory_mb": result.get("peak_memory_mb")}
    return {**row.columns, "total_s": round(row.outcome.seconds, 3), **stages, **peak}
