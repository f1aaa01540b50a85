"""`mocap depth`: what the depth cameras of a session measure, for other programs."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from mocap.cli.options import CalibrationOption, FramesOption, SessionPath, check_choice, parse_frames
from mocap.cli.progress import progress_bar

_WHAT = ("clouds", "room")


def depth(
    session: SessionPath,
    out: Annotated[Path, typer.Option("-o", "--out", help="Folder for the files.")],
    what: Annotated[
        str,
        typer.Option("--what", help="clouds (points of every frame) or room (a mesh, without the people)."),
    ] = "clouds",
    voxel_m: Annotated[
        float, typer.Option("--voxel-m", min=0.005, max=0.2, help="Of the mesh of the room.")
    ] = 0.02,
    frames: FramesOption = None,
    calibration: CalibrationOption = None,
) -> None:
    """Coloured point clouds of the depth cameras, frame by frame, or the room behind the people as one mesh (PLY)."""
    from mocap.pipeline.measured import export_clouds, export_room

    check_choice("--what", what, _WHAT)
    chosen = parse_frames(frames)
    with progress_bar() as progress:
        if what == "room":
            path = out / "room.ply"
            n = export_room(
                session, path, calibration=calibration, frames=chosen, voxel_m=voxel_m, progress=progress
            )
            typer.echo(f"{path}: {n} faces")
            return
        written = export_clouds(session, out, calibration=calibration, frames=chosen, progress=progress)
    more = f" ... {written[-1].name}" if len(written) > 1 else ""
    typer.echo(f"{len(written)} file{'s' * (len(written) != 1)}: {written[0]}{more}")
