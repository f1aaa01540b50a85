"""The orders of XN chapters 4 and 5 once more, with annealed layers read to the letter, on the same scenes.

APF and SBAPF with beta <= 1: XN 3.2.1 wants beta_0 > beta_1 > ... and
weighs the last layer with beta = 1, so that an annealed layer smooths; the filter here gives the exponent that the
survival rate asks for, which is above 1 on flat parts. Decision 18 has the reasons. PS, SBPS and PFCR are the same.
Writes eval/results/decomposition_as_printed.csv and decomposition_as_printed_ranking.csv.

    python -m eval.decomposition_as_printed [--full] [--workers 2]

--quick (default): 3 scenes x 2 runs of 150 frames per cell; about 2 minutes on one core after
eval.decomposition_xn_4 and ..._xn_5, 8 with --scenes 5 --runs 4, as the page has it.
--full: all cells with 5 scenes x 4 runs; hours.
Published: as in eval.decomposition_xn_4 and eval.decomposition_xn_5.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence

from eval.decomposition.tables import Seeds, Table, parse_seeds, run_tables, summary
from eval.decomposition_xn_4 import sweeps

METHODS = (("ps", 1), ("sbps", 1), ("psapf-smooth", 2), ("sbapf-smooth", 2), ("pfcr", 1))
_APF, _SBAPF = "APF, beta <= 1", "SBAPF, beta <= 1"


def as_printed(seeds: Seeds) -> list[Table]:
    """Figures 4-19, 4-21, 4-23 and 5-9, 5-12, 5-15."""
    swapping = [("SBPS", "PS"), (_SBAPF, _APF)]
    bushy = [*swapping, ("SBPS", _APF), (_SBAPF, "PS")]
    best = [("PFCR", other) for other in ("SBPS", _APF, _SBAPF)]
    four = ("XN Figure 4-19", "XN Figure 4-21", "XN Figure 4-23")
    five = ("XN Figure 5-9", "XN Figure 5-12", "XN Figure 5-15")
    return [
        *sweeps(seeds, METHODS, four, (swapping, bushy, swapping)),
        *sweeps(seeds, METHODS, five, (best, best, best)),
    ]


def main(argv: Sequence[str] | None = None) -> None:
    """Run the figures."""
    seeds = parse_seeds(__doc__, argv)
    sys.stdout.write(summary(run_tables("as_printed", as_printed(seeds), seeds)) + "\n")


if __name__ == "__main__":
    main()
