"""Result files appear whole or not at all: written beside their place, then moved there."""

from __future__ import annotations

import csv
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mocap.io.formats._writing import replacing

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def write_csv(path: Path, fields: Sequence[str], rows: Iterable[Mapping[str, Any]]) -> None:
    """A CSV with a header and one line per row.

    Rows may come from a computation: when it breaks off, or a row has a field that is not in `fields` (ValueError), the
    file stays as it was.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    with replacing(path) as part, part.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.DictWriter(stream, fields, lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)


def write_text(path: Path, text: str) -> None:
    """A page or a tree."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with replacing(path) as part:
        part.write_text(text, encoding="utf-8")


def save_figure(figure: Figure, path: Path, *, dpi: float | None = None) -> None:
    """A PNG; dpi : None = the figure's own."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with replacing(path) as part:
        figure.savefig(part, format="png", dpi=dpi or "figure")
