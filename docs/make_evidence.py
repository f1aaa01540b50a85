"""What evidence is worth: the tables of docs/evidence.md and docs/pictures/evidence.png.

    python -m docs.make_evidence

The numbers are those of eval/results/evidence.csv (`python -m eval.evidence`).
"""

from __future__ import annotations

import csv
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from eval.evidence import RESULTS
from mocap.view.plotting import LINE_COLOURS, LINE_STYLES, finish, new_figure, png

HERE = Path(__file__).parent
PAGE, PICTURE = HERE / "evidence.md", HERE / "pictures" / "evidence.png"
BEGIN, END = "<!-- {} -->\n", "<!-- end of {} -->"
WORDS = {
    "triangulation": "plain triangulation",
    "keypoints": "keypoints alone",
    "volumes": "volumes alone",
    "fused": "volumes and keypoints",
}
METHODS = tuple(WORDS)
TITLES = {
    "clean": "clean",
    "furnished": "furnished",
    "camouflage": "camouflage",
    "no_empty_clip": "no empty clip",
    "two_persons": "two persons",
}
Row = dict[str, str]


def rows() -> list[Row]:
    """The rows of the table."""
    with (RESULTS / "evidence.csv").open(encoding="utf-8", newline="") as stream:
        return list(csv.DictReader(stream))


def errors_table(found: Sequence[Row]) -> str:
    """Raw errors, in brackets after offsets, and how many persons were found where one was not."""
    lines = [
        f"| session | cameras | {' | '.join(WORDS[m] for m in METHODS)} |",
        "|---|---" + "|---" * len(METHODS) + "|",
    ]
    for session, cameras in dict.fromkeys((r["session"], int(r["cameras"])) for r in found):
        own = {r["method"]: r for r in found if (r["session"], int(r["cameras"])) == (session, cameras)}
        most = max(int(r["found"]) for r in own.values())
        cells = [_cell(own[m], most) if m in own else "" for m in METHODS]
        lines.append(f"| {TITLES[session]} | {cameras} | {' | '.join(cells)} |")
    return "\n".join(lines)


def _cell(row: Row, n_persons: int) -> str:
    if not int(row["found"]):
        return "nobody found"
    raw, after = float(row["mean_error_mm"]), float(row["mean_error_after_offset_mm"])
    missing = "" if int(row["found"]) == n_persons else f", {row['found']} of {n_persons} found"
    return f"{raw:.1f} ({after:.1f}), {float(row['mmta_percent']):.0f} %{missing}"


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


def written(page: str, found: Sequence[Row]) -> str:
    """The page with both tables in their places."""
    for name, table in (("errors", errors_table(found)), ("times", times_table(found))):
        begin, end = BEGIN.format(name), END.format(name)
        before, _, rest = page.partition(begin)
        page = f"{before}{begin}{table}\n{end}{rest.partition(end)[2]}"
    return page


def draw(found: Sequence[Row]) -> bytes:
    """Errors over cameras, a panel for each session."""
    sessions = list(dict.fromkeys(r["session"] for r in found))
    n_columns = 3
    figure, panels = new_figure(-(-len(sessions) // n_columns), height=1.7, width=8.2, n_columns=n_columns)
    for ax in panels[len(sessions) :]:
        ax.axis("off")
    for k, (ax, session) in enumerate(zip(panels, sessions, strict=False)):
        for i, method in enumerate(METHODS):
            own = [
                r for r in found if (r["session"], r["method"]) == (session, method) and r["mean_error_mm"]
            ]
            x, y = [int(r["cameras"]) for r in own], [float(r["mean_error_mm"]) for r in own]
            if own:
                ax.plot(x, y, LINE_STYLES[i % len(LINE_STYLES)], marker="o", ms=3, lw=1.3,
                        color=LINE_COLOURS[i], label=WORDS[method])  # fmt: skip
        ax.set_yscale("log")
        ticks = [10, 15, 20, 30, 50, 100, 200]
        low, high = ax.get_ylim()
        ax.set_yticks([t for t in ticks if low <= t <= high], [f"{t}" for t in ticks if low <= t <= high])
        ax.minorticks_off()
        ax.set_xticks([2, 3, 4, 5, 7])
        finish(ax, TITLES[session], "cameras", "mm", legend=k == n_columns - 1, small=True)
    return png(figure)


def main() -> None:
    """Write tables and picture."""
    found = rows()
    PAGE.write_text(written(PAGE.read_text(encoding="utf-8"), found), encoding="utf-8")
    PICTURE.write_bytes(draw(found))


if __name__ == "__main__":
    main()
