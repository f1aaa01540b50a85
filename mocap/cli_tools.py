"""`mocap view`, `mocap report` and `mocap calibrate`: what is done before and after a run."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Annotated

import typer

from mocap.errors import MissingExtra, MocapError

RunPath = Annotated[Path, typer.Argument(metavar="OUT", help="Output folder of a run.")]


def add_commands(app: typer.Typer) -> None:
    """Hang the commands of this module into the command line."""
    app.command()(calibrate)
    app.command()(view)
    app.command()(report)


def calibrate(
    clips: Annotated[
        Path,
        typer.Argument(metavar="BOARD", help="Folder with one clip of the board per camera, synchronised."),
    ],
    out: Annotated[Path, typer.Option("-o", "--out", help="calibration.toml to write.")],
    board: Annotated[str, typer.Option("--board", help="Inner corners, columns x rows, for example 9x6.")],
    square_mm: Annotated[
        float, typer.Option("--square-mm", min=1.0, max=1000.0, help="Side of a square, measured, mm.")
    ],
    floor_frame: Annotated[
        int, typer.Option("--floor-frame", min=0, help="Frame in which the board lies flat on the floor.")
    ],
    frames: Annotated[int, typer.Option("--frames", min=6, help="Frames to look at, spread evenly.")] = 60,
) -> None:
    """Lenses and places of the cameras from a clip of a checkerboard that they all film."""
    from mocap.cli import _progress
    from mocap.io.board_calibration import board_clips, calibrate_on_board, find_board_views
    from mocap.io.calibration import write_calibration

    columns, x, rows = board.lower().partition("x")
    if not (x and columns.strip().isdigit() and rows.strip().isdigit()):
        raise MocapError(
            f"cannot read the board {board!r}", remedy="write columns x rows, for example --board 9x6"
        )
    size = int(columns), int(rows)
    if min(size) < 3 or max(size) > 50:
        raise MocapError(
            f"a board of {size[0]} x {size[1]} inner corners",
            remedy="use one of 3 to 50; corners, not squares",
        )
    with _progress() as progress:
        views = find_board_views(
            board_clips(clips), size, floor_frame=floor_frame, n_frames=frames, progress=progress
        )
    found = calibrate_on_board(views, square_m=square_mm / 1000, floor_frame=floor_frame)
    write_calibration(
        out,
        found.rig,
        metadata={
            "source": "mocap calibrate",
            "board": list(size),
            "square_mm": square_mm,
            "rms_px": round(found.rms_px, 4),
        },
    )
    for camera in found.rig:
        typer.echo(
            f"{camera.name}: {found.n_views_of[camera.name]} views, off by {found.rms_px_of[camera.name]:.2f} px, "
            f"focal length {camera.K[0, 0]:.0f} px, {camera.center[2]:.2f} m above the floor"
        )
    for warning in found.warnings:
        typer.echo(f"  warning: {warning}")
    typer.echo(f"Corners are off by {found.rms_px:.2f} px (root mean square); written to {out}")


def view(
    result: RunPath,
    session: Annotated[
        Path | None, typer.Argument(help="The run's session; then the scene is written anew.")
    ] = None,
    out: Annotated[
        Path | None, typer.Option("-o", "--out", help="File to write instead of OUT/scene.rrd.")
    ] = None,
    show: Annotated[
        bool, typer.Option("--open", help="Open it in the Rerun viewer, a program of its own.")
    ] = False,
) -> None:
    """The 3D scene of a finished run: where it is, written anew, or opened."""
    if session is not None:
        from mocap.pipeline.finished import rewrite_scene

        scene = rewrite_scene(result, session, out)
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
        _open_viewer(scene)
    else:
        typer.echo(f"Look at it with: mocap view {result} --open, or any Rerun viewer")


def report(result: RunPath, session: Annotated[Path, typer.Argument(help="The run's session.")]) -> None:
    """Write report.html of a finished run again, without running anything."""
    from mocap.pipeline.finished import rewrite_report

    typer.echo(f"Look at {rewrite_report(result, session)}")


def _open_viewer(scene: Path) -> None:
    """Start the viewer of rerun-sdk and let it live on its own."""
    from importlib.util import find_spec

    if find_spec("rerun") is None:
        raise MissingExtra(
            "the Rerun viewer is not installed",
            "view",
            otherwise="open the file in a Rerun viewer of your own",
            path=scene,
        )
    subprocess.Popen([sys.executable, "-m", "rerun", str(scene)], start_new_session=True)
