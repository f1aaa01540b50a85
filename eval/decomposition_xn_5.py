"""XN chapter 5: combinatorial resampling and the filter built on it (PFCR).

What is re-run: Figure 5-8 and Table 5.1 (six resampling schemes in PS, error and time over N),
Figures 5-9 to 5-11 (over K), 5-12 to 5-14 (over |P_j|), 5-15 to 5-17 (over N), 5-18 (over the layers). SBPS, APF and
SBAPF are the runs of eval.decomposition_xn_4.
Writes eval/results/decomposition_xn_5.csv, decomposition_xn_5_ranking.csv and PNG.

    python -m eval.decomposition_xn_5 [--full] [--workers 2]

--quick (default): 3 scenes x 2 runs of 150 frames per cell, a sample of K, |P_j| and N; about 2 minutes on one core
after eval.decomposition_xn_4, 7 with --scenes 5 --runs 4, as the page has it.
--full: all cells with 5 scenes x 4 runs; hours.
Published: PFCR has the lowest error in every cell; with N = 50 it is at or below the others' N = 300 (340 against
350-510 px for K = 8, 288 against 280-340 px for |P_j| = 6); combinatorial resampling reaches at N = 20 the error that
the other schemes converge to; its time at |P_j| = 8, N = 600 is 22 s against 75-158 s.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import replace

from eval.decomposition.cells import Cell, RunKey, SceneKey
from eval.decomposition.pictures import picture_of
from eval.decomposition.published import XN_TABLE_5_1
from eval.decomposition.store import Row
from eval.decomposition.tables import Seeds, Table, parse_seeds, run_tables, summary
from eval.decomposition_xn_4 import over_layers, sweeps

_NAN = float("nan")
_TIMED_FRAMES = 60  # enough for a time per frame
METHODS = (("sbps", 1), ("psapf", 2), ("sbapf", 2), ("pfcr", 1), ("pfcr-equal", 1))
READINGS = ("pfcr", "pfcr-equal", "pfcr-carried")
SCHEMES = ("multinomial", "systematic", "stratified", "residual", "weighted")
OBJECTS = ((4, 4), (4, 6), (8, 4))  # |P_j|, K of Figure 5-7


def schemes(seeds: Seeds) -> Table:
    """Figure 5-8 and Table 5.1: the resampling schemes inside PS, and the combinatorial one.

    All have equal weights after the draw, so that the last is PFCR with equal weights.
    """
    cells: list[Cell] = []
    counts = (20, 50, 100, 200, 300, 600) if seeds.is_full else (20, 100)
    for n_arms, n_levels in OBJECTS:
        scene = SceneKey("xn4", n_arms, n_levels)
        for n in counts:
            for scheme in SCHEMES if seeds.is_full else ("multinomial", "systematic", "residual", "weighted"):
                cells += seeds.cells(scene, RunKey("ps", n, resampling=scheme))
            cells += seeds.cells(scene, RunKey("pfcr-equal", n))
    return Table(
        "XN Figure 5-8",
        cells,
        ("n_arms", "n_levels", "n_evaluations"),
        lambda cell: [("combinatorial", scheme, _NAN) for scheme in SCHEMES],
        {},
        name_of=scheme_of,
        x="n_evaluations",
    )


def times(seeds: Seeds) -> Table:
    """Milliseconds of resampling per frame at N = 100 and 600.  Source: XN Table 5.1, seconds over 300 frames."""
    cells: list[Cell] = []
    one = replace(seeds, scenes=seeds.scenes[:1], runs=seeds.runs[:1], n_frames=_TIMED_FRAMES)
    for n_arms, n_levels in OBJECTS:
        for n in (100, 600):
            scene = SceneKey("xn4", n_arms, n_levels)
            for scheme in SCHEMES:
                cells += one.cells(scene, RunKey("ps", n, resampling=scheme))
            cells += one.cells(scene, RunKey("pfcr-equal", n))
    return Table(
        "XN Table 5.1", cells, ("n_arms", "n_levels", "n_evaluations"), lambda cell: [], {}, name_of=scheme_of
    )


def readings(seeds: Seeds) -> Table:
    """What becomes of the weights of drawn particles: kept and drawn by, made equal, or carried to the frame's end."""
    cells: list[Cell] = []
    for n_arms, n_levels in ((4, 3), (4, 6), (3, 4), (8, 4)):
        for name in READINGS:
            cells += seeds.cells(SceneKey("xn4", n_arms, n_levels), RunKey(name, 50))
    return Table("PFCR read otherwise", cells, ("n_arms", "n_levels", "n_evaluations"), lambda cell: [], {})


def scheme_of(row: Row) -> str:
    """The name of the resampling scheme."""
    return "combinatorial" if row["filter"] == "pfcr-equal" else row["resampling"]


def published_ms(scheme: str, n_arms: int, n_levels: int, n: int) -> float:
    """Published resampling time per frame."""
    return 1e3 * XN_TABLE_5_1[scheme, n_arms, n_levels, n] / 300


def tables(seeds: Seeds) -> list[Table]:
    """All figures and tables of the chapter."""
    best = [("PFCR", other) for other in ("SBPS", "APF", "SBAPF")]
    figures = ("XN Figure 5-9", "XN Figure 5-12", "XN Figure 5-15")
    found = [schemes(seeds), *sweeps(seeds, METHODS, figures, (best, best, best))]
    found.append(over_layers("XN Figure 5-18", seeds, [("sbapf", 2), ("pfcr", 1)]))
    return [*found, readings(seeds), times(seeds)]


def main(argv: Sequence[str] | None = None) -> None:
    """Run the figures of chapter 5."""
    seeds = parse_seeds(__doc__, argv)
    wanted = tables(seeds)
    claims = run_tables("xn_5", wanted, seeds)
    picture_of("xn_5", [t for t in wanted if t.x])
    sys.stdout.write(summary(claims) + "\n")


if __name__ == "__main__":
    main()
