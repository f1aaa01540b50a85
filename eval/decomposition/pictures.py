"""Errors over a swept quantity, ours and the published ones, as one PNG per script."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from eval.decomposition.store import RESULTS
from eval.decomposition.tables import Table, read_csv
from eval.whole import save_figure

COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#555555")
STYLES = ("-", "--", "-.", ":")
_AXES = {
    "world": "lambda",
    "n_levels": "K",
    "n_arms": "|P_j|",
    "n_layers": "layers L",
    "n_clutter": "polygons of clutter",
    "n_evaluations": "N",
}


def picture_of(
    name: str, tables: Sequence[Table], *, value: str = "error_px", out: Path | None = None
) -> Path:
    """eval/results/decomposition_NAME.png: a panel per table and value of its other fields.

    Bars are standard deviations over runs and scenes, crosses the published numbers. A log axis: the methods differ by
    factors.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    panels = [p for table in tables for p in _panels(name, table)]
    n_columns = min(3, len(panels))
    n_rows = -(-len(panels) // n_columns)
    figure = Figure(figsize=(3.6 * n_columns, 2.9 * n_rows), dpi=80, layout="constrained")
    FigureCanvasAgg(figure)
    for i, (title, x_name, methods) in enumerate(panels):
        axes = figure.add_subplot(n_rows, n_columns, i + 1)
        for k, (method, lines) in enumerate(methods.items()):
            x = [float(line["x"]) for line in lines]
            y = [float(line[value] or "nan") for line in lines]
            spread = [float(line["std_px"] or "nan") for line in lines] if value == "error_px" else None
            colour = COLOURS[k % len(COLOURS)]
            # A log axis has no room for a bar that reaches 0.
            bars = None if spread is None else np.array([np.minimum(spread, 0.7 * np.array(y)), spread])
            axes.errorbar(
                x,
                y,
                yerr=bars,
                color=colour,
                ls=STYLES[k % len(STYLES)],
                marker="o",
                ms=3,
                lw=1.4,
                capsize=2,
                elinewidth=0.7,
                label=method,
            )
            printed = [
                (a, float(line["published_px"]))
                for a, line in zip(x, lines, strict=True)
                if line["published_px"]
            ]
            if printed and value == "error_px":
                axes.plot(*zip(*printed, strict=True), ls="", marker="x", ms=6, mew=1.5, color=colour)
        axes.set_yscale("log")
        if x_name == "lambda":
            axes.set_xscale("log")
        points = sorted({float(line["x"]) for lines in methods.values() for line in lines})
        axes.set_xticks(points, [f"{x:g}" for x in points], minor=False)
        axes.set_title(title, fontsize=9)
        axes.set_xlabel(x_name, fontsize=8)
        axes.set_ylabel("error (px)" if value == "error_px" else "ms per frame", fontsize=8)
        axes.tick_params(labelsize=7, which="both")
        axes.grid(color="#d9dde2", lw=0.5, which="both")
        axes.legend(fontsize=6)
    path = out or RESULTS / f"decomposition_{name}.png"
    path.parent.mkdir(parents=True, exist_ok=True)
    save_figure(figure, path)
    return path


def _panels(name: str, table: Table) -> list[tuple[str, str, dict[str, list[dict[str, str]]]]]:
    """(title, axis, method -> lines in order of x) from the script's CSV."""
    panels: dict[str, dict[str, list[dict[str, str]]]] = {}
    for line in read_csv(RESULTS / f"decomposition_{name}.csv"):
        if line["table"] != table.name:
            continue
        cell = dict(item.split("=") for item in line["cell"].split(", "))
        x = cell.pop(table.x or "")
        if table.x == "world":
            x = x.partition("_")[2] or "50"
        title = ", ".join([table.name, *(f"{_AXES.get(k, k)}={v}" for k, v in cell.items())])
        panels.setdefault(title, {}).setdefault(line["method"], []).append(line | {"x": x})
    for methods in panels.values():
        for lines in methods.values():
            lines.sort(key=lambda line: float(line["x"]))
    return [(title, _AXES.get(table.x or "", ""), methods) for title, methods in panels.items()]
