"""Why the annealed filters lead: is it how far they walk in a frame?

An annealed filter of two layers walks twice in a frame, by the full and by 0.71 of the noise, 1.22 of it together. Here
SBPS and PFCR walk by 0.5, 0.71 and 1.41 of it too, and so does APF. If its lead came from its narrower second step, a
narrower walk would help the others; if it came from the way it gets, a wider one would.
Writes eval/results/decomposition_steps.csv and decomposition_steps_ranking.csv.

    python -m eval.decomposition_steps [--full] [--workers 2]

--quick (default): 3 scenes x 2 runs of 150 frames per cell, K = 3, N = 300; about 3 minutes on one core.
--full: 5 scenes x 4 runs of 300 frames, K = 3 and 7, N = 50 and 300; about 1 hour.
Nothing is published.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence

from eval.decomposition.cells import STEP_WIDTHS, Cell, RunKey, SceneKey
from eval.decomposition.store import Row
from eval.decomposition.tables import LABELS, Seeds, Table, parse_seeds, run_tables, summary

# Filter and layers; walks are percent of the reported one, which is the world "sw".
METHODS = (("sbps", 1), ("pfcr-equal", 1), ("psapf", 2))


def _name_of(row: Row) -> str:
    return f"{LABELS[row['filter']]} x {int(row['world'].partition('_')[2] or 100) / 100:g}"


def steps_table(seeds: Seeds) -> Table:
    """Four arms."""
    cells: list[Cell] = []
    for n_levels in (3, 7) if seeds.is_full else (3,):
        for n in (50, 300) if seeds.is_full else (300,):
            for method, n_layers in METHODS:
                for percent in (100, *STEP_WIDTHS):
                    world = "sw" if percent == 100 else f"step_{percent}"
                    cells += seeds.cells(SceneKey(world, 4, n_levels), RunKey(method, n, n_layers))
    others = [
        f"{LABELS[method]} x {factor}" for method in ("sbps", "pfcr-equal") for factor in (0.5, 0.71, 1.41)
    ]
    pairs = [
        *((name, f"{name.rpartition(' x ')[0]} x 1") for name in others),
        *((f"{LABELS[method]} x 1", "APF x 1") for method in ("sbps", "pfcr-equal")),
        *((name, "APF x 1") for name in others),
        *((f"APF x {factor}", "APF x 1") for factor in (0.5, 0.71, 1.41)),
        *((f"{LABELS[method]} x 1.41", "APF x 1.41") for method in ("sbps", "pfcr-equal")),
    ]
    orders = [(better, worse, float("nan")) for better, worse in pairs]
    return Table("Steps", cells, ("n_levels", "n_evaluations"), lambda cell: orders, {}, _name_of)


def main(argv: Sequence[str] | None = None) -> None:
    """Run the table."""
    seeds = parse_seeds(__doc__, argv)
    sys.stdout.write(summary(run_tables("steps", [steps_table(seeds)], seeds)) + "\n")


if __name__ == "__main__":
    main()
