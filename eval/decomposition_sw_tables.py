"""SW Tables 1-3: PS against SBPS on the 2D polygon world over K, |P_j|, N and several objects.

Writes eval/results/decomposition_sw.csv (one line per cell and filter), decomposition_sw_ranking.csv (one line per
published order) and decomposition_sw.png.

    python -m eval.decomposition_sw_tables [--full] [--workers 2]

--quick (default): 3 scenes x 2 runs of 150 frames per cell, K = 3, 5, 7, N = 50, 300; about 3 minutes on one core, 10
with --scenes 5 --runs 4, as the page has it.  --full: all cells with 5 scenes x 4 runs; an hour or two.
Published (SW Table 1, |P_j| = 4, K = 3..7): PS N=50 185-1245 px, SBPS N=50 141-945 px; SBPS is better in all cells.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence

from eval.decomposition.cells import Cell, RunKey, SceneKey
from eval.decomposition.pictures import picture_of
from eval.decomposition.published import SW_ARMS, SW_LEVELS, SW_TABLE_1, SW_TABLE_2, SW_TABLE_3
from eval.decomposition.store import Row
from eval.decomposition.tables import LABELS, Printed, Seeds, Table, parse_seeds, run_tables, summary

_NAN = float("nan")


def sweep_table(number: int, seeds: Seeds) -> Table:
    """Source: SW Table 1 (over K) or SW Table 2 (over |P_j|)."""
    published, field = (SW_TABLE_1, "n_levels") if number == 1 else (SW_TABLE_2, "n_arms")
    points = list(SW_LEVELS if number == 1 else SW_ARMS)
    if not seeds.is_full:
        points = points[::2]
    cells: list[Cell] = []
    for point in points:
        scene = SceneKey("sw", 4, point) if number == 1 else SceneKey("sw", point, 3)
        for n in (50, 300, 600) if seeds.is_full else (50, 300):
            for name in ("ps", "sbps"):
                cells += seeds.cells(scene, RunKey(name, n))

    def pairs(cell: tuple[str, ...]) -> list[tuple[str, str, float]]:
        point, n = int(cell[0]), int(cell[1])
        return [("SBPS", "PS", published["sbps", n, point][0] / published["ps", n, point][0])]

    printed: Printed = {(str(point), str(n), LABELS[f]): v for (f, n, point), v in published.items()}
    return Table(f"SW Table {number}", cells, (field, "n_evaluations"), pairs, printed, x=field)


def several_objects(seeds: Seeds) -> Table:
    """One filter for M objects against M filters.  Source: SW Table 3, the same as XN Table 4.1."""
    cells: list[Cell] = []
    for m in (2, 3):
        scene = SceneKey("sw", 4, 3, n_objects=m)
        for name in ("ps", "sbps"):
            for is_split, n in ((False, 100 * m), (True, 100 * m), (True, 100)):
                cells += seeds.cells(scene, RunKey(name, n, is_split=is_split))
    printed: Printed = {(str(m), method): (float(e), _NAN) for (m, method), e in SW_TABLE_3.items()}

    return Table(
        "SW Table 3",
        cells,
        ("n_objects",),
        lambda cell: orders_of_several(int(cell[0])),
        printed,
        name_of=method_of_several,
    )


def orders_of_several(n_objects: int) -> list[tuple[str, str, float]]:
    """What SW 6.6 says of one filter and of M, with the printed ratios."""
    orders = [("1 SBPS", other) for other in ("1 PS", "M PS", "M PS/100", "M SBPS", "M SBPS/100")]
    orders += [("M PS", "1 PS"), ("M SBPS", "M PS"), ("M SBPS/100", "M PS/100")]
    return [(a, b, SW_TABLE_3[n_objects, a] / SW_TABLE_3[n_objects, b]) for a, b in orders]


def method_of_several(row: Row) -> str:
    """One filter or M, and with how many particles: the columns of SW Table 3."""
    split = row["is_split"] == "True"
    fewer = split and row["n_evaluations"] == "100"
    return f"{'M' if split else '1'} {LABELS[row['filter']]}{'/100' if fewer else ''}"


def tables(seeds: Seeds) -> list[Table]:
    """All tables of the source."""
    return [sweep_table(1, seeds), sweep_table(2, seeds), several_objects(seeds)]


def main(argv: Sequence[str] | None = None) -> None:
    """Run the three tables."""
    seeds = parse_seeds(__doc__, argv)
    wanted = tables(seeds)
    claims = run_tables("sw", wanted, seeds)
    picture_of("sw", [t for t in wanted if t.x])
    sys.stdout.write(summary(claims) + "\n")


if __name__ == "__main__":
    main()
