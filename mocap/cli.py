"""The command line: `mocap COMMAND`. Errors name file, camera, frame and remedy, and exit with code 2."""

from __future__ import annotations

import json
import shlex
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from mocap import cli_cluster, cli_tools
from mocap.errors import MocapError
from mocap.portable import Stopped, stoppable

if TYPE_CHECKING:
    from mocap.pipeline.record import RunResult
    from mocap.pipeline.stage import Progress

app = typer.Typer(
    name="mocap",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
    help="Calibrated multi-camera video to 3D human motion, without neural weights.\n\n"
    "Start with `mocap demo`, then `mocap check SESSION` and `mocap run SESSION -o OUT` on your own folder.",
)

SessionPath = Annotated[
    Path, typer.Argument(help="Session folder: calibration, videos/ or images/, background/ ...")
]
OutPath = Annotated[Path, typer.Option("-o", "--out", help="Folder for the results.")]
PresetOption = Annotated[
    str, typer.Option("--preset", help="default, realtime, reference, thesis_body, or a TOML file.")
]
SetOption = Annotated[
    list[str] | None, typer.Option("--set", help="Change one setting: section.key=value (repeatable).")
]
SeedOption = Annotated[int, typer.Option("--seed", min=0, help="Same seed, same bytes.")]
FramesOption = Annotated[
    str | None, typer.Option("--frames", help="a:b, frames a to b - 1; either may be left out.")
]
CalibrationOption = Annotated[
    Path | None, typer.Option("--calibration", help="Calibration file instead of the session's own.")
]
ThreadsOption = Annotated[
    int | None, typer.Option("--threads", min=1, help="Threads; results do not depend on it.")
]
ResumeOption = Annotated[
    bool, typer.Option("--resume", help="Reuse stage products in OUT that nothing has changed for.")
]
ExpectedOption = Annotated[
    int | None,
    typer.Option("--expected-persons", min=1, help="Most persons there can be: who is lost is waited for."),
]
FilterOption = Annotated[str | None, typer.Option("--filter", help="Pose filter; see --list-filters.")]
ObservationOption = Annotated[
    str | None,
    typer.Option("--observation", help="voxels, markers or auto (markers when the session has detections/)."),
]


def main() -> None:
    """Entry point: user mistakes become one message and exit code 2, without a traceback."""
    try:
        with stoppable():
            app(standalone_mode=True)
    except MocapError as error:
        _fail(str(error))
    except Stopped as stopped:
        _fail(
            f"stopped by {stopped}. Finished stages are kept; continue with --resume.",
            code=128 + stopped.number,
        )
    except BrokenPipeError:
        sys.stderr.close()
        sys.exit(1)
    except OSError as error:
        name = f" (file {error.filename})" if error.filename else ""
        _fail(
            f"{error.strerror or error}{name}. Remedy: check that the disk has space left and that files and "
            "folders may be read and written."
        )
    except MemoryError:
        _fail("out of memory. Remedy: use larger voxels (--set volume.voxel_size_m=0.03) or a smaller room.")


def _fail(message: str, code: int = 2) -> None:
    sys.stderr.write(f"mocap: error: {message}\n")
    sys.exit(code)


def _parse_frames(text: str | None) -> tuple[int | None, int | None] | None:
    if text is None:
        return None
    first, colon, last = text.partition(":")
    try:
        a = int(first) if first.strip() else None
        b = int(last) if last.strip() else None
    except ValueError:
        a, b, colon = None, None, ""
    if not colon or (a is not None and a < 0) or (b is not None and b < 0):
        raise MocapError(
            f"cannot read the frame range {text!r}", remedy="write --frames a:b, for example 0:100"
        )
    return a, b


