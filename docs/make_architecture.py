"""Draw the rooms of the code and who imports whom, and write the table of rooms, both read from the source.

From the checkout: python -m docs.make_architecture            # write docs/pictures/architecture.png and the table
                   python -m docs.make_architecture --check    # exit with 1 when the table is out of step
"""

from __future__ import annotations

import ast
import sys
from functools import cache
from graphlib import TopologicalSorter
from pathlib import Path

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


def draw(graph: dict[str, set[str]], path: Path) -> None:
    """Rooms as boxes on their floors, the needed arrows between them."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    floor_of = floors(graph)
    rows = [sorted(r for r in graph if floor_of[r] == k) for k in range(max(floor_of.values()) + 1)]
    at = _places(rows, needed(graph))
    figure, axes = plt.subplots(figsize=(12, 1.0 * len(rows) + 0.4), dpi=110)
    for room, below in sorted(needed(graph)):
        (x0, y0), (x1, y1) = at[room], at[below]
        axes.annotate(
            "",
            (x1, y1 + 0.2),
            (x0, y0 - 0.2),
            arrowprops={"arrowstyle": "-|>", "color": "#7a8794", "lw": 1.1, "shrinkA": 0, "shrinkB": 0},
        )
    for room, (x, y) in at.items():
        box = {"boxstyle": "round,pad=0.38", "fc": "#e8eef5", "ec": "#34495e"}
        axes.text(x, y, room, ha="center", va="center", fontsize=11, bbox=box, zorder=3)
    axes.set_xlim(-0.06, 1.06)
    axes.set_ylim(-0.6, len(rows) - 0.4)
    axes.axis("off")
    figure.savefig(path, bbox_inches="tight", pil_kwargs={"optimize": True})
    plt.close(figure)


def _places(rows: list[list[str]], pairs: set[tuple[str, str]]) -> dict[str, tuple[float, float]]:
    """Room -> (x, y); within a floor ordered by the middle of what is joined to it, so that few arrows cross."""
    order = {room: (i + 0.5) / len(row) for row in rows for i, room in enumerate(row)}
    for _ in range(20):
        for row in [*rows, *rows[::-1]]:
            joined = {
                room: [order[b if a == room else a] for a, b in pairs if room in (a, b)] or [order[room]]
                for room in row
            }
            ranked = sorted(row, key=lambda r: sum(joined[r]) / len(joined[r]))
            order |= {room: (i + 0.5) / len(row) for i, room in enumerate(ranked)}
    return {room: (order[room], float(y)) for y, row in enumerate(rows) for room in row}


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
