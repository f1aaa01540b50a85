"""A board on paper: one PDF page with the board, what it is, and a ruler that shows whether the printer scaled it."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

from mocap.calibrate.board import Board
from mocap.errors import MocapError

# Width and height upright, mm.
PAPERS = {
    "a4": (210.0, 297.0),
    "a3": (297.0, 420.0),
    "a2": (420.0, 594.0),
    "a1": (594.0, 841.0),
    "a0": (841.0, 1189.0),
    "letter": (215.9, 279.4),
    "tabloid": (279.4, 431.8),
}
# White around the board, which detectors need and printers cannot use; below it the ruler.
_MARGIN_MM, _FOOT_MM = 10.0, 16.0
_RULER_MM = 100.0
_ROUNDING = 1e-6
_MM_PER_INCH = 25.4


def largest_side_mm(board: Board, paper: str) -> int:
    """Largest side of a square or tag with which a board fits on a paper, whole mm; 0 = none."""
    across, down = (size / board.side_m for size in board.size_m)
    return max(
        math.floor(min((w - 2 * _MARGIN_MM) / across, (h - 2 * _MARGIN_MM - _FOOT_MM) / down) + _ROUNDING)
        for w, h in _both_ways(paper)
    )


def write_board(path: Path, board: Board, paper: str) -> None:
    """Print a board to a PDF of one page, upright or across, whichever fits.

    Raises MocapError when it does not fit.
    """
    from matplotlib.backends.backend_pdf import FigureCanvasPdf
    from matplotlib.collections import PatchCollection
    from matplotlib.figure import Figure
    from matplotlib.patches import Rectangle

    width, height = (1000 * size for size in board.size_m)
    fitting = [
        (w, h)
        for w, h in _both_ways(paper)
        if width <= w - 2 * _MARGIN_MM + _ROUNDING and height <= h - 2 * _MARGIN_MM - _FOOT_MM + _ROUNDING
    ]
    if not fitting:
        raise MocapError(
            f"the board ({board}, {width:.0f} x {height:.0f} mm) does not fit on {paper}",
            remedy=f"write --square-mm {largest_side_mm(board, paper)}, or choose a larger --paper",
        )
    w, h = fitting[0]
    figure = Figure(figsize=(w / _MM_PER_INCH, h / _MM_PER_INCH))
    FigureCanvasPdf(figure)
    ax = figure.add_axes((0, 0, 1, 1))
    ax.set_xlim(0, w)
    ax.set_ylim(h, 0)
    ax.axis("off")
    left, top = (w - width) / 2, _MARGIN_MM + (h - 2 * _MARGIN_MM - _FOOT_MM - height) / 2
    squares = [Rectangle((left + x, top + y), across, down) for x, y, across, down in 1000 * board.black]
    # Without a stroke: squares of the stated size, neither wider nor narrower.
    ax.add_collection(PatchCollection(squares, facecolor="black", linewidth=0, antialiased=False))
    _add_foot(ax, board, w, h)
    try:
        figure.savefig(path, format="pdf", metadata={"CreationDate": None, "Producer": None, "Creator": None})
    except OSError as error:
        raise MocapError(
            f"the board cannot be written: {error.strerror or error}",
            path=path,
            remedy="choose a folder that exists and is writable",
        ) from error


def _add_foot(ax: Any, board: Board, w: float, h: float) -> None:
    """What it is and how it is given to `mocap calibrate`, beside a ruler of 100 mm."""
    y = h - _MARGIN_MM - 4
    x = w - _MARGIN_MM - _RULER_MM
    for mm in range(0, int(_RULER_MM) + 1, 10):
        ax.plot([x + mm, x + mm], [y, y - (4 if mm % 50 == 0 else 2)], color="black", lw=0.5)
    ax.plot([x, x + _RULER_MM], [y, y], color="black", lw=0.5)
    text = f"--board {board.kind}:{board.columns}x{board.rows} --square-mm {1000 * board.side_m:g}"
    ax.text(x, y + 4, "100 mm: measure it; print at 100 %", fontsize=6, va="center")
    ax.text(_MARGIN_MM, y, text, fontsize=7, va="center", family="monospace")


def _both_ways(paper: str) -> list[tuple[float, float]]:
    w, h = PAPERS[paper]
    return [(w, h), (h, w)]
