"""`mocap run`, its single stages, and `mocap demo`: from a session to motion."""

from __future__ import annotations

import json
import shlex
import time
from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from mocap.cli import complete
from mocap.cli.interrupt import how_to_go_on
from mocap.cli.options import (
    CalibrationOption,
    DeviceOption,
    ExpectedOption,
    FilterOption,
    FramesOption,
    ObservationOption,
    OutPath,
    PresetOption,
    RehashOption,
    ResumeOption,
    SeedOption,
    SessionPath,
    SetOption,
    ThreadsOption,
    check_choice,
    command_line,
    parse_frames,
    read_config,
)
from mocap.cli.progress import FinishedStages, progress_bar
from mocap.cli.scores import echo_scores
from mocap.profiling import profiled

if TYPE_CHECKING:
    from mocap.pipeline.record import RunResult


@dataclass(frozen=True)
class Order:
    """What is to be run, as it was typed.

    until : the last stage.  go_on : the command that finishes it after Ctrl-C.  profile : whether to say where the time
    goes.
    """

    session: Path
    out: Path
    until: str = "report"
    preset: str = "default"
    settings: list[str] | None = None
    seed: int = 0
    frames: str | None = None
    calibration: Path | None = None
    threads: int | None = None
    resume: bool = False
    rehash: bool = False
    go_on: str = ""
    filter_name: str | None = None
    observation: str | None = None
    expected_persons: int | None = None
    device: str | None = None
    profile: bool = False


def _list_filters(value: bool) -> None:
    if value:
        from mocap.filters import FILTERS

        typer.echo("\n".join(FILTERS))
        raise typer.Exit


def demo(
    out: Annotated[Path, typer.Option("-o", "--out", help="Folder for session and result.")] = Path(
        "out/demo"
    ),
    scene: Annotated[
        str, typer.Option("--scene", help="Scene to synthesise.", autocompletion=complete.scenes)
    ] = "demo",
    seed: SeedOption = 0,
    preset: PresetOption = "default",
) -> None:
    """Make a small synthetic session, run everything on it and score it against its exact truth."""
    started = time.perf_counter()
    from mocap.synth import synthesise

    read_config(preset, None)  # a mistake is said before a minute of drawing
    session = out / "session"
    typer.echo(f"1. Synthesising the scene '{scene}' into {session}")
    with progress_bar() as progress:
        synthesise(scene, session, progress=progress)
    made = time.perf_counter() - started
    typer.echo(f"   {made:.1f} s")
    typer.echo(f"2. Running the pipeline into {out / 'result'}")
    go_on = ["mocap", "run", str(session), "-o", str(out / "result"), "--seed", str(seed), "--preset", preset]
    result = _run(
        Order(session, out / "result", preset=preset, seed=seed, go_on=shlex.join([*go_on, "--resume"]))
    )
    from mocap.io._files import atomic_text

    atomic_text(out / "result" / "scores.json", json.dumps(result.scores, indent=1) + "\n")
    typer.echo(f"Done in {time.perf_counter() - started:.0f} s. What to do next:")
    typer.echo(f"  open {out / 'result' / 'report.html'} in a browser: pictures, errors, timing")
    typer.echo(f"  load {out / 'result' / 'person_1.bvh'} into an animation tool")
    typer.echo("  mocap check SESSION; mocap run SESSION -o OUT    your own cameras (docs/session.md)")


def run(
    session: SessionPath,
    out: OutPath,
    preset: PresetOption = "default",
    settings: SetOption = None,
    filter_name: FilterOption = None,
    observation: ObservationOption = None,
    expected_persons: ExpectedOption = None,
    seed: SeedOption = 0,
    frames: FramesOption = None,
    until: Annotated[
        str,
        typer.Option(
            "--until",
            help="Last stage: segment, occluders, carve, track, pose, report.",
            autocompletion=complete.stages,
        ),
    ] = "report",
    resume: ResumeOption = False,
    rehash: RehashOption = False,
    calibration: CalibrationOption = None,
    threads: ThreadsOption = None,
    device: DeviceOption = None,
    profile: Annotated[bool, typer.Option("--profile", help="Print where the time goes, by part.")] = False,
    _list: Annotated[
        bool,
        typer.Option(
            "--list-filters", is_eager=True, callback=_list_filters, help="Print the filters' names."
        ),
    ] = False,
) -> None:
    """Camera folder to motion: masks, volumes, tracks, poses, exports and report."""
    from mocap.pipeline.chains import UNTIL

    check_choice("--until", until, UNTIL)
    _run(
        Order(
            session,
            out,
            until=until,
            preset=preset,
            settings=settings,
            seed=seed,
            frames=frames,
            calibration=calibration,
            threads=threads,
            resume=resume,
            rehash=rehash,
            go_on=command_line() if resume else f"{command_line()} --resume",
            filter_name=filter_name,
            observation=observation,
            expected_persons=expected_persons,
            device=device,
            profile=profile,
        )
    )


