"""The published orders once more from the committed cells: in weak and in strong motion apart, and over scenes.

A film of the reported tables has both: its weak motion is half as fast as the filters' walk, its strong motion as
fast. No filter runs again; every cell keeps its error over either kind of frames. "scenes" is over all frames as the
tables are, but its intervals draw whole scenes instead of runs: an order decided so may be expected of other scenes.
Writes eval/results/decomposition_motion.csv, one line per published order and count.

    python -m eval.decomposition_motion

Seconds. Published: SW and XN print errors over all frames of films whose speed they leave open.
Of the 150 frames of a film SW's weak ones are the first 49, right after the start; XN's are 1 to 79 and 121 to 149.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterable, Sequence

from eval import decomposition_sw_tables, decomposition_xn_4, decomposition_xn_5, decomposition_xn_6
from eval.decomposition.statistics import (
    Claim,
    Compare,
    ratio_of_means,
    ratio_over_scenes,
    share_that_holds,
)
from eval.decomposition.store import RESULTS, Row, cell_key, cells_of
from eval.decomposition.tables import CLAIM_FIELDS, Seeds, Table, claim_line, claims_of
from eval.whole import write_csv

SCRIPTS = {
    "sw": decomposition_sw_tables.tables,
    "xn_4": decomposition_xn_4.tables,
    "xn_5": decomposition_xn_5.tables,
    "xn_6": decomposition_xn_6.tables,
}
COUNTS: dict[str, tuple[str, Compare]] = {
    "all": ("error_px", ratio_of_means),
    "weak": ("error_weak_px", ratio_of_means),
    "strong": ("error_strong_px", ratio_of_means),
    "scenes": ("error_px", ratio_over_scenes),
}
FIELDS = ("count", *CLAIM_FIELDS)
REPORTED = Seeds(scenes=tuple(range(5)), runs=tuple(range(4)), n_workers=1, is_full=False, n_frames=150)


def claims_in(table: Table, rows: Iterable[Row], count: str) -> list[Claim]:
    """The orders of a table, counted in one of the ways."""
    field, compare = COUNTS[count]
    return claims_of(table, [row | {"error_px": row[field]} for row in rows if row[field]], compare)


def committed(name: str) -> list[tuple[Table, list[Row]]]:
    """The reported tables of a source with their committed cells; times and tables without orders have none."""
    known = cells_of(name)
    found = []
    for table in SCRIPTS[name](REPORTED):
        keys = dict.fromkeys(cell_key(cell.key()) for cell in table.cells)
        found.append((table, [known[key] for key in keys if key in known]))
    return found


def main(argv: Sequence[str] | None = None) -> None:
    """Write the orders of all tables."""
    argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    ).parse_args(argv)
    lines = []
    for count in COUNTS:
        claims = [
            claim
            for name in SCRIPTS
            for table, rows in committed(name)
            for claim in claims_in(table, rows, count)
        ]
        lines += [{"count": count, **claim_line(claim)} for claim in claims]
        n, holds, firm, against = share_that_holds(claims)
        sys.stdout.write(f"{count}: {holds} of {n} hold, {firm} decided for, {against} against\n")
    write_csv(RESULTS / "decomposition_motion.csv", FIELDS, lines)


if __name__ == "__main__":
    main()
