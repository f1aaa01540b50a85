"""Tables of cells: run them, compare with what was published, write CSV and pictures."""

from __future__ import annotations

import argparse
import csv
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from eval.decomposition.cells import Cell, RunKey, SceneKey
from eval.decomposition.readings import READINGS
from eval.decomposition.statistics import (
    Claim,
    Compare,
    claims_between,
    group,
    grouped,
    ratio_of_means,
    share_that_holds,
)
from eval.decomposition.store import RESULTS, STORE, Row, cells_of, run_cells, write_cells
from eval.whole import write_csv
from mocap.filters import FILTERS

# What the sources call the filters. XN's "APF" anneals part after part, its "PFAPF" the whole.
LABELS = {one.name: one.label for one in (*FILTERS.values(), *READINGS.values())}

_QUICK_FRAMES = 150  # both weak and strong motion

Printed = dict[tuple[str, ...], tuple[float, float]]
Pairs = Callable[[tuple[str, ...]], Iterable[tuple[str, str, float]]]


@dataclass(frozen=True)
class Seeds:
    """Which scenes and which runs on each; how many processes; everything or a sample; n_frames 0 = all.

    only : names of tables; none = all.  scheduler : of a dask cluster that does the work; none = n_workers processes.
    """

    scenes: tuple[int, ...]
    runs: tuple[int, ...]
    n_workers: int
    is_full: bool
    n_frames: int = 0
    only: tuple[str, ...] = ()
    scheduler: str = ""

    def with_runs(self, least: int) -> Seeds:
        """As many runs on each scene, but no fewer."""
        return replace(self, runs=tuple(range(max(least, len(self.runs)))))

    def from_scene(self, first: int) -> Seeds:
        """As many scenes, counted from another one."""
        return replace(self, scenes=tuple(range(first, first + len(self.scenes))))

    def cells(self, scene: SceneKey, run: RunKey) -> list[Cell]:
        """A cell for every seed."""
        return [
            Cell(replace(scene, seed=s, n_frames=self.n_frames), replace(run, seed=r))
            for s in self.scenes
            for r in self.runs
        ]


def parse_seeds(description: str, argv: Sequence[str] | None = None) -> Seeds:
    """The command line of all scripts: --quick (default), --full, --workers, --scheduler, --scenes, --runs."""
    parser = argparse.ArgumentParser(
        description=description, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--quick", action="store_true", help="a sample of the cells, half the frames (default)"
    )
    parser.add_argument("--full", action="store_true", help="all cells, all frames, 20 runs each")
    parser.add_argument("--scenes", type=int, help="scenes per cell (3, with --full 5)")
    parser.add_argument("--runs", type=int, help="runs per scene (2, with --full 4)")
    parser.add_argument("--workers", type=int, default=1, help="processes")
    parser.add_argument("--scheduler", default="", help="address of a dask scheduler instead of processes")
    parser.add_argument("--only", nargs="+", default=(), help="names of tables; the others stay as they are")
    args = parser.parse_args(argv)
    scenes, runs, frames = (5, 4, 0) if args.full else (3, 2, _QUICK_FRAMES)
    return Seeds(
        scenes=tuple(range(args.scenes or scenes)),
        runs=tuple(range(args.runs or runs)),
        n_workers=args.workers,
        is_full=args.full,
        n_frames=frames,
        only=tuple(args.only),
        scheduler=args.scheduler,
    )


@dataclass(frozen=True, eq=False)
class Table:
    """A table or figure of a source.

    cell_fields : CSV fields that tell its cells apart (the rest is averaged).  name_of : what a row's method is called.
    published : (*cell, method) -> error px and its standard deviation (NaN: not printed).
    pairs : (better, worse, published ratio) that the source claims in a cell.
    x : the cell field along the picture's axis; None for no picture.
    """

    name: str
    cells: Sequence[Cell]
    cell_fields: tuple[str, ...]
    pairs: Pairs
    published: Printed
    name_of: Callable[[Row], str] = lambda row: LABELS[row["filter"]]
    x: str | None = None


RESULT_FIELDS = (
    "table",
    "cell",
    "method",
    "runs",
    "failed",
    "error_px",
    "std_px",
    "std_in_scene_px",
    "published_px",
    "published_std_px",
    "evaluations",
    "resampling_ms",
    "swapping_ms",
    "step_ms",
    "weak_px",
    "strong_px",
)
CLAIM_FIELDS = ("table", "cell", "better", "worse", "published", "ratio", "low", "high", "runs", "verdict")


