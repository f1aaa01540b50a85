"""`mocap sweep` and `mocap batch`: many runs side by side, here or on a dask cluster."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from mocap.cli.interrupt import how_to_go_on
from mocap.cli.options import check_choice, parse_frames
from mocap.cli.progress import cell_progress
from mocap.errors import MocapError

if TYPE_CHECKING:
    from mocap.pipeline.cluster import Engine, SweepCell, SweepResult, SweepSpec

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
    sessions: Annotated[
        list[Path], typer.Argument(metavar="SESSION", help="Session folders, or folders of sessions.")
    ],
    out: Annotated[Path, typer.Option("-o", "--out", help="Folder for runs and tables.")],
    preset: Annotated[str, typer.Option("--preset", help="As for `mocap run`.")] = "default",
    settings: Annotated[
        list[str] | None, typer.Option("--set", help="Change one setting: section.key=value (repeatable).")
    ] = None,
    seed: Annotated[int, typer.Option("--seed", min=0, help="Same seed, same bytes.")] = 0,
    frames: Annotated[str | None, typer.Option("--frames", help="a:b, frames a to b - 1.")] = None,
    pieces: Annotated[
        int,
        typer.Option(
            "--pieces", min=1, help="Cut every recording into so many, run side by side and joined."
        ),
    ] = 1,
    overlap: Annotated[
        float, typer.Option("--overlap", min=0.0, help="Seconds that neighbouring pieces share.")
    ] = 2.0,
    workers: WorkersOption = None,
    scheduler: SchedulerOption = None,
    threads: CellThreadsOption = 1,
) -> None:
    """Many sessions, one run each, and a table of scores; finished runs are not repeated."""
    from mocap.pipeline.cluster import Pieces, find_sessions, run_batch

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
            pieces=Pieces(pieces, overlap),
            n_threads=threads,
            progress=cell_progress("batch"),
        )
    _echo_result(result, out, is_summary=False)


def sweep(
    spec: Annotated[
        Path, typer.Argument(metavar="SPEC", help="TOML file: sessions, presets, settings, seeds.")
    ],
    out: Annotated[Path | None, typer.Option("-o", "--out", help="Folder for results and tables.")] = None,
    plan: Annotated[bool, typer.Option("--plan", help="Print the cells and run nothing.")] = False,
    sample: Annotated[
        int | None, typer.Option("--sample", min=1, help="Only so many cells, by chance.")
    ] = None,
    sample_seed: Annotated[
        int | None, typer.Option("--sample-seed", min=0, help="Another seed, another sample.")
    ] = None,
    keep: Annotated[bool, typer.Option("--keep", help="Keep the tables and poses of every cell.")] = False,
    retries: Annotated[
        int, typer.Option("--retries", min=0, help="How often cells that fail are tried again.")
    ] = 0,
    shard: Annotated[
        str | None, typer.Option("--shard", help="i/n, only the i-th of n parts, for a job of an array.")
    ] = None,
    join: Annotated[bool, typer.Option("--join", help="Put the shards together: the tables of all.")] = False,
    emit: Annotated[
        str | None, typer.Option("--emit", help="Print a workflow of shards: snakemake or nextflow.")
    ] = None,
    shards: Annotated[
        int | None,
        typer.Option("--shards", min=1, help="--emit: into how many shards; else one for each cell."),
    ] = None,
    workers: WorkersOption = None,
    scheduler: SchedulerOption = None,
    threads: CellThreadsOption = 1,
) -> None:
    """All combinations of sessions, presets, settings and seeds; finished cells are not repeated."""
    from mocap.pipeline.cluster import plan_cells, read_sweep_spec

    _check_ways({"--plan": plan, "--shard": shard is not None, "--join": join, "--emit": emit is not None})
    if shards is not None and emit is None:
        raise MocapError("--shards is for --emit", remedy="write --shard i/n to run one shard")
    read = read_sweep_spec(spec)
    cells = plan_cells(read, sample=sample, sample_seed=sample_seed)
    if plan:
        _echo_plan(cells)
        return
    if out is None:
        raise MocapError(
            "there is no folder for the results", remedy="give one with -o, or --plan to look only"
        )
    if emit is not None:
        given = {"--sample": sample, "--sample-seed": sample_seed}
        options = [word for name, value in given.items() if value is not None for word in (name, str(value))]
        _echo_workflow(
            emit, spec, out, shards or len(cells), [*options, *(["--keep"] if keep else [])], threads
        )
        return
    if join:
        from mocap.pipeline.cluster import join_shards

        _echo_result(join_shards(read, out, cells=cells, keep_runs=keep), out, is_summary=True)
        return
    if shard is not None:
        from mocap.pipeline.cluster.shards import cells_of_shard, folder_of_shard, parse_shard

        i, n = parse_shard(shard)
        cells, out = cells_of_shard(cells, i, n), folder_of_shard(out, i, n)
    _run_cells(
        read, cells, out, engine=_engine(workers, scheduler), threads=threads, keep=keep, retries=retries
    )


def _check_ways(given: dict[str, bool]) -> None:
    """One way at a time."""
    names = [name for name, is_given in given.items() if is_given]
    if len(names) > 1:
        raise MocapError(f"{' and '.join(names)} were both given", remedy="give one of them")


def _echo_plan(cells: Sequence[SweepCell]) -> None:
    from mocap.pipeline.cluster.tables import plain_table
    from mocap.pipeline.config import load_config

    for cell in cells:
        load_config(cell.preset, cell.settings)  # a setting that does not exist is better found here
    rows = [
        {"cell": c.index, "session": c.session_name, "preset": c.preset, "seed": c.seed, **c.varied}
        for c in cells
    ]
    typer.echo(plain_table(rows))
    typer.echo(f"{len(cells)} cells; nothing was run (--plan)")


def _echo_workflow(kind: str, spec: Path, out: Path, n: int, options: list[str], threads: int) -> None:
    from mocap.pipeline.cluster.shards import WORKFLOWS, workflow

    check_choice("--emit", kind, WORKFLOWS)
    typer.echo(workflow(kind, spec, out, n, options=options, n_threads=threads), nl=False)


def _run_cells(
    spec: SweepSpec,
    cells: Sequence[SweepCell],
    out: Path,
    *,
    engine: Engine,
    threads: int,
    keep: bool,
    retries: int,
) -> None:
    from mocap.pipeline.cluster import run_sweep

    typer.echo(f"{len(cells)} cells into {out}")
    with how_to_go_on(lambda: _finished_cells(out)):
        result = run_sweep(
            spec,
            out,
            engine=engine,
            cells=cells,
            n_threads=threads,
            keep_runs=keep,
            retries=retries,
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