@contextmanager
def _progress() -> Iterator[Progress]:
    """A bar with time left per stage on a terminal, plain lines elsewhere."""
    if sys.stderr.isatty():
        from rich.console import Console
        from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

        bar = Progress(
            TextColumn("{task.description:>10}"),
            BarColumn(),
            MofNCompleteColumn(),
            TimeRemainingColumn(elapsed_when_finished=True),
            console=Console(stderr=True),
        )
        tasks: dict[str, Any] = {}
        with bar:

            def show(stage: str, done: int, total: int) -> None:
                if stage not in tasks:
                    tasks[stage] = bar.add_task(stage, total=total)
                bar.update(tasks[stage], completed=done, total=total)

            yield show
        return
    last: dict[str, float] = {}
    finished: dict[str, int] = {}

    def say(stage: str, done: int, total: int) -> None:
        now = time.monotonic()
        if stage not in last:
            last[stage] = now  # the first line comes after ten seconds, or at the end
        if done == total and total == finished.get(stage):
            return
        if done == total or now - last[stage] > 10.0:
            last[stage] = now
            if done == total:
                finished[stage] = total
            sys.stderr.write(f"{stage}: {done}/{total}\n")
            sys.stderr.flush()

    yield say


def _config(
    preset: str,
    settings: list[str] | None,
    filter_name: str | None = None,
    observation: str | None = None,
    expected_persons: int | None = None,
) -> Any:
    from mocap.pipeline.config import load_config

    extra = [f"pose.filter={filter_name}"] if filter_name else []
    extra += [f"observation={observation}"] if observation else []
    extra += [f"tracking.expected_persons={expected_persons}"] if expected_persons else []
    return load_config(preset, (*(settings or []), *extra))


def _list_filters(value: bool) -> None:
    if value:
        from mocap.filters import FILTERS

        typer.echo("\n".join(FILTERS))
        raise typer.Exit


def _run(
    session: Path,
    out: Path,
    *,
    until: str,
    preset: str,
    settings: list[str] | None,
    seed: int,
    frames: str | None,
    calibration: Path | None,
    threads: int | None,
    resume: bool,
    filter_name: str | None = None,
    observation: str | None = None,
    expected_persons: int | None = None,
) -> RunResult:
    from mocap.pipeline.run import run_session

    config = _config(preset, settings, filter_name, observation, expected_persons)
    with _progress() as progress:
        result = run_session(
            session,
            out,
            config=config,
            seed=seed,
            until=until,
            resume=resume,
            frames=_parse_frames(frames),
            calibration=calibration,
            n_threads=threads,
            progress=progress,
            command=shlex.join(["mocap", *sys.argv[1:]]),
        )
    _say_result(result)
    return result


def _say_result(result: RunResult) -> None:
    """What was found, warnings, time per stage and where to look: a few lines on standard output."""
    n = len(result.session.frames)
    persons = len(result.tracks.persons) if result.tracks is not None else None
    found = "" if persons is None else f", {persons} person{'s' * (persons != 1)}"
    typer.echo(f"{result.session.name}: {n} frames, {len(result.session.rig)} cameras{found}")
    for warning in result.warnings:
        typer.echo(f"  warning: {warning}")
    for stage in result.reused:
        typer.echo(f"  {stage:<8} reused")
    for stage, seconds in result.timings_s.items():
        if stage == "report" and result.status != "complete":
            continue
        typer.echo(f"  {stage:<8} {seconds:8.2f} s  {n / max(seconds, 1e-9):8.1f} frames/s")
    if result.scores is not None:
        _say_scores(result.scores)
    if result.record.removed:
        typer.echo(f"  removed  {', '.join(result.record.removed)}, of an earlier run")
    if "report.html" in result.record.files:
        typer.echo(f"Look at {result.out / 'report.html'}")
    else:
        typer.echo(f"Written to {result.out}")


