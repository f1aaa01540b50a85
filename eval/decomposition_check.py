"""Are the kept cells of the decomposition tables still what today's code gives?

Cells are kept by what they are, not by the code that made them: committed ones in
eval/results/decomposition_*_cells.csv, those of this machine in out/eval/decomposition/cells.csv. This computes one
cell again for every world and filter, the cheapest, and compares to the last digit.

    python -m eval.decomposition_check

About two minutes on one core. Exits with 1 when a cell differs: then its world and filter must be run again, from a
store without them; and when there is no cell at all, because nothing was checked then.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterable, Sequence
from pathlib import Path

from eval.decomposition.cells import VALUE_FIELDS, Cell, RunKey, SceneKey, run_scene
from eval.decomposition.store import Row, known_rows, read_rows


def cell_of(row: Row) -> Cell:
    """The cell of a CSV row."""
    scene = SceneKey(
        row["world"],
        *(int(row[f]) for f in ("n_arms", "n_levels", "n_objects", "n_clutter", "scene_seed", "n_frames")),
    )
    layers, evaluations, seed = (int(row[f]) for f in ("n_layers", "n_evaluations", "run_seed"))
    return Cell(
        scene, RunKey(row["filter"], evaluations, layers, row["resampling"], row["is_split"] == "True", seed)
    )


def cheapest(rows: Iterable[Row]) -> list[Row]:
    """Of every world and filter the finished row that took least time."""
    found: dict[tuple[str, ...], Row] = {}

    def cost(row: Row) -> float:
        return float(row["step_ms"]) * (int(row["n_frames"]) or 300)

    for row in rows:
        key = (row["world"], row["filter"], row["is_split"])
        if row["status"] == "ok" and (key not in found or cost(row) < cost(found[key])):
            found[key] = row
    return list(found.values())


def differences(rows: Sequence[Row]) -> list[tuple[Row, str]]:
    """Rows whose error comes out otherwise today, and what comes out."""
    found = []
    for row in rows:
        cell = cell_of(row)
        again = run_scene(cell.scene, [cell.run])[0]
        if again[VALUE_FIELDS[0]] != row[VALUE_FIELDS[0]]:
            found.append((row, again[VALUE_FIELDS[0]] or again["status"]))
    return found


def main(argv: Sequence[str] | None = None) -> int:
    """Compare; 1 when a cell differs."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--store", type=Path, help="this file alone instead of all kept cells")
    store = parser.parse_args(argv).store
    rows = cheapest((read_rows(store) if store else known_rows()).values())
    if not rows:
        sys.stderr.write("there is no cell to check\n")
        return 1
    changed = differences(rows)
    for row, now in changed:
        sys.stdout.write(f"{row['world']}, {row['filter']}: {row['error_px']} px kept, {now} px today\n")
    sys.stdout.write(f"{len(rows) - len(changed)} of {len(rows)} worlds and filters as kept\n")
    return 1 if changed else 0


if __name__ == "__main__":
    sys.exit(main())
