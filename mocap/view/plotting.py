"""Building blocks of plots: figure, house style of the axes, notes, legends, colours and the picture as PNG bytes.

matplotlib is imported when the first plot is made, and used through its objects only (`Figure` with an Agg
canvas): no window, no global state, safe in threads. Colours are told apart with every common colour vision,
and lines also differ in style, so that a grey print stays readable.
"""

from __future__ import annotations

from io import BytesIO
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mocap.view.overlay import Colour

Frames = NDArray[np.integer]

LINE_COLOURS: tuple[str, ...] = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#555555")
LINE_STYLES: tuple[str, ...] = ("-", "--", ":", "-.")
INK = "#22262b"
FAINT = "#d9dde2"
_DPI = 120
_MAX_LEGEND = 8


def new_figure(
    n_rows: int, *, height: float, width: float = 9.0, n_columns: int = 1
) -> tuple[Any, list[Any]]:
    """A white figure and its axes, row by row; height is inches per row."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(
        figsize=(width, 0.35 + height * n_rows), dpi=_DPI, layout="constrained", facecolor="white"
    )
    FigureCanvasAgg(figure)
    axes = figure.subplots(n_rows, n_columns, squeeze=False)
    return figure, list(axes.ravel())


def finish(
    ax: Any, title: str, x: str, y: str, *, legend: bool = False, grid: str = "y", small: bool = False
) -> None:
    """The house style of one pair of axes: few lines, dark ink, a faint grid."""
    size = 8 if small else 10
    for side in ("top", "right"):
        ax.spines[side].set_visible(False)
    for side in ("left", "bottom"):
        ax.spines[side].set_color("#8a939e")
    ax.tick_params(labelsize=size - 1, colors=INK, color="#8a939e", length=3)
    ax.set_axisbelow(True)
    ax.grid(axis=grid, color=FAINT, lw=0.7)
    if title:
        ax.set_title(title, fontsize=size + 0.5, loc="left", color=INK, fontweight="bold")
    ax.set_xlabel(x, fontsize=size, color=INK)
    ax.set_ylabel(y, fontsize=size, color=INK)
    handles, labels = ax.get_legend_handles_labels()
    if legend and handles:
        columns = 1 if len(handles) <= _MAX_LEGEND else 2
        ax.legend(handles[: 2 * _MAX_LEGEND], labels[: 2 * _MAX_LEGEND], fontsize=size - 1, ncols=columns,
                  loc="center left", bbox_to_anchor=(1.0, 0.5), frameon=False)  # fmt: skip


def note(ax: Any, text: str, at: Any, offset_pt: tuple[float, float], **style: Any) -> None:
    """Small text beside a point of the plot."""
    ax.annotate(text, at, offset_pt, textcoords="offset points", fontsize=8.5, color=INK, **style)


def marker_of(frames: Frames) -> str:
    """A single instant has no line to see: mark its points."""
    return "o" if len(frames) < 3 else ""


def empty(ax: Any, text: str) -> None:
    """A sentence in place of a plot."""
    ax.text(0.5, 0.5, text, transform=ax.transAxes, ha="center", va="center", color="#6b7480", fontsize=11)
    ax.set_xticks([])
    ax.set_yticks([])


def hex_colour(colour: Colour) -> str:
    """`#rrggbb` of a colour."""
    return "#{:02x}{:02x}{:02x}".format(*colour)


def words(name: str) -> str:
    """A name of the code as words."""
    return str(name).replace("_", " ")


def png(figure: Any) -> bytes:
    """The figure as the bytes of a PNG file, without the version of the program in it."""
    buffer = BytesIO()
    figure.savefig(buffer, format="png", metadata={"Software": None})
    return buffer.getvalue()


def inner_legend(ax: Any, where: str) -> None:
    """A legend inside the axes.  where : as matplotlib names the places."""
    ax.legend(fontsize=8.5, loc=where, frameon=True, framealpha=0.85, edgecolor="none")
