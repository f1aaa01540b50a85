"""`mocap sweep` and `mocap batch`: many runs side by side, here or on a dask cluster."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from mocap.cli.interrupt import how_to_go_on
from mocap.cli.options import parse_frames
from mocap.cli.progress import cell_progress
from mocap.errors import MocapError

if TYPE_CHECKING:
    from mocap.pipeline.cluster import Engine, SweepResult

# Exit code when the command did its work but some cells failed; 2 is for mistakes in the command itself.
SOME_FAILED = 1

SchedulerOption = Annotated[
    str | None,
    typer.Option(
        "--scheduler", help="Address of a running dask scheduler, tcp://HOST:8786; default: this machine."
    ),
]
WorkersOption = Annotated[
    int | None,
    typer.Option("--workers", min=0, help="Processes on this machine; 0 = in this one, without dask."),
]
CellThreadsOption = Annotated[int, typer.Option("--threads", min=1, help="Threads of each cell.")]


def batch(
    sessions: Annotated[list[Path], typer.Argument(help="Session folders, or folders of sessions.")],
    out: Annotated[Path, typer.Option("-o", "--out", help="Folder for runs and tables.")],
    preset: Annotated[str, typer.Option("--preset", help="As for `mocap run`.")] = "default",
    settings: Annotated[
        list[str] | None, typer.Option("--set", help="Change one setting: section.key=value (repeatable).")
    ] = None,
    seed: Annotated[int, typer.Option("--seed", min=0, help="Same seed, same bytes.")] = 0,
    frames: Annotated[str | None, typer.Option("--frames", help="a:b, frames a to b - 1.")] = None,
    workers: WorkersOption = None,
    scheduler: SchedulerOption = None,
    threads: CellThreadsOption = 1,
) -> None:
    """Many sessions, one run each, and a table of scores; finished runs are not repeated."""
    from mocap.pipeline.cluster import find_sessions, run_batch

    found = find_sessions(sessions)
    typer.echo(f"{len(found)} session{'s' * (len(found) != 1)} into {out}")
    with how_to_go_on(lambda: _finished_cells(out)):
        result = run_batch(
            found,
            out,
            engine=_engine(workers, scheduler),
            preset=preset,
            settings=settings or (),
            seed=seed,
            frames=parse_frames(frames),
            n_threads=threads,
            progress=cell_progress("batch"),
        )
    _echo_result(result, out, is_summary=False)


def sweep(
    spec: Annotated[Path, typer.Argument(help="TOML file: sessions, presets, settings, seeds.")],
    out: Annotated[Path | None, typer.Option("-o", "--out", help="Folder for results and tables.")] = None,
    plan: Annotated[bool, typer.Option("--plan", help="Print the cells and run nothing.")] = False,
    sample: Annotated[
        int | None, typer.Option("--sample", min=1, help="Only so many cells, by chance.")
    ] = None,
    sample_seed: Annotated[
        int | None, typer.Option("--sample-seed", min=0, help="Another seed, another sample.")
    ] = None,
    keep: Annotated[bool, typer.Option("--keep", help="Keep the tables and poses of every cell.")] = False,
    workers: WorkersOption = None,
    scheduler: SchedulerOption = None,
    threads: CellThreadsOption = 1,
) -> None:
    """All combinations of sessions, presets, settings and seeds; finished cells are not repeated."""
    from mocap.pipeline.cluster import plan_cells, read_sweep_spec, run_sweep
    from mocap.pipeline.cluster.tables import plain_table

    read = read_sweep_spec(spec)
    cells = plan_cells(read, sample=sample, sample_seed=sample_seed)
    if plan:
        from mocap.pipeline.config import load_config

        for cell in cells:
            load_config(cell.preset, cell.settings)  # a setting that does not exist is better found here
        rows = [
            {"cell": c.index, "session": c.session_name, "preset": c.preset, "seed": c.seed, **c.varied}
            for c in cells
        ]
        typer.echo(plain_table(rows))
        typer.echo(f"{len(cells)} cells; nothing was run (--plan)")
        return
    if out is None:
        raise MocapError(
            "there is no folder for the results", remedy="give one with -o, or --plan to look only"
        )
    typer.echo(f"{len(cells)} cells into {out}")
    with how_to_go_on(lambda: _finished_cells(out)):
        result = run_sweep(
            read,
            out,
            engine=_engine(workers, scheduler),
            cells=cells,
            n_threads=threads,
            keep_runs=keep,
            progress=cell_progress("sweep"),
        )
    _echo_result(result, out, is_summary=True)


def _finished_cells(out: Path) -> str:
    return f"What is finished is kept in {out}; repeat the command to go on."


def _engine(workers: int | None, scheduler: str | None) -> Engine:
    from mocap.pipeline.cluster import Engine

    if scheduler is not None and workers is not None:
        raise MocapError(
            "--workers and --scheduler were both given",
            remedy="--workers is for this machine; a scheduler's workers are started with `dask worker ADDRESS`",
        )
    return Engine(scheduler=scheduler, n_workers=workers)


def _echo_result(result: SweepResult, out: Path, *, is_summary: bool) -> None:
    import csv

    from mocap.pipeline.cluster.tables import plain_table

    with (out / ("summary.csv" if is_summary else "table.csv")).open(encoding="utf-8", newline="") as stream:
        rows = list(csv.DictReader(stream))
    for line in rows:
        line.pop("error", None)
    typer.echo(plain_table(rows))
    failures = [row for row in result.rows if not row.outcome.is_done]
    for row in failures[:10]:
        what = ", ".join(f"{name} {value}" for name, value in row.columns.items())
        typer.echo(f"  failed: {what}: {row.outcome.error}")
    if len(failures) > 10:
        typer.echo(f"  ... and {len(failures) - 10} more; see the column error of {out / 'table.csv'}")
    typer.echo(f"Tables in {out / 'table.csv'}, table.json and table.html")
    if failures:
        typer.echo("Run the same command again to try the failed ones again; finished ones are kept.")
        raise typer.Exit(SOME_FAILED)
