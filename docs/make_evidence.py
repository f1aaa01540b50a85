"""What evidence is worth: tables of docs/evidence.md and docs/keypoints.md, and docs/pictures/evidence.png.

    python -m docs.make_evidence

The numbers are those of eval/results/ (`python -m eval.evidence`), means over seeds.
"""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from eval.evidence import RESULTS
from eval.whole import save_figure, with_table
from mocap.arrays import Array
from mocap.view.plotting import LINE_COLOURS, LINE_STYLES, finish, new_figure

HERE = Path(__file__).parent
PAGE, KEYPOINTS_PAGE, PICTURE = (
    HERE / "evidence.md",
    HERE / "keypoints.md",
    HERE / "pictures" / "evidence.png",
)
WORDS = {
    "triangulation": "plain triangulation",
    "keypoints": "keypoints alone",
    "volumes": "volumes alone",
    "fused": "volumes and keypoints",
    "fused_depth": "both and depth of one",
}
METHODS = tuple(WORDS)
TITLES = {
    "clean": "clean",
    "furnished": "furnished",
    "camouflage": "camouflage",
    "no_empty_clip": "no empty clip",
    "two_persons": "two persons",
    "walk": "`walk`",
    "reach": "`reach`, arms before the trunk",
    "cross": "`cross`, a grey shirt before grey walls",
    "room": "`room`, two persons",
    "keypoints_gesture_test": "`keypoints_gesture_test`, shirt and skin of the room's colours",
    "keypoints_pair_test": "`keypoints_pair_test`, two walkers",
}
RAW, AFTER = "mean_error_mm", "mean_error_after_offset_mm"
Row = dict[str, str]
Cell = tuple[Row, ...]  # the seeds of a session, a number of cameras and a method


def rows(table: str = "evidence.csv") -> list[Row]:
    """The rows of a table."""
    with (RESULTS / table).open(encoding="utf-8", newline="") as stream:
        return list(csv.DictReader(stream))


def cells(found: Sequence[Row]) -> dict[tuple[str, int], dict[str, Cell]]:
    """Session and number of cameras -> method -> its rows."""
    out: dict[tuple[str, int], dict[str, Cell]] = {}
    for row in found:
        own = out.setdefault((row["session"], int(row["cameras"])), {})
        own[row["method"]] = (*own.get(row["method"], ()), row)
    return out


def errors(cell: Cell, field: str) -> Array:
    """Errors of the seeds in which somebody was found, mm."""
    return np.array([float(row[field]) for row in cell if row[field]])


def errors_table(found: Sequence[Row], methods: Sequence[str] = METHODS) -> str:
    """Raw errors with their range, in brackets after offsets, and how many persons were found where one was not."""
    lines = [
        f"| session | cameras | {' | '.join(WORDS[m] for m in methods)} |",
        "|---|---" + "|---" * len(methods) + "|",
    ]
    for (session, cameras), own in cells(found).items():
        most = max(int(r["found"]) for cell in own.values() for r in cell)
        texts = [_cell(own[m], most) if m in own else "" for m in methods]
        lines.append(f"| {TITLES[session]} | {cameras} | {' | '.join(texts)} |")
    return "\n".join(lines)


def _cell(cell: Cell, n_persons: int) -> str:
    raw, after = errors(cell, RAW), errors(cell, AFTER)
    if not len(raw):
        return "nobody found"
    n_missed = sum(n_persons - int(row["found"]) for row in cell)
    missed = f", {n_missed} of {n_persons * len(cell)} not found" if n_missed else ""
    share = np.mean([float(row["mmta_percent"]) for row in cell])
    least, most = f"{raw.min():.0f}", f"{raw.max():.0f}"
    span = f", {least} to {most}" if least != most else ""
    return f"{raw.mean():.1f} ({after.mean():.1f}){span}; {share:.0f} %{missed}"


def gains_table(found: Sequence[Row]) -> str:
    """How the error changes from one kind of evidence to another, %, over the seeds in which both find as many."""
    pairs = (
        ("keypoints", "triangulation"),
        ("fused", "keypoints"),
        ("fused", "volumes"),
        ("fused_depth", "fused"),
    )
    lines = [
        "| session | cameras | " + " | ".join(f"{WORDS[a]} for {WORDS[b]}" for a, b in pairs) + " |",
        "|---|---" + "|---" * len(pairs) + "|",
    ]
    for (session, cameras), own in cells(found).items():
        texts = [_gain(own.get(a, ()), own.get(b, ())) for a, b in pairs]
        lines.append(f"| {TITLES[session]} | {cameras} | {' | '.join(texts)} |")
    return "\n".join(lines)


