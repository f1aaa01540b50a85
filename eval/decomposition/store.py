"""Many cells: results in a CSV that grows, so that a stopped evaluation goes on where it stopped.

The growing file lies in out/ and belongs to a machine. What a finished evaluation used is written whole beside its
table, eval/results/decomposition_NAME_cells.csv, and read as well, so that nobody has to compute a cell again.
"""

from __future__ import annotations

import csv
import multiprocessing
import sys
import time
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import Executor, ProcessPoolExecutor, as_completed
from contextlib import contextmanager
from pathlib import Path

from eval.decomposition.cells import KEY_FIELDS, VALUE_FIELDS, Cell, RunKey, SceneKey, run_scene
from eval.whole import write_csv

ROOT = Path(__file__).resolve().parents[2]
STORE = ROOT / "out" / "eval" / "decomposition" / "cells.csv"
RESULTS = ROOT / "eval" / "results"

_MOST_LINES = 1500  # of a committed file, 170 kB; more cells go on in ..._part2_cells.csv

Row = dict[str, str]
CELL_FIELDS = (*KEY_FIELDS, *VALUE_FIELDS)


def read_rows(path: Path = STORE) -> dict[tuple[str, ...], Row]:
    """Rows of a store by cell; the last one of a cell counts. A line cut off in mid-write is left out."""
    if not path.exists():
        return {}
    with path.open(newline="", encoding="utf-8") as stream:
        rows = [row for row in csv.DictReader(stream) if row.get("status")]
    return {cell_key(row): row for row in rows}


def known_rows(path: Path = STORE, results: Path = RESULTS) -> dict[tuple[str, ...], Row]:
    """Rows of the committed files and, over them, of a store."""
    rows: dict[tuple[str, ...], Row] = {}
    for file in sorted(results.glob("decomposition_*_cells.csv")):
        rows |= read_rows(file)
    return rows | read_rows(path)


def cells_of(name: str, results: Path = RESULTS) -> dict[tuple[str, ...], Row]:
    """The committed cells of an evaluation."""
    rows: dict[tuple[str, ...], Row] = {}
    for file in _files(name, results):
        rows |= read_rows(file)
    return rows


def write_cells(name: str, rows: Iterable[Row], results: Path = RESULTS) -> None:
    """The cells of a finished evaluation beside its table, each once; failed ones are left out."""
    own = {cell_key(row): {f: row[f] for f in CELL_FIELDS} for row in rows if row["status"] == "ok"}
    lines = [own[key] for key in sorted(own)]
    first, *others = _files(name, results)
    for file in others:
        file.unlink()
    write_csv(first, CELL_FIELDS, lines[:_MOST_LINES])
    for k, begin in enumerate(range(_MOST_LINES, len(lines), _MOST_LINES), start=2):
        part = results / f"decomposition_{name}_part{k}_cells.csv"
        write_csv(part, CELL_FIELDS, lines[begin : begin + _MOST_LINES])


def _files(name: str, results: Path) -> list[Path]:
    """Where the cells of an evaluation are, or will be, and where they go on."""
    first = results / f"decomposition_{name}_cells.csv"
    return [first, *sorted(results.glob(f"decomposition_{name}_part*_cells.csv"))]


def cell_key(row: Row) -> tuple[str, ...]:
    return tuple(row[field] for field in KEY_FIELDS)


def append_rows(rows: Iterable[Row], path: Path = STORE) -> None:
    """Add rows, the header first in a new file."""
    path.parent.mkdir(parents=True, exist_ok=True)
    is_new = not path.exists() or path.stat().st_size == 0
    text_ends = is_new or path.read_bytes().endswith(b"\n")
    with path.open("a", newline="", encoding="utf-8") as stream:
        if not text_ends:
            stream.write("\n")
        writer = csv.DictWriter(stream, CELL_FIELDS, lineterminator="\n")
        if is_new:
            writer.writeheader()
        writer.writerows(rows)


def missing(cells: Iterable[Cell], path: Path = STORE) -> dict[SceneKey, list[RunKey]]:
    """Cells without a result, by scene. Failed ones count as missing: they are tried again."""
    rows = known_rows(path)
    todo: dict[SceneKey, list[RunKey]] = {}
    for cell in dict.fromkeys(cells):
        row = rows.get(cell_key(cell.key()))
        if row is None or row["status"] != "ok":
            todo.setdefault(cell.scene, []).append(cell.run)
    return todo


def run_cells(cells: Sequence[Cell], *, n_workers: int, scheduler: str = "", path: Path = STORE) -> list[Row]:
    """Results of all cells in the order given; computes those that the store lacks, in n_workers processes.

    scheduler : address of a dask scheduler whose workers have this checkout; they then do the work instead.

    A cell that failed comes back with its message as status; a process that dies loses its scene only.
    """
    todo = missing(cells, path)
    begun = time.perf_counter()
    n_runs = sum(map(len, todo.values()))
    if todo:
        _say(f"{len(cells)} cells, {n_runs} to compute on {len(todo)} scenes")
    if n_workers <= 1 and not scheduler:
        for i, (scene, runs) in enumerate(todo.items()):
            append_rows(run_scene(scene, runs), path)
            _say_progress(i + 1, len(todo), scene, begun)
    elif todo:
        with _pool(n_workers, scheduler) as pool:
            futures = {pool.submit(run_scene, scene, runs): scene for scene, runs in todo.items()}
            for i, future in enumerate(as_completed(futures)):
                error = future.exception()
                if error is None:
                    append_rows(future.result(), path)
                else:
                    _say(f"lost {futures[future]}: {type(error).__name__}: {error}")
                _say_progress(i + 1, len(todo), futures[future], begun)
    rows = known_rows(path)
    lost = dict.fromkeys(VALUE_FIELDS, "") | {"status": "lost"}
    return [rows.get(cell_key(cell.key()), cell.key() | lost) for cell in cells]


@contextmanager
def _pool(n_workers: int, scheduler: str) -> Iterator[Executor]:
    """Processes of this machine or the workers of a scheduler."""
    if not scheduler:
        with ProcessPoolExecutor(n_workers, mp_context=multiprocessing.get_context("spawn")) as pool:
            yield pool
        return
    from distributed import Client

    with Client(scheduler) as client:
        yield client.get_executor(pure=False)


def _say_progress(done: int, n: int, scene: SceneKey, begun: float) -> None:
    _say(f"{done}/{n} scenes, {time.perf_counter() - begun:.0f} s, last {scene}")


def _say(text: str) -> None:
    sys.stderr.write(text + "\n")
    sys.stderr.flush()
