"""Result files appear whole or not at all: written beside their place, then moved there."""

from __future__ import annotations

import csv
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mocap.io.formats._writing import replacing
from mocap.pipeline.reach import code_hash

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_N_COLOURS = 64


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


def kept_rows(
    path: Path, fields: Sequence[str], make: Callable[[], Iterable[Mapping[str, Any]]], *, again: bool
) -> list[dict[str, str]]:
    """Rows of an earlier call of the same program, or new ones, which are kept and told.  again : make them anew."""
    kept = of_this_program(path)
    if again or not kept.exists():
        write_csv(kept, fields, make())
    with kept.open(encoding="utf-8", newline="") as stream:
        rows = list(csv.DictReader(stream))
    sys.stdout.write("\n".join(" ".join(f"{k}={v}" for k, v in row.items()) for row in rows) + "\n")
    sys.stdout.flush()
    return rows


def of_this_program(path: Path) -> Path:
    """Where is kept what the package as it is has found: rows of two versions must not meet in a table."""
    return path.with_stem(f"{path.stem}-{code_hash()}")


def with_table(page: str, name: str, table: str) -> str:
    """A page with a table in its place, which is between `<!-- name -->` and `<!-- end of name -->`."""
    begin, end = f"<!-- {name} -->\n", f"<!-- end of {name} -->"
    before, _, rest = page.partition(begin)
    return f"{before}{begin}{table}\n{end}{rest.partition(end)[2]}"


def save_figure(figure: Figure, path: Path, *, dpi: float | None = None) -> None:
    """A PNG of few colours, as drawings have them: a third of the size.  dpi : None = the figure's own."""
    from PIL import Image

    path.parent.mkdir(parents=True, exist_ok=True)
    drawn = BytesIO()
    figure.savefig(drawn, format="png", dpi=dpi or "figure")
    with replacing(path) as part, Image.open(drawn) as picture:
        picture.convert("RGB").quantize(_N_COLOURS).save(part, format="PNG", optimize=True)