def _gain(new: Cell, old: Cell) -> str:
    both = [(a, b) for a, b in zip(new, old, strict=False) if a["found"] == b["found"] and a[RAW] and b[RAW]]
    if not both:
        return ""
    raw, after = (
        100 * (sum(float(a[f]) for a, _ in both) / sum(float(b[f]) for _, b in both) - 1)
        for f in (RAW, AFTER)
    )
    return f"{raw:+.0f} ({after:+.0f}) %"


def times_table(found: Sequence[Row]) -> str:
    """Seconds of one core per frame: the median over the sessions."""
    numbers = sorted({int(r["cameras"]) for r in found})
    lines = [
        f"| cameras | {' | '.join(WORDS[m] for m in METHODS)} |",
        "|---" + "|---" * len(METHODS) + "|",
    ]
    for n in numbers:
        own = {
            m: [float(r["cpu_ms_per_frame"]) for r in found if (int(r["cameras"]), r["method"]) == (n, m)]
            for m in METHODS
        }
        cells = [f"{np.median(own[m]) / 1000:.2f}" if own[m] else "" for m in METHODS]
        lines.append(f"| {n} | {' | '.join(cells)} |")
    return "\n".join(lines)


def tables_of(page: Path) -> dict[str, str]:
    """The tables of a page, by the name of their place."""
    if page == KEYPOINTS_PAGE:
        of = {
            "alone": ("keypoints.csv", METHODS[:2]),
            "beside volumes": ("keypoints_fused.csv", METHODS[2:4]),
        }
        return {name: errors_table(rows(table), methods) for name, (table, methods) in of.items()}
    found = rows()
    return {"errors": errors_table(found), "gains": gains_table(found), "times": times_table(found)}


def written(page: str, tables: Mapping[str, str]) -> str:
    """A page with tables in their places."""
    for name, table in tables.items():
        page = with_table(page, name, table)
    return page


def draw(found: Sequence[Row]) -> Any:
    """Errors over cameras, a panel for each session; the mean over seeds, and their range as a bar."""
    by_case = cells(found)
    sessions = list(dict.fromkeys(session for session, _ in by_case))
    n_columns = 3
    figure, panels = new_figure(-(-len(sessions) // n_columns), height=1.7, width=8.2, n_columns=n_columns)
    for ax in panels[len(sessions) :]:
        ax.axis("off")
    for k, (ax, session) in enumerate(zip(panels, sessions, strict=False)):
        for i, method in enumerate(METHODS):
            own = {n: errors(case.get(method, ()), RAW) for (s, n), case in by_case.items() if s == session}
            x = np.array([n for n, raw in own.items() if len(raw)])
            y = np.array([(raw.mean(), raw.min(), raw.max()) for raw in own.values() if len(raw)]).T
            if len(x):
                # Methods beside each other, so that their bars can be told apart.
                ax.errorbar(x + 0.08 * (i - 2), y[0], yerr=(y[0] - y[1], y[2] - y[0]),
                            ls=LINE_STYLES[i % len(LINE_STYLES)], marker="o", ms=3, lw=1.3, elinewidth=0.8,
                            color=LINE_COLOURS[i], label=WORDS[method])  # fmt: skip
        ax.set_yscale("log")
        ticks = [10, 15, 20, 30, 50, 100, 200]
        low, high = ax.get_ylim()
        ax.set_yticks([t for t in ticks if low <= t <= high], [f"{t}" for t in ticks if low <= t <= high])
        ax.minorticks_off()
        ax.set_xticks([2, 3, 4, 5, 7])
        finish(ax, TITLES[session], "cameras", "mm", legend=k == n_columns - 1, small=True)
    return figure


def main() -> None:
    """Write tables and picture."""
    for page in (PAGE, KEYPOINTS_PAGE):
        page.write_text(written(page.read_text(encoding="utf-8"), tables_of(page)), encoding="utf-8")
    save_figure(draw(rows()), PICTURE)


if __name__ == "__main__":
    main()