def run_tables(name: str, tables: Sequence[Table], seeds: Seeds, *, store: Path = STORE) -> list[Claim]:
    """Compute what is missing, then write eval/results/decomposition_NAME.csv, ..._ranking.csv and ..._cells.csv.

    seeds.only : names of tables to compute; lines and cells of the others stay as an earlier call wrote them.
    """
    chosen = [table for table in tables if not seeds.only or table.name in seeds.only]
    cells = [cell for table in chosen for cell in table.cells]
    rows = dict(zip(cells, _computed(cells, seeds, store), strict=True))
    own = {table.name: [rows[cell] for cell in dict.fromkeys(table.cells)] for table in chosen}
    lines = {table.name: result_lines(table, own[table.name]) for table in chosen}
    claims = {table.name: claims_of(table, own[table.name]) for table in chosen}
    orders = {of: [claim_line(claim) for claim in found] for of, found in claims.items()}
    _write_tables(RESULTS / f"decomposition_{name}.csv", RESULT_FIELDS, tables, lines)
    _write_tables(RESULTS / f"decomposition_{name}_ranking.csv", CLAIM_FIELDS, tables, orders)
    others = [cell for table in tables if table not in chosen for cell in table.cells]
    write_cells(name, [*_kept(name, others), *rows.values()], RESULTS)
    return [claim for found in claims.values() for claim in found]


def _computed(cells: Sequence[Cell], seeds: Seeds, store: Path) -> list[Row]:
    return run_cells(cells, n_workers=seeds.n_workers, scheduler=seeds.scheduler, path=store)


def claims_of(table: Table, rows: Sequence[Row], compare: Compare = ratio_of_means) -> list[Claim]:
    return claims_between(
        table.name,
        rows,
        cell_fields=table.cell_fields,
        pairs=table.pairs,
        name_of=table.name_of,
        compare=compare,
    )


def _kept(name: str, cells: Sequence[Cell]) -> list[Row]:
    """Rows of some cells that an earlier call wrote beside its tables."""
    before = cells_of(name, RESULTS)
    keys = [tuple(cell.key().values()) for cell in cells]
    return [before[key] for key in keys if key in before]


def _write_tables(
    path: Path, fields: Sequence[str], tables: Sequence[Table], lines: dict[str, list[dict[str, str]]]
) -> None:
    """Lines of all tables in their order, of those that were not computed as they are in the file."""
    before = read_csv(path)
    write_csv(
        path,
        fields,
        [
            line
            for table in tables
            for line in lines.get(table.name, [old for old in before if old["table"] == table.name])
        ],
    )


def result_lines(table: Table, rows: Sequence[Row]) -> list[dict[str, str]]:
    """One line per cell and method."""
    lines = []
    for cell, in_cell in grouped(rows, *table.cell_fields).items():
        by_method: dict[str, list[Row]] = {}
        for row in in_cell:
            by_method.setdefault(table.name_of(row), []).append(row)
        for method, own in by_method.items():
            g = group(own)
            published, published_std = table.published.get((*cell, method), (float("nan"), float("nan")))
            line = {
                "table": table.name,
                "cell": ", ".join(f"{f}={v}" for f, v in zip(table.cell_fields, cell, strict=True)),
                "method": method,
                "runs": str(g.n),
                "failed": str(g.n_failed),
                "error_px": _number(g.mean, 1),
                "std_px": _number(g.std, 1),
                "std_in_scene_px": _number(g.std_in_scene, 1),
                "published_px": _number(published, 0),
                "published_std_px": _number(published_std, 0),
                "evaluations": _number(g.evaluations, 0),
                "resampling_ms": _number(g.resampling_ms, 3),
                "swapping_ms": _number(g.swapping_ms, 3),
                "step_ms": _number(g.step_ms, 2),
                "weak_px": _number(_mean(own, "error_weak_px"), 1),
                "strong_px": _number(_mean(own, "error_strong_px"), 1),
            }
            lines.append(line)
    return lines


def _mean(rows: Sequence[Row], field: str) -> float:
    found = [float(r[field]) for r in rows if r["status"] == "ok" and r[field]]
    return float(np.mean(found)) if found else float("nan")


def _number(value: float, digits: int) -> str:
    return f"{value:.{digits}f}" if np.isfinite(value) else ""


def claim_line(claim: Claim) -> dict[str, str]:
    """A claim as a CSV line."""
    return {
        "table": claim.source,
        "cell": claim.cell,
        "better": claim.better,
        "worse": claim.worse,
        "published": _number(claim.published, 3),
        "ratio": _number(claim.ours.ratio, 3),
        "low": _number(claim.ours.low, 3),
        "high": _number(claim.ours.high, 3),
        "runs": str(claim.ours.n),
        "verdict": claim.ours.verdict if claim.ours.n else "none",
    }


def read_csv(path: Path) -> list[dict[str, str]]:
    """Lines of a CSV; none when there is no file."""
    if not path.exists():
        return []
    with path.open(newline="", encoding="utf-8") as stream:
        return list(csv.DictReader(stream))


def summary(claims: Sequence[Claim]) -> str:
    """How many of the claimed orders hold, by table, in words."""
    by_table: dict[str, list[Claim]] = {}
    for claim in claims:
        by_table.setdefault(claim.source, []).append(claim)
    lines = []
    for name, own in by_table.items():
        n, holds, yes, no = share_that_holds(own)
        lines.append(f"{name}: {holds} of {n} orders hold ({yes} decided, {no} decided against)")
    return "\n".join(lines)