_SCORE_ROWS = (
    ("mean_error_mm", "mean landmark error", "mm"),
    ("std_error_mm", "its deviation over frames", "mm"),
    ("mmtp_mm", "MMTP, error of matched landmarks", "mm"),
    ("mmta_percent", "MMTA, landmarks within epsilon", "%"),
    ("epsilon_mm", "epsilon", "mm"),
    ("mean_error_after_offset_mm", "error after constant offsets", "mm"),
    ("angle_mean_deg", "mean joint-angle error", "deg"),
    ("motp_mm", "MOTP, position of persons", "mm"),
    ("mota_percent", "MOTA, tracking accuracy", "%"),
    ("volume_iou", "overlap of hull and true body", ""),
    ("coverage_90_percent", "truth inside 90 % regions", "%"),
)


def _say_scores(scores: dict[str, Any]) -> None:
    if scores.get("tracks_only"):
        typer.echo("Scores against the truth, of the tracks alone:")
    elif scores.get("mean_error_mm") is None:
        typer.echo("Scores against the truth: nobody of the truth was found, so there is no error to give.")
    else:
        typer.echo("Scores against the truth:")
    for key, words, unit in _SCORE_ROWS:
        value = scores.get(key)
        if value is None or (key == "epsilon_mm" and scores.get("tracks_only")):
            continue
        text = f"{value:.2f}" if key == "volume_iou" else f"{value:.1f}"
        typer.echo(f"  {words:<34} {text:>8} {unit}")
    if scores.get("unit_warning"):
        typer.echo(f"  warning: {scores['unit_warning']}")


@app.command()
def demo(
    out: Annotated[Path, typer.Option("-o", "--out", help="Folder for session and result.")] = Path(
        "out/demo"
    ),
    scene: Annotated[str, typer.Option("--scene", help="Scene to synthesise.")] = "demo",
    seed: SeedOption = 0,
    preset: PresetOption = "default",
) -> None:
    """Make a small synthetic session, run everything on it and score it against its exact truth."""
    started = time.perf_counter()
    from mocap.synth import synthesise

    session = out / "session"
    typer.echo(f"1. Synthesising the scene '{scene}' into {session}")
    with _progress() as progress:
        synthesise(scene, session, progress=progress)
    made = time.perf_counter() - started
    typer.echo(f"   {made:.1f} s")
    typer.echo(f"2. Running the pipeline into {out / 'result'}")
    result = _run(
        session,
        out / "result",
        until="report",
        preset=preset,
        settings=None,
        seed=seed,
        frames=None,
        calibration=None,
        threads=None,
        resume=False,
    )
    from mocap.io._files import atomic_text

    atomic_text(out / "result" / "scores.json", json.dumps(result.scores, indent=1) + "\n")
    typer.echo(f"Done in {time.perf_counter() - started:.0f} s. What to do next:")
    typer.echo(f"  open {out / 'result' / 'report.html'} in a browser: pictures, errors, timing")
    typer.echo(f"  load {out / 'result' / 'person_1.bvh'} into an animation tool")
    typer.echo("  mocap check SESSION; mocap run SESSION -o OUT    your own cameras (docs/session.md)")


@app.command()
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
        str, typer.Option("--until", help="Last stage: segment, carve, track, pose, report.")
    ] = "report",
    resume: ResumeOption = False,
    calibration: CalibrationOption = None,
    threads: ThreadsOption = None,
    _list: Annotated[
        bool,
        typer.Option(
            "--list-filters", is_eager=True, callback=_list_filters, help="Print the filters' names."
        ),
    ] = False,
) -> None:
    """Camera folder to motion: masks, volumes, tracks, poses, exports and report."""
    from mocap.pipeline.chains import UNTIL

    if until not in UNTIL:
        raise MocapError(f"there is no stage named {until!r}", remedy=f"use one of {', '.join(UNTIL)}")
    _run(
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
        filter_name=filter_name,
        observation=observation,
        expected_persons=expected_persons,
    )


