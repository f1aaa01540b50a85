"""Tools before and after a run: check, convert-calibration, export, view, report, doctor and bundle."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from mocap.cli.options import (
    CalibrationOption,
    FramesOption,
    RunPath,
    SessionPath,
    check_choice,
    parse_frames,
)
from mocap.cli.progress import progress_bar
from mocap.compiling import COMPILING
from mocap.errors import MocapError


def view(
    result: RunPath,
    session: Annotated[
        Path | None,
        typer.Argument(metavar="SESSION", help="The run's session; then the scene is written anew."),
    ] = None,
    out: Annotated[
        Path | None, typer.Option("-o", "--out", help="File to write instead of OUT/scene.rrd.")
    ] = None,
    show: Annotated[
        bool, typer.Option("--open", help="Open it in the Rerun viewer, a program of its own.")
    ] = False,
    pictures: Annotated[
        str | None,
        typer.Option(
            "--pictures", help="Cameras whose pictures it holds, such as cam_0,cam_3, or none; else all."
        ),
    ] = None,
    particles: Annotated[
        str | None,
        typer.Option("--particles", help="a:b, frames in which the particles of every layer are shown."),
    ] = None,
) -> None:
    """The 3D scene of a finished run: where it is, written anew, or opened."""
    if session is not None:
        from mocap.pipeline.finished import rewrite_scene

        scene = rewrite_scene(
            result,
            session,
            out,
            pictures=_cameras(pictures),
            particles=parse_frames(particles, "--particles"),
        )
    elif particles is not None:
        raise MocapError(
            "a scene with particles needs the session",
            remedy="write mocap view OUT SESSION --particles 40:50",
        )
    elif pictures is not None:
        raise MocapError(
            "a scene with other pictures needs the session",
            remedy="write mocap view OUT SESSION --pictures cam_0,cam_3",
        )
    elif out is not None:
        raise MocapError("a new scene needs the session", remedy="write mocap view OUT SESSION -o FILE")
    else:
        scene = result / "scene.rrd"
        if not scene.is_file():
            raise MocapError(
                "the run has no 3D scene", path=scene, remedy="write it with `mocap view OUT SESSION`"
            )
    typer.echo(f"Scene in {scene}")
    if show:
        from mocap.pipeline.finished import open_scene

        open_scene(scene)
    else:
        typer.echo(f"Look at it with: mocap view {result} --open, or any Rerun viewer")


def report(
    result: RunPath,
    session: Annotated[Path, typer.Argument(metavar="SESSION", help="The run's session.")],
    video: Annotated[
        bool,
        typer.Option(
            "--video", help="A video of every camera with the bodies drawn in, instead of the page."
        ),
    ] = False,
    cameras: Annotated[
        str | None, typer.Option("--cameras", help="Cameras of the videos, such as cam_0,cam_3; else all.")
    ] = None,
) -> None:
    """Write report.html of a finished run again, without running anything; or videos of its cameras."""
    from mocap.pipeline.finished import rewrite_report, write_overlays

    if not video:
        typer.echo(f"Look at {rewrite_report(result, session)}")
        return
    with progress_bar() as progress:
        written = write_overlays(result, session, cameras=_cameras(cameras), progress=progress)
    typer.echo(f"{len(written)} video{'s' * (len(written) != 1)}: {', '.join(str(path) for path in written)}")


def _cameras(text: str | None) -> tuple[str, ...] | None:
    """Names of cameras as typed; `none` = no camera, None = all."""
    if text is None:
        return None
    return () if text.strip() == "none" else tuple(name.strip() for name in text.split(",") if name.strip())


def export(
    result: RunPath,
    out: Annotated[Path, typer.Option("-o", "--out", help="Folder for the files.")],
    what: Annotated[str, typer.Option("--what", help="voxels, mesh (of the hull) or motion.")] = "voxels",
    format: Annotated[
        str | None,
        typer.Option(
            "--format",
            help="voxels: ply, npz, glb; mesh: ply, glb; motion: bvh, trc, c3d, glb, usd, mot, osim, nc, bids.",
        ),
    ] = None,
    frames: FramesOption = None,
    cubes: Annotated[
        bool, typer.Option("--cubes", help="PLY with coloured cubes instead of points.")
    ] = False,
    bones: Annotated[
        str, typer.Option("--bones", help="Names of bones in BVH, GLB and USD: mocap, mixamo, vrm or unreal.")
    ] = "mocap",
    markers: Annotated[
        str,
        typer.Option(
            "--markers", help="Names of markers in TRC and for OpenSim: mocap, opencap, halpe26, body25b."
        ),
    ] = "mocap",
    fill: Annotated[
        bool, typer.Option("--fill", help="TRC without gaps; person_N_filled.csv lists what was filled.")
    ] = False,
    task: Annotated[
        str | None, typer.Option("--task", help="What BIDS calls the recording; else the session's name.")
    ] = None,
) -> None:
    """Coloured voxels or meshes per frame, or motion, from a finished run, for other tools."""
    from mocap.io.formats import BONE_NAMES, MARKER_NAMES
    from mocap.pipeline.export import EXPORTS, export_run
    from mocap.pipeline.outputs import MotionStyle

    check_choice("--what", what, EXPORTS)
    check_choice("--format", format, EXPORTS[what])
    check_choice("--bones", bones, BONE_NAMES)
    check_choice("--markers", markers, MARKER_NAMES)

    with progress_bar() as progress:
        written = export_run(
            result,
            out,
            what=what,
            format=format,
            frames=parse_frames(frames),
            cubes=cubes,
            style=MotionStyle(bones, markers, fill, task),  # type: ignore[arg-type]
            progress=progress,
        )
    more = f" ... {written[-1].name}" if len(written) > 1 else ""
    typer.echo(f"{len(written)} file{'s' * (len(written) != 1)}: {written[0]}{more}")


def check(
    session: SessionPath,
    calibration: CalibrationOption = None,
    frames: FramesOption = None,
) -> None:
    """Look at a session before running it: calibration, cameras, clips, background, people, and what to mend."""
    from mocap.io.session import check_session, open_session
    from mocap.pipeline.figures_check import check_figures
    from mocap.pipeline.foresight_check import check_foresight
    from mocap.pipeline.people_check import check_people

    opened = open_session(session, calibration=calibration, frames=parse_frames(frames))
    findings = [
        *check_session(opened),
        *check_figures(opened),
        *check_foresight(opened),
        *check_people(opened),
    ]
    for stretch in opened.stretches[1:]:
        part = open_session(session, calibration=calibration, frames=(stretch.start, stretch.stop))
        for said in check_people(part):
            findings.append(replace(said, message=f"from frame {stretch.start} on, {said.message}"))
    for finding in findings:
        where = f" [{finding.camera}]" if finding.camera else ""
        remedy = f". Remedy: {finding.remedy.rstrip('.')}." if finding.remedy else ""
        typer.echo(f"{finding.severity:>8}{where}: {finding.message.rstrip('.')}{remedy}")
    n_errors = sum(f.severity == "error" for f in findings)
    n_warnings = sum(f.severity == "warning" for f in findings)
    typer.echo(f"{n_errors} errors, {n_warnings} warnings")
    if n_errors:
        raise typer.Exit(2)


def doctor() -> None:
    """Look at this machine and installation: versions, codecs, extras, folders, kernels, and a self-test."""
    from mocap.pipeline.doctor import examine

    n_wrong = 0
    for finding in examine():
        n_wrong += finding.verdict == "wrong"
        typer.echo(f"{finding.verdict:>8}  {finding.what}: {finding.text}")
    typer.echo("All is well." if not n_wrong else f"{n_wrong} thing{'s' * (n_wrong != 1)} to mend.")
    if n_wrong:
        raise typer.Exit(2)


def bundle(
    result: RunPath,
    session: Annotated[
        Path | None,
        typer.Argument(metavar="SESSION", help="The run's session: its calibration and settings come along."),
    ] = None,
    out: Annotated[Path, typer.Option("-o", "--out", help="File to write.")] = Path("bundle.zip"),
) -> None:
    """What somebody who looks for a mistake needs of a run, in one file; no pictures, no paths."""
    from mocap.pipeline.bundle import write_bundle

    names = write_bundle(result, out, session)
    typer.echo(f"{len(names)} files in {out}: {', '.join(name for name in names if '/' not in name)}, ...")
    typer.echo("It holds no pictures and no names of your folders. Look into it before you send it.")


def convert_calibration(
    source: Annotated[Path, typer.Argument(metavar="FILE", help="Calibration file of any supported format.")],
    out: Annotated[Path, typer.Option("-o", "--out", help="File to write; of easymocap the folder.")],
    units: Annotated[
        str | None, typer.Option("--units", help="m, cm or mm, when the file does not say.")
    ] = None,
    to: Annotated[
        str,
        typer.Option("--to", help="mocap, anipose, pose2sim, caliscope, easymocap, opencv or panoptic."),
    ] = "mocap",
) -> None:
    """Read a calibration of any supported format and write our own TOML in metres, or the file of another tool."""
    from mocap.io.calibration import FORMATS, read_calibration, write_calibration, write_rig
    from mocap.io.units import UNITS

    check_choice("--units", units, UNITS)
    check_choice("--to", to, FORMATS)
    found = read_calibration(source, units=units, check_world=False)
    if to == "mocap":
        write_calibration(out, found.rig, metadata={"source_format": found.format})
        written: tuple[Path, ...] = (out,)
    else:
        written = write_rig(out, found.rig, to)
    where = ", ".join(map(str, written))
    typer.echo(f"{found.format}, units {found.units}: {len(found.rig)} cameras -> {where}")
    for note in (*found.notes, *found.warnings):
        typer.echo(f"  {note}")


def warm_up() -> None:
    """Compile what a run needs, once after installation: about a minute, which the first run takes otherwise."""
    import time

    from mocap.pipeline.warm_up import warm_up as compile_kernels

    started = time.perf_counter()
    with progress_bar() as progress:
        n = compile_kernels(
            lambda what, done, total: progress(what, done, total) if what == COMPILING else None
        )
    typer.echo(
        f"{n} kernels compiled in {time.perf_counter() - started:.0f} s" if n else "Everything is compiled"
    )
