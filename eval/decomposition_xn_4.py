"""XN chapter 4: PS, SBPS, APF (annealing part after part) and SBAPF over K, |P_j|, N and layers.

What is re-run of the figures, which are lost as pictures and known from the text:
Figures 4-19, 4-20, 4-26 (over K, |P_j| = 4), 4-21, 4-22, 4-28 (over |P_j|, K = 4), 4-23, 4-24, 4-30, 4-31 (over N),
4-25 (over the layers), 4-18 (weak and strong motion: two columns of the CSV). Errors, their standard deviations and
the times of resampling and swapping come from the same runs.
Writes eval/results/decomposition_xn_4.csv, decomposition_xn_4_ranking.csv and two PNG.

    python -m eval.decomposition_xn_4 [--full] [--workers 2]

--quick (default): 3 scenes x 2 runs of 150 frames per cell, K = 3, 6, |P_j| = 3, 8, N = 50, 200, the bushy one of the
two objects of Figures 4-23 to 4-25; about 2 minutes on one core, 5 with
--scenes 5 --runs 4, as the page has it.  --full: all cells with 5 scenes x 4 runs; hours.
Published: SBPS below PS and SBAPF below APF everywhere; over |P_j| the best two are SBAPF and SBPS; SBAPF with one
layer below APF with any number of layers (450 px against more for K = 8, 280 px for |P_j| = 6, N = 300).
"""

from __future__ import annotations

import sys
from collections.abc import Sequence

from eval.decomposition.cells import Cell, RunKey, SceneKey
from eval.decomposition.pictures import picture_of
from eval.decomposition.tables import Seeds, Table, parse_seeds, run_tables, summary

_NAN = float("nan")
# XN's default of one layer of annealing is two scores of each particle.
METHODS = (("ps", 1), ("sbps", 1), ("psapf", 2), ("sbapf", 2))
LONG, BUSHY = (4, 8), (6, 4)  # |P_j|, K of the objects of Figures 4-23 to 4-25


def sweep(
    name: str,
    objects: Sequence[tuple[int, int]],
    counts: Sequence[int],
    x: str,
    seeds: Seeds,
    orders: Sequence[tuple[str, str]],
    methods: Sequence[tuple[str, int]] = METHODS,
) -> Table:
    """A figure: objects (|P_j|, K), numbers of particles, and the orders that the text states for every cell."""
    cells: list[Cell] = []
    for n_arms, n_levels in objects:
        for n in counts:
            for method, n_layers in methods:
                cells += seeds.cells(SceneKey("xn4", n_arms, n_levels), RunKey(method, n, n_layers))
    return Table(
        name,
        cells,
        ("n_arms", "n_levels", "n_evaluations"),
        lambda cell: [(better, worse, _NAN) for better, worse in orders],
        {},
        x=x,
    )


def over_layers(name: str, seeds: Seeds, methods: Sequence[tuple[str, int]]) -> Table:
    """Figure 4-25 (and 5-18): APF with 1 to 5 layers against filters with a fixed number, N = 300."""
    cells: list[Cell] = []
    layers = [1, 2, 3, 4, 5] if seeds.is_full else [1, 3]
    fixed = [(method, n_layers, f"{method} {n_layers}") for method, n_layers in methods]
    for n_arms, n_levels in (LONG, BUSHY) if seeds.is_full else (BUSHY,):
        scene = SceneKey("xn4", n_arms, n_levels)
        for layer in layers:
            cells += seeds.cells(scene, RunKey("psapf", 300, layer + 1))
        for method, n_layers, _ in fixed:
            cells += seeds.cells(scene, RunKey(method, 300, n_layers))

    def name_of(row: dict[str, str]) -> str:
        if row["filter"] == "psapf":
            return f"APF L={int(row['n_layers']) - 1}"
        return {"sbapf": "SBAPF L=1", "pfcr": "PFCR"}[row["filter"]]

    best = "PFCR" if any(m == "pfcr" for m, _ in methods) else "SBAPF L=1"
    return Table(
        name,
        cells,
        ("n_arms", "n_levels"),
        lambda cell: [(best, f"APF L={layer}", _NAN) for layer in layers],
        {},
        name_of=name_of,
    )


def sweeps(
    seeds: Seeds, methods: Sequence[tuple[str, int]], figures: Sequence[str], orders: Orders
) -> list[Table]:
    """The sweeps over K, |P_j| and N that chapters 4 and 5 share, so that they share their runs."""
    levels = range(2, 9) if seeds.is_full else (3, 6)
    arms = range(3, 9) if seeds.is_full else (3, 8)
    counts = [50, 100, 200, 300] if seeds.is_full else [50, 200]
    tables = [
        sweep(figures[0], [(4, k) for k in levels], counts, "n_levels", seeds, orders[0], methods),
        sweep(figures[1], [(a, 4) for a in arms], counts, "n_arms", seeds, orders[1], methods),
    ]
    counts = [50, 100, 200, 300, 600] if seeds.is_full else [50, 200]
    objects = (LONG, BUSHY) if seeds.is_full else (BUSHY,)
    return [*tables, sweep(figures[2], objects, counts, "n_evaluations", seeds, orders[2], methods)]


Orders = tuple[Sequence[tuple[str, str]], Sequence[tuple[str, str]], Sequence[tuple[str, str]]]


def tables(seeds: Seeds) -> list[Table]:
    """All figures of the chapter."""
    swapping = [("SBPS", "PS"), ("SBAPF", "APF")]
    bushy = [*swapping, ("SBPS", "APF"), ("SBAPF", "PS")]
    figures = ("XN Figure 4-19", "XN Figure 4-21", "XN Figure 4-23")
    found = sweeps(seeds, METHODS, figures, (swapping, bushy, swapping))
    return [*found, over_layers("XN Figure 4-25", seeds, [("sbapf", 2)])]


def main(argv: Sequence[str] | None = None) -> None:
    """Run the figures of chapter 4."""
    seeds = parse_seeds(__doc__, argv)
    wanted = tables(seeds)
    claims = run_tables("xn_4", wanted, seeds)
    picture_of("xn_4", [t for t in wanted if t.x])
    sys.stdout.write(summary(claims) + "\n")


if __name__ == "__main__":
    main()