def _stage_command(stage: str, words: str) -> None:
    def command(
        session: SessionPath,
        out: OutPath,
        preset: PresetOption = "default",
        settings: SetOption = None,
        seed: SeedOption = 0,
        frames: FramesOption = None,
        calibration: CalibrationOption = None,
        threads: ThreadsOption = None,
    ) -> None:
        _run(
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
        )

    command.__doc__ = words
    app.command(name=stage)(command)


_stage_command("segment", "Foreground masks of every frame into OUT/store.zarr.")
_stage_command("carve", "Coloured hulls of every frame; takes over finished masks in OUT.")


@app.command()
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
) -> None:
    """Who is where: OUT/tracks.csv; takes over finished hulls in OUT."""
    _run(
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
        expected_persons=expected_persons,
    )


_stage_command("pose", "Poses: OUT/landmarks.csv and pose.npz; takes over finished tracks in OUT.")


@app.command(name="eval")
def evaluate(
    estimate: Annotated[
        Path, typer.Argument(help="Output folder of a run, or a file: TRC, C3D, BVH, CSV, Panoptic JSON.")
    ],
    truth: Annotated[Path, typer.Argument(help="Session folder with truth, or a file as for the estimate.")],
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
    html: Annotated[Path | None, typer.Option("--html", help="Write a page with pictures.")] = None,
    epsilon_mm: Annotated[float, typer.Option("--epsilon", min=1.0, help="Matching threshold, mm.")] = 100.0,
    map_path: Annotated[
        Path | None, typer.Option("--map", help="TOML: which points are our landmarks, units, axes.")
    ] = None,
    estimate_unit: Annotated[
        str | None, typer.Option("--estimate-unit", help="m, cm or mm, whatever the file says.")
    ] = None,
    truth_unit: Annotated[str | None, typer.Option("--truth-unit", help="The same of the truth.")] = None,
    estimate_up: Annotated[
        str | None, typer.Option("--estimate-up", help="Axis of the file that is up: x, -x, y, -y, z, -z.")
    ] = None,
    truth_up: Annotated[str | None, typer.Option("--truth-up", help="The same of the truth.")] = None,
    estimate_fps: Annotated[
        float | None, typer.Option("--estimate-fps", min=0.001, help="Frames per second of the estimate.")
    ] = None,
    truth_fps: Annotated[
        float | None, typer.Option("--truth-fps", min=0.001, help="Frames per second of the truth.")
    ] = None,
    frame_offset: Annotated[
        int, typer.Option("--frame-offset", help="Added to the frame numbers of the estimate.")
    ] = 0,
    time_offset: Annotated[
        float, typer.Option("--time-offset", help="Added to the times of the estimate, s.")
    ] = 0.0,
    actions: Annotated[
        Path | None, typer.Option("--actions", help="CSV first_frame,last_frame,action: scores of each.")
    ] = None,
    cameras: Annotated[
        Path | None, typer.Option("--cameras", help="Calibration: errors in pixels of these cameras too.")
    ] = None,
    epsilon_px: Annotated[float, typer.Option("--epsilon-px", min=0.1, help="Threshold in pixels.")] = 10.0,
    learn_share: Annotated[
        float,
        typer.Option("--learn-share", min=0.01, max=0.9, help="Share of frames that offsets are learnt on."),
    ] = 0.2,
) -> None:
    """Score a run, or poses of another tool, against a truth."""
    from mocap.compare import CompareOptions, compare, write_page
    from mocap.io.poses import SideMap
    from mocap.io.units import AXES, UNITS

    for option, value, known in (
        ("--estimate-unit", estimate_unit, UNITS),
        ("--truth-unit", truth_unit, UNITS),
        ("--estimate-up", estimate_up, AXES),
        ("--truth-up", truth_up, AXES),
    ):
        if value is not None and value not in known:
            raise MocapError(f"{option} is {value!r}", remedy=f"give one of {', '.join(known)}")
    options = CompareOptions(
        epsilon_mm=epsilon_mm,
        epsilon_px=epsilon_px,
        estimate=SideMap(unit=estimate_unit, up=estimate_up, fps=estimate_fps),
        truth=SideMap(unit=truth_unit, up=truth_up, fps=truth_fps),
        map_path=map_path,
        frame_offset=frame_offset,
        time_offset_s=time_offset,
        actions_path=actions,
        cameras_path=cameras,
        learn_share=learn_share,
    )
    comparison = compare(estimate, truth, options)
    if html is not None:
        write_page(html, comparison, command=shlex.join(["mocap", *sys.argv[1:]]))
    if as_json:
        typer.echo(json.dumps(comparison.scores, allow_nan=False))
        return
    _say_comparison(comparison.scores)
    if html is not None:
        typer.echo(f"Look at {html}")


