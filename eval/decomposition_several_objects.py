"""SW Table 3 with two objects: why one SBPS for both falls behind, one factor at a time.

SW Table 3 has 1 SBPS before every other way. With three objects that holds here, with two three of eight orders fail.
Below everything is as in `eval.decomposition_sw_tables` but for one thing:

- slow film: 0.4 times the speed, on the same scenes. Expected: all eight orders hold, because in the weak motion of the
  reported films they do (`eval.decomposition_motion`).
- wide walk: the filters' steps 1.41 times as wide. Expected: the same, less firmly.
- more particles: 300 for two objects, as many as three objects have. Expected: nearer, but not turned.
- fewer particles: 200 for three objects, as many as two have. Expected: the orders of three objects go as well, if the
  number of particles is what tells two from three.
- other scenes: two objects in five scenes from 3000. Expected: fails where centres move faster than the walk.

The expectations were written before the first run; the last one and that on fewer particles are wrong. The scenes are
those of the reported table but for the last factor, and nothing is chosen by the outcome.
Writes eval/results/decomposition_several_objects.csv, ..._ranking.csv, ..._cells.csv and ..._scenes.csv: scene by
scene, one SBPS over M of them and how fast the centres move.

    python -m eval.decomposition_several_objects [--runs 4] [--only "slow film"]

5 scenes x 4 runs of 150 frames per cell; about 13 minutes on one core; goes on where it stopped. The page has --runs 2.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from eval.decomposition.cells import WORLDS, Cell, RunKey, SceneKey, scene_of
from eval.decomposition.statistics import values
from eval.decomposition.store import RESULTS, Row, cells_of
from eval.decomposition.tables import Seeds, Table, run_tables, summary
from eval.decomposition_own_worlds import FIRST_SCENE
from eval.decomposition_sw_tables import method_of_several, orders_of_several
from eval.whole import write_csv
from mocap.polygons.likelihood import random_walk_std

_FRAMES = 150
_FEW = 100  # particles of the columns "/100"


@dataclass(frozen=True)
class Factor:
    """What differs from SW Table 3 with two objects.  n_particles : of the one filter and of each of the M."""

    name: str
    world: str = "sw"
    n_objects: int = 2
    n_particles: int = 200
    first_scene: int = 0


FACTORS = (
    Factor("slow film", world="sw_slow"),
    Factor("wide walk", world="step_141"),
    Factor("more particles", n_particles=300),
    Factor("fewer particles", n_objects=3),
    Factor("other scenes", first_scene=FIRST_SCENE),
)


def table_of(factor: Factor, seeds: Seeds) -> Table:
    """The six columns of SW Table 3 with one factor changed."""
    scene = SceneKey(factor.world, 4, 3, n_objects=factor.n_objects)
    own = seeds.from_scene(factor.first_scene)
    cells: list[Cell] = []
    for name in ("ps", "sbps"):
        for is_split, n in ((False, factor.n_particles), (True, factor.n_particles), (True, _FEW)):
            cells += own.cells(scene, RunKey(name, n, is_split=is_split))
    return Table(
        factor.name,
        cells,
        ("world", "n_objects"),
        lambda cell: orders_of_several(factor.n_objects),
        {},
        name_of=method_of_several,
    )


def centre_speeds(key: SceneKey) -> tuple[float, float]:
    """Root mean square of the steps in strong motion of the centre that shifts fastest in x or y, and of the one that
    turns fastest: in the filters' own steps."""
    scene, world = scene_of(key), WORLDS[key.world]
    layout = scene.tree.layout
    steps = np.diff(scene.states, axis=0) / random_walk_std(layout, world.std_px, world.std_rad)
    frames = np.arange(1, len(scene.states))
    strong = np.any(
        [(first <= frames) & (frames <= last) for first, last in world.scene.strong_frames], axis=0
    )
    speed = np.sqrt(np.mean(steps[strong] ** 2, axis=0))
    is_centre = layout.parent_of_part[layout.part_of_column] < 0
    return float(speed[is_centre & ~layout.is_circular].max()), float(
        speed[is_centre & layout.is_circular].max()
    )


def scene_lines(rows: Sequence[Row]) -> list[dict[str, str]]:
    """Every scene of the reported film: one SBPS over M with as many particles each, and how fast centres move."""
    lines = []
    for n_objects, n, first in ((2, "200", 0), (3, "300", 0), (2, "200", FIRST_SCENE)):
        for seed in range(first, first + 5):
            key = SceneKey("sw", 4, 3, n_objects=n_objects, seed=seed, n_frames=_FRAMES)
            wanted = Cell(key, RunKey("sbps", int(n))).key()
            fields = [field for field in wanted if field not in ("is_split", "run_seed")]
            own = [row for row in rows if all(row[field] == wanted[field] for field in fields)]
            one, several = ([row for row in own if row["is_split"] == split] for split in ("False", "True"))
            shift, turn = centre_speeds(key)
            lines.append(
                {
                    "n_objects": str(n_objects),
                    "scene": str(seed),
                    "shift": f"{shift:.2f}",
                    "turn": f"{turn:.2f}",
                    "ratio": f"{values(one).mean() / values(several).mean():.2f}",
                }
            )
    return lines


def write_scenes() -> None:
    """Scene by scene, from the committed cells of SW Table 3 and of the factors."""
    lines = scene_lines([row for name in ("sw", "several_objects") for row in cells_of(name).values()])
    write_csv(RESULTS / "decomposition_several_objects_scenes.csv", tuple(lines[0]), lines)


def main(argv: Sequence[str] | None = None) -> None:
    """Run the factors, or some of them."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--runs", type=int, default=4, help="runs on each of 5 scenes (default 4)")
    parser.add_argument("--workers", type=int, default=1, help="processes")
    parser.add_argument("--only", nargs="+", default=(), choices=[factor.name for factor in FACTORS])
    args = parser.parse_args(argv)
    seeds = Seeds(
        scenes=tuple(range(5)),
        runs=tuple(range(args.runs)),
        n_workers=args.workers,
        is_full=True,
        n_frames=_FRAMES,
        only=tuple(args.only),
    )
    claims = run_tables("several_objects", [table_of(factor, seeds) for factor in FACTORS], seeds)
    write_scenes()
    sys.stdout.write(summary(claims) + "\n")


if __name__ == "__main__":
    main()
