"""`mocap synth`: synthetic sessions with exact truth."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from mocap.cli import complete
from mocap.cli.options import check_choice
from mocap.cli.progress import progress_bar


def _list_scenes(value: bool) -> None:
    if value:
        from mocap.synth import list_scenes

        typer.echo("\n".join(list_scenes()))
        raise typer.Exit


def synth(
    out: Annotated[Path, typer.Option("-o", "--out", help="Folder for the session.")],
    scene: Annotated[
        str, typer.Option("--scene", help="Scene name or TOML file.", autocompletion=complete.scenes)
    ] = "demo",
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

    check_choice("--body", body, ("own", "anny"))
    if preview is not None:
        check_picture_name(preview)
    with progress_bar() as progress:
        path = synthesise(scene, out, seed=seed, workers=workers, body=body, progress=progress)
    if preview is not None:
        from mocap.synth.preview import preview_sheet

        preview_sheet(path, preview)
        typer.echo(f"Preview in {preview}")
    typer.echo(f"Session in {path}; next: mocap run {path} -o OUT")