_MORE_ROWS = (
    ("pck_auc_percent", "PCK, area under the curve to 150 mm", "%"),
    ("aligned.root.mean_error_mm", "error, root-aligned", "mm"),
    ("aligned.procrustes.mean_error_mm", "error, Procrustes-aligned (PA)", "mm"),
    ("offset_calibration.after.mean_error_mm", "error after offsets, held-out frames", "mm"),
    ("angles.inverse_kinematics.mean_deg", "angle error after inv. kinematics", "deg"),
    ("epsilon_search.by_lilliefors_mm", "natural epsilon (Lilliefors)", "mm"),
    ("epsilon_search.by_r2_mm", "natural epsilon (R2 of Q-Q line)", "mm"),
    ("acceleration_error_m_s2", "acceleration error", "m/s2"),
    ("hota_percent", "HOTA, tracking", "%"),
    ("idf1_percent", "IDF1, identities", "%"),
    ("image.mean_error_px", "error in the pictures", "px"),
    ("image.mmta_percent", "MMTA in the pictures", "%"),
)


def _say_comparison(scores: dict[str, Any]) -> None:
    _say_scores(scores)
    for path, words, unit in _MORE_ROWS:
        value: Any = scores
        for key in path.split("."):
            value = None if value is None else value.get(key)
        if value is not None:
            typer.echo(f"  {words:<36} {value:>6.1f} {unit}")
    if scores.get("tracks_only"):
        counts = ("misses", "false_positives", "mismatches")
        typer.echo("  " + ", ".join(f"{scores[k]} {k.replace('_', ' ')}" for k in counts))
    if (limbs := scores["lost_limbs"]) and limbs["f1"] is not None:
        typer.echo(f"  {'F1 of lost limbs':<36} {limbs['f1']:>6.2f}")
    for label, row in (scores["per_action"] or {}).items():
        error, share = row["mean_error_mm"], row["mmta_percent"]
        said = "nothing scored" if error is None else f"{error:.1f} mm, MMTA {share:.1f} %"
        typer.echo(f"  {label} ({row['frames']} frames): {said}")
    for note in scores["notes"]:
        typer.echo(f"  note: {note}")
    for warning in scores["warnings"]:
        if warning != scores["unit_warning"]:
            typer.echo(f"  warning: {warning}")


@app.command()
def export(
    result: Annotated[Path, typer.Argument(help="Output folder of a run.")],
    out: Annotated[Path, typer.Option("-o", "--out", help="Folder for the files.")],
    what: Annotated[str, typer.Option("--what", help="voxels or motion.")] = "voxels",
    format: Annotated[
        str | None, typer.Option("--format", help="voxels: ply, npz, glb; motion: bvh, trc, c3d, glb.")
    ] = None,
    frames: FramesOption = None,
    cubes: Annotated[
        bool, typer.Option("--cubes", help="PLY with coloured cubes instead of points.")
    ] = False,
) -> None:
    """Coloured voxels per frame, or motion, from a finished run, for other tools."""
    from mocap.pipeline.export import export_run

    with _progress() as progress:
        written = export_run(
            result,
            out,
            what=what,
            format=format,
            frames=_parse_frames(frames),
            cubes=cubes,
            progress=progress,
        )
    more = f" ... {written[-1].name}" if len(written) > 1 else ""
    typer.echo(f"{len(written)} file{'s' * (len(written) != 1)}: {written[0]}{more}")


