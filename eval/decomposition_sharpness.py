"""Why swapping gains less here than published: the filters over the sharpness of the likelihood.

Swapping needs copies: particles that agree on a part's parent. Copies come from resampling, and resampling copies only
when weights differ much. So lambda, 50 in the sources, is varied. The annealed filters are there to see whether their
lead goes away with it.
Writes eval/results/decomposition_sharpness.csv, decomposition_sharpness_ranking.csv and a PNG.

    python -m eval.decomposition_sharpness [--full] [--workers 2]

--quick (default): 3 scenes x 2 runs of 150 frames per cell, lambda = 50, 200; about 5 minutes on one core after
eval.decomposition_sw_tables.  --full: lambda = 15, 50, 200, 800 with 5 scenes x 4 runs of 300 frames; about 2 hours.
Nothing is published.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence

from eval.decomposition.cells import SHARPNESS, Cell, RunKey, SceneKey
from eval.decomposition.pictures import picture_of
from eval.decomposition.tables import Seeds, Table, parse_seeds, run_tables, summary

METHODS = (("ps", 1), ("sbps", 1), ("pfcr-equal", 1), ("psapf", 2), ("sbapf", 2))


def sharpness_table(seeds: Seeds) -> Table:
    """Four arms, K = 3 and 7, N = 50 and 300: the corners of SW Table 1."""
    cells: list[Cell] = []
    others = SHARPNESS if seeds.is_full else (200,)
    for n_levels in (3, 7):
        for n in (50, 300):
            for world in ("sw", *(f"sw_{value}" for value in others)):
                for method, n_layers in METHODS:
                    cells += seeds.cells(SceneKey(world, 4, n_levels), RunKey(method, n, n_layers))
    pairs = (
        ("SBPS", "PS"),
        ("PFCR", "PS"),
        ("PFCR", "SBPS"),
        ("SBPS", "APF"),
        ("PFCR", "APF"),
        ("SBAPF", "APF"),
    )
    orders = [(better, worse, float("nan")) for better, worse in pairs]
    return Table(
        "Sharpness", cells, ("n_levels", "n_evaluations", "world"), lambda cell: orders, {}, x="world"
    )


def main(argv: Sequence[str] | None = None) -> None:
    """Run the table."""
    seeds = parse_seeds(__doc__, argv)
    table = sharpness_table(seeds)
    claims = run_tables("sharpness", [table], seeds)
    picture_of("sharpness", [table])
    sys.stdout.write(summary(claims) + "\n")


if __name__ == "__main__":
    main()