def _stage_command(stage: str, words: str) -> Callable[..., None]:
    """The command of one stage, which takes over what is finished in OUT."""

    def command(
        session: SessionPath,
        out: OutPath,
        preset: PresetOption = "default",
        settings: SetOption = None,
        seed: SeedOption = 0,
        frames: FramesOption = None,
        calibration: CalibrationOption = None,
        threads: ThreadsOption = None,
        rehash: RehashOption = False,
    ) -> None:
        _run(
            Order(
                session,
                out,
                until=stage,
                preset=preset,
                settings=settings,
                seed=seed,
                frames=frames,
                calibration=calibration,
                threads=threads,
                resume=True,
                rehash=rehash,
                go_on=command_line(),
            )
        )

    command.__doc__ = words
    return command


segment = _stage_command("segment", "Foreground masks of every frame into OUT/store.zarr.")
carve = _stage_command("carve", "Coloured hulls of every frame; takes over finished masks in OUT.")
pose = _stage_command("pose", "Poses: OUT/landmarks.csv and pose.npz; takes over finished tracks in OUT.")


def track(
    session: SessionPath,
    out: OutPath,
    preset: PresetOption = "default",
    settings: SetOption = None,
    expected_persons: ExpectedOption = None,
    seed: SeedOption = 0,
    frames: FramesOption = None,
    calibration: CalibrationOption = None,
    threads: ThreadsOption = None,
    rehash: RehashOption = False,
) -> None:
    """Who is where: OUT/tracks.csv; takes over finished hulls in OUT."""
    _run(
        Order(
            session,
            out,
            until="track",
            preset=preset,
            settings=settings,
            seed=seed,
            frames=frames,
            calibration=calibration,
            threads=threads,
            resume=True,
            rehash=rehash,
            go_on=command_line(),
            expected_persons=expected_persons,
        )
    )


def _run(order: Order) -> RunResult:
    """Run what is ordered and say what was found; Ctrl-C says what was kept."""
    from mocap.pipeline.stretches import run_recording

    config = read_config(
        order.preset,
        order.settings,
        filter_name=order.filter_name,
        observation=order.observation,
        expected_persons=order.expected_persons,
        device=order.device,
    )
    done = FinishedStages()
    listening = profiled() if order.profile else nullcontext()
    with listening as profile, how_to_go_on(lambda: _kept(order, done)), progress_bar() as show:
        result = run_recording(
            order.session,
            order.out,
            config=config,
            seed=order.seed,
            until=order.until,
            resume=order.resume,
            rehash=order.rehash,
            frames=parse_frames(order.frames),
            calibration=order.calibration,
            n_threads=order.threads,
            progress=done.watching(show),
            command=command_line(),
        )
    echo_result(result)
    if profile is not None:
        typer.echo("\n".join(profile.lines(len(result.session.frames))))
    return result


def _kept(order: Order, done: FinishedStages) -> str:
    """What an interrupted run leaves behind, and the command that goes on from there."""
    stages = ", ".join(done.stages)
    kept = f"Finished and kept in {order.out}: {stages}." if stages else "No stage was finished this time."
    return f"{kept} Go on with: {order.go_on}"


def echo_result(result: RunResult) -> None:
    """What was found, warnings, time per stage and where to look: a few lines on standard output."""
    n = len(result.session.frames)
    persons = "" if result.tracks is None else f", {_count(len(result.tracks.persons), 'person')}"
    typer.echo(f"{result.session.name}: {n} frames, {len(result.session.rig)} cameras{persons}")
    for warning in result.warnings:
        typer.echo(f"  warning: {warning}")
    for stage in result.reused:
        typer.echo(f"  {stage:<8} reused")
    for stage, seconds in result.timings_s.items():
        if stage == "report" and result.status != "complete":
            continue
        typer.echo(f"  {stage:<8} {seconds:8.2f} s  {n / max(seconds, 1e-9):8.1f} frames/s")
    if result.scores is not None:
        echo_scores(result.scores)
    if result.record.removed:
        typer.echo(f"  removed  {', '.join(result.record.removed)}, of an earlier run")
    if "report.html" in result.record.files:
        typer.echo(f"Look at {result.out / 'report.html'}")
    else:
        typer.echo(f"Written to {result.out}")


def _count(n: int, noun: str) -> str:
    return f"{n} {noun}{'s' * (n != 1)}"
