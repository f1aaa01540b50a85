"""The published orders of SW and XN 4-5 in the sources' own worlds: their state, a slower film, a start by hand.

The reported tables have the state of XN's dimensions (one angle per part, |X| = P + 2), a film whose strong motion is
as fast as the filters' walk, and a start from the truth. The sources differ in each of them:

- state: SW has three noisy columns for every part (|X| = 3 P, SW 6.2). Here they are the angle and how far the joint
  lies off its place (`mocap.polygons.tree.with_loose_joints`); the film keeps its joints.
- film: the published errors have a floor that particles do not take away, ours fall with them, because our filters lag.
  Slow: 0.4 times the speed.
- start: by hand (SW 6.2, XN 4.4.2), 2 px and 0.08 rad off, the reference histograms too.

Six combinations that a source may have meant, on objects of SW (arms of K - 1 parts) and of XN (arms of K parts: its
dimensions |X| = 35 for |P_j| = 4, K = 8 and 27 for |P_j| = 6, K = 4). Scenes of their own (seeds from 3000).
Writes eval/results/decomposition_own_worlds.csv, ..._ranking.csv and ..._cells.csv.

    python -m eval.decomposition_own_worlds [--runs 4] [--workers 2]

5 scenes x 4 runs of 100 frames per cell, N = 50, which the page has; about 25 minutes on one core; goes on
where it stopped.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence

from eval.decomposition.cells import Cell, RunKey, SceneKey
from eval.decomposition.tables import Seeds, Table, run_tables, summary

FIRST_SCENE = 3000
_FRAMES = 100
WORLDS = ("sw", "sw_slow", "sw_slow-by-hand", "sw_loose", "sw_loose-slow", "sw_loose-slow-by-hand")
# |P_j| and levels (one more than parts in an arm): three objects of SW, two of XN.
OBJECTS = ((4, 3), (8, 4), (4, 7), (6, 5), (4, 9))
N_EVALUATIONS = 50
FILTERS = (("ps", 1), ("sbps", 1), ("pfcr", 1), ("psapf", 2), ("sbapf", 2))
ORDERS = (
    ("SBPS", "PS"),
    ("SBAPF", "APF"),
    ("SBPS", "APF"),
    ("SBAPF", "PS"),
    ("PFCR", "SBPS"),
    ("PFCR", "APF"),
    ("PFCR", "SBAPF"),
)
NAME = "Own worlds, SW and XN 4-5"


def own_worlds(seeds: Seeds) -> Table:
    """The orders of SW Tables 1-2 and XN Figures 4-19 to 5-15 in every world and for every object."""
    cells: list[Cell] = []
    for world in WORLDS:
        for n_arms, n_levels in OBJECTS:
            for name, n_layers in FILTERS:
                cells += seeds.cells(SceneKey(world, n_arms, n_levels), RunKey(name, N_EVALUATIONS, n_layers))
    orders = [(better, worse, float("nan")) for better, worse in ORDERS]
    return Table(NAME, cells, ("world", "n_arms", "n_levels", "n_evaluations"), lambda cell: orders, {})


def main(argv: Sequence[str] | None = None) -> None:
    """Run the worlds."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--runs", type=int, default=4, help="runs on each of 5 scenes (default 4)")
    parser.add_argument("--workers", type=int, default=1, help="processes")
    args = parser.parse_args(argv)
    seeds = Seeds(
        scenes=tuple(range(FIRST_SCENE, FIRST_SCENE + 5)),
        runs=tuple(range(args.runs)),
        n_workers=args.workers,
        is_full=True,
        n_frames=_FRAMES,
    )
    claims = run_tables("own_worlds", [own_worlds(seeds)], seeds)
    sys.stdout.write(summary(claims) + "\n")


if __name__ == "__main__":
    main()
