"""Draw the rooms of the code and who imports whom, and write the table of rooms, both read from the source.

From the checkout: python -m docs.make_architecture            # write docs/pictures/architecture.png and the table
                   python -m docs.make_architecture --check    # exit with 1 when the table is out of step
"""

from __future__ import annotations

import ast
import itertools
import sys
from functools import cache
from graphlib import TopologicalSorter
from pathlib import Path

import numpy as np

from tests.test_architecture import EVERYBODYS, imports_of, mocap_files, package_of

ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / "docs" / "architecture.md"
PICTURE = ROOT / "docs" / "pictures" / "architecture.png"
BEGIN, END = "<!-- rooms -->", "<!-- end of rooms -->"
# Doors: they belong to no floor.
_DOORS = ("", "__main__", *EVERYBODYS)


def arrows() -> dict[str, set[str]]:
    """Room -> rooms that a file of it imports, at any depth."""
    rooms = {package_of(path) for path in mocap_files()}
    found: dict[str, set[str]] = {room: set() for room in rooms}
    for path in mocap_files():
        own = package_of(path)
        dotted = ".".join(path.relative_to(ROOT).parent.parts)
        for item in imports_of(ast.parse(path.read_text("utf-8")), dotted):
            top, *rest = item.module.split(".")
            if top == "mocap" and rest and rest[0] in rooms - {own}:
                found[own].add(rest[0])
    return {room: below - set(_DOORS) for room, below in found.items() if room not in _DOORS}


def floors(graph: dict[str, set[str]]) -> dict[str, int]:
    """Room -> floor: 0 imports no room, every other one is above all that it imports. CycleError for a circle."""
    floor: dict[str, int] = {}
    for room in TopologicalSorter(graph).static_order():
        floor[room] = 1 + max((floor[below] for below in graph[room]), default=-1)
    return floor


def needed(graph: dict[str, set[str]]) -> set[tuple[str, str]]:
    """The arrows that do not follow from others: an arrow is left out when a longer way leads to the same room."""

    @cache
    def reach(room: str) -> frozenset[str]:
        return frozenset(graph[room]).union(*(reach(below) for below in graph[room]))

    return {
        (room, below)
        for room, all_below in graph.items()
        for below in all_below
        if not any(below in reach(other) for other in all_below - {below})
    }


def purpose(room: str) -> str:
    """First sentence of a room's docstring, without the closing stop."""
    folder = ROOT / "mocap" / room
    file = folder / "__init__.py" if folder.is_dir() else folder.with_suffix(".py")
    text = ast.get_docstring(ast.parse(file.read_text("utf-8"))) or ""
    return text.partition("\n")[0].rstrip(".")


def table(graph: dict[str, set[str]]) -> str:
    """The rooms from the top floor down, with what they hold and import."""
    floor_of = floors(graph)
    lines = ["| floor | room | what it is | imports |", "|---|---|---|---|"]
    for room in sorted(graph, key=lambda r: (-floor_of[r], r)):
        below = ", ".join(sorted(graph[room], key=lambda r: (-floor_of[r], r))) or "-"
        where = f"mocap/{room}/" if (ROOT / "mocap" / room).is_dir() else f"mocap/{room}.py"
        lines.append(f"| {floor_of[room]} | `{where}` | {purpose(room)} | {below} |")
    return "\n".join(lines)


# A stop of an arrow on a floor: a room, or (from, to, floor) where the arrow passes between the rooms.
Stop = str | tuple[str, str, int]


def draw(graph: dict[str, set[str]], path: Path) -> None:
    """Rooms as boxes on their floors, the needed arrows between them."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    floor_of = floors(graph)
    ways = [_way(room, below, floor_of) for room, below in sorted(needed(graph))]
    at = _places(graph, floor_of, ways)
    n_floors = max(floor_of.values()) + 1
    figure, axes = plt.subplots(figsize=(12, n_floors + 0.4), dpi=110)
    for way in ways:
        x, y = np.array([at[stop] for stop in way], dtype=np.float64).T
        y[0] -= 0.2
        y[-1] += 0.2
        axes.plot(x[:-1], y[:-1], color="#7a8794", lw=1.1)
        arrow = {"arrowstyle": "-|>", "color": "#7a8794", "lw": 1.1, "shrinkA": 0, "shrinkB": 0}
        axes.annotate("", (x[-1], y[-1]), (x[-2], y[-2]), arrowprops=arrow)
    for room in graph:
        box = {"boxstyle": "round,pad=0.38", "fc": "#e8eef5", "ec": "#34495e"}
        axes.text(*at[room], room, ha="center", va="center", fontsize=11, bbox=box, zorder=3)
    axes.set_xlim(-0.02, 1.02)
    axes.set_ylim(-0.6, n_floors - 0.4)
    axes.axis("off")
    figure.savefig(path, bbox_inches="tight", pil_kwargs={"optimize": True})
    plt.close(figure)


def _way(room: str, below: str, floor_of: dict[str, int]) -> list[Stop]:
    """An arrow's stops from the upper room to the lower one, one on each floor."""
    between = range(floor_of[room] - 1, floor_of[below], -1)
    return [room, *((room, below, floor) for floor in between), below]


def _places(
    graph: dict[str, set[str]], floor_of: dict[str, int], ways: list[list[Stop]]
) -> dict[Stop, tuple[float, float]]:
    """Stop -> (x, y); within a floor ordered by the middle of what is joined to it, so that few arrows cross."""
    rows: list[list[Stop]] = [
        [r for r in sorted(graph) if floor_of[r] == k] for k in range(max(floor_of.values()) + 1)
    ]
    joined: dict[Stop, list[Stop]] = {room: [] for room in graph}
    for way in ways:
        for stop in way[1:-1]:
            rows[stop[2]].append(stop)  # type: ignore[misc]
            joined[stop] = []
        for a, b in itertools.pairwise(way):
            joined[a].append(b)
            joined[b].append(a)
    x: dict[Stop, float] = {s: (i + 0.5) / len(row) for row in rows for i, s in enumerate(row)}
    for _ in range(30):
        for row in [*rows, *rows[::-1]]:
            row.sort(key=lambda s: sum(x[o] for o in joined[s]) / max(len(joined[s]), 1))
            x |= {s: (i + 0.5) / len(row) for i, s in enumerate(row)}
    return {stop: (x[stop], float(y)) for y, row in enumerate(rows) for stop in row}


def main() -> int:
    """Write the picture and the table, or compare the table."""
    graph = arrows()
    page = PAGE.read_text("utf-8")
    before, _, rest = page.partition(BEGIN)
    _, _, after = rest.partition(END)
    written = f"{before}{BEGIN}\n{table(graph)}\n{END}{after}"
    if "--check" in sys.argv[1:]:
        print("in step" if written == page else "out of step: python -m docs.make_architecture")
        return int(written != page)
    PAGE.write_text(written, "utf-8")
    draw(graph, PICTURE)
    return 0


if __name__ == "__main__":
    sys.exit(main())