@app.command()
def check(
    session: SessionPath,
    calibration: CalibrationOption = None,
    frames: FramesOption = None,
) -> None:
    """Look at a session before running it: calibration, cameras, clips, background, and what to mend."""
    from mocap.io.session import check_session, open_session

    opened = open_session(session, calibration=calibration, frames=_parse_frames(frames))
    findings = check_session(opened)
    for finding in findings:
        where = f" [{finding.camera}]" if finding.camera else ""
        remedy = f" Remedy: {finding.remedy}." if finding.remedy else ""
        typer.echo(f"{finding.severity:>8}{where}: {finding.message}{remedy}")
    n_errors = sum(f.severity == "error" for f in findings)
    n_warnings = sum(f.severity == "warning" for f in findings)
    typer.echo(f"{n_errors} errors, {n_warnings} warnings")
    if n_errors:
        raise typer.Exit(2)


def _list_scenes(value: bool) -> None:
    if value:
        from mocap.synth import list_scenes

        typer.echo("\n".join(list_scenes()))
        raise typer.Exit


@app.command()
def synth(
    out: Annotated[Path, typer.Option("-o", "--out", help="Folder for the session.")],
    scene: Annotated[str, typer.Option("--scene", help="Scene name or TOML file.")] = "demo",
    seed: Annotated[
        int | None, typer.Option("--seed", min=0, help="Another seed than the scene's own.")
    ] = None,
    workers: Annotated[
        int, typer.Option("--workers", min=1, help="Processes; the result does not depend on it.")
    ] = 2,
    body: Annotated[
        str | None, typer.Option("--body", help="Kind of all bodies: own, or anny (optional package anny).")
    ] = None,
    preview: Annotated[
        Path | None, typer.Option("--preview", help="Also write a contact sheet (PNG) of the session.")
    ] = None,
    _list: Annotated[
        bool, typer.Option("--list", is_eager=True, callback=_list_scenes, help="Print the scenes' names.")
    ] = False,
) -> None:
    """Make a synthetic session with exact truth."""
    from mocap.synth import synthesise
    from mocap.synth.preview import check_picture_name

    if preview is not None:
        check_picture_name(preview)
    with _progress() as progress:
        path = synthesise(scene, out, seed=seed, workers=workers, body=body, progress=progress)
    if preview is not None:
        from mocap.synth.preview import preview_sheet

        preview_sheet(path, preview)
        typer.echo(f"Preview in {preview}")
    typer.echo(f"Session in {path}; next: mocap run {path} -o OUT")


@app.command(name="convert-calibration")
def convert_calibration(
    source: Annotated[Path, typer.Argument(help="Calibration file of any supported format.")],
    out: Annotated[Path, typer.Option("-o", "--out", help="TOML file to write (metres, world to camera).")],
    units: Annotated[
        str | None, typer.Option("--units", help="m, cm or mm, when the file does not say.")
    ] = None,
) -> None:
    """Read a calibration of any supported format and write our own TOML in metres."""
    from mocap.io.calibration import read_calibration, write_calibration

    if units is not None and units not in ("m", "cm", "mm"):
        raise MocapError(f"unknown unit {units!r}", remedy="give --units m, cm or mm")
    found = read_calibration(source, units=units, check_world=False)
    write_calibration(out, found.rig, metadata={"source_format": found.format})
    typer.echo(f"{found.format}, units {found.units}: {len(found.rig)} cameras -> {out}")
    for note in (*found.notes, *found.warnings):
        typer.echo(f"  {note}")


cli_tools.add_commands(app)
cli_cluster.add_commands(app)


if __name__ == "__main__":
    main()
