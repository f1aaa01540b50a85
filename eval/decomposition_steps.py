"""Why the annealed filters lead: is it the narrower walk of their second layer?

An annealed filter of two layers walks twice in a frame, by the full and by 0.71 of the noise. Here SBPS and PFCR walk
by 0.5 and 0.71 of it too (SBPS by 1.41 as well), and APF by 0.5, 0.71 and 1.41; with 1.41 its second step is as wide as
the only one of the others.
Writes eval/results/decomposition_steps.csv and decomposition_steps_ranking.csv.

    python -m eval.decomposition_steps [--full] [--workers 2]

--quick (default): 3 scenes x 2 runs of 150 frames per cell, N = 300; about 5 minutes on one core after
eval.decomposition_sharpness.  --full: 5 scenes x 4 runs of 300 frames, N = 50 and 300; about 1 hour.
Nothing is published.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence

from eval.decomposition.cells import STEP_WIDTHS, Cell, RunKey, SceneKey
from eval.decomposition.store import Row
from eval.decomposition.tables import LABELS, Seeds, Table, parse_seeds, run_tables, summary

# Filter, layers, and its walks in percent; 100 is the world "sw".
METHODS = (("sbps", 1, (100, *STEP_WIDTHS)), ("pfcr", 1, (100, 50, 71)), ("psapf", 2, (100, *STEP_WIDTHS)))


def _name_of(row: Row) -> str:
    return f"{LABELS[row['filter']]} x {int(row['world'].partition('_')[2] or 100) / 100:g}"


def steps_table(seeds: Seeds) -> Table:
    """Four arms, K = 3 and 7."""
    cells: list[Cell] = []
    for n_levels in (3, 7):
        for n in (50, 300) if seeds.is_full else (300,):
            for method, n_layers, widths in METHODS:
                for percent in widths:
                    world = "sw" if percent == 100 else f"step_{percent}"
                    cells += seeds.cells(SceneKey(world, 4, n_levels), RunKey(method, n, n_layers))
    narrow = [f"{LABELS[method]} x {factor}" for method in ("sbps", "pfcr") for factor in (0.5, 0.71)]
    pairs = [
        *((name, f"{name.split()[0]} x 1") for name in narrow),
        *((name, "APF x 1") for name in narrow),
        *((f"APF x {factor}", "APF x 1") for factor in (0.5, 0.71, 1.41)),
        ("APF x 1.41", "SBPS x 1"),
        ("SBPS x 1.41", "SBPS x 1"),
    ]
    orders = [(better, worse, float("nan")) for better, worse in pairs]
    return Table("Steps", cells, ("n_levels", "n_evaluations"), lambda cell: orders, {}, _name_of)


def main(argv: Sequence[str] | None = None) -> None:
    """Run the table."""
    seeds = parse_seeds(__doc__, argv)
    sys.stdout.write(summary(run_tables("steps", [steps_table(seeds)], seeds)) + "\n")


if __name__ == "__main__":
    main()
