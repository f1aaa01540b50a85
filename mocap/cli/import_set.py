"""`mocap import`: from a recording of a public set to a session folder with its truth."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from mocap.cli.options import check_choice
from mocap.errors import MocapError

_MOST_LISTED = 20


def import_set(
    name: Annotated[
        str,
        typer.Argument(
            metavar="SET", help="biocv, human36m, humaneva, mpi-inf-3dhp, panoptic or totalcapture."
        ),
    ],
    folder: Annotated[
        Path, typer.Argument(metavar="DIR", help="Where the set is unpacked, or a part of it.")
    ],
    out: Annotated[
        Path | None,
        typer.Option("-o", "--out", help="Folder of the session; without it the recordings are listed."),
    ] = None,
    take: Annotated[
        str | None, typer.Option("--take", help="Which recording, such as S1/Walking_1; else the only one.")
    ] = None,
    names: Annotated[
        Path | None,
        typer.Option("--map", help="TOML file whose table truth says which points are our landmarks."),
    ] = None,
    copy: Annotated[bool, typer.Option("--copy", help="Copy the clips in place of links to them.")] = False,
) -> None:
    """A recording of a public set with a measured truth as a session: cameras, clips and truth/landmarks.csv.

    Nothing is downloaded: the set must lie on the disk as its authors give it to those who have asked for it.
    """
    from mocap.io.poses import read_map
    from mocap.io.session.layout import check_is_new
    from mocap.io.sets import SETS, imported, takes_of, write_session

    check_choice("SET", name, tuple(SETS))
    takes = takes_of(name, folder)
    if out is None:
        for one in takes:
            typer.echo(one)
        return
    chosen = _chosen(takes, take, folder)
    check_is_new(out)
    side = None if names is None else read_map(names)["truth"]
    found = imported(SETS[name].read(folder, takes[chosen]), side)
    title = f"{SETS[name].title}, {chosen}"
    write_session(found, out, title, copies=copy)
    for camera, clip in found.clips.items():
        typer.echo(f"{camera}: {clip.path.name}, {clip.size[0]} x {clip.size[1]}, {clip.n_frames} frames")
    n_frames = len({int(f) for motion in found.truth for f in motion.frames})
    persons = f"{len(found.truth)} person{'s' * (len(found.truth) != 1)}"
    typer.echo(
        f"truth: {persons}, {n_frames} frames at {found.fps:g} frames/s, {len(found.landmarks)} landmarks"
    )
    for note in found.notes:
        typer.echo(f"note: {note}")
    for warning in found.warnings:
        typer.echo(f"warning: {warning}")
    typer.echo(f"Written: {out / 'session.toml'}")
    typer.echo(f"Next: mocap check {out}")


def _chosen(takes: dict[str, Path], take: str | None, folder: Path) -> str:
    """The recording that is asked for, or the only one."""
    if take is None and len(takes) == 1:
        return next(iter(takes))
    if take in takes:
        return str(take)
    listed = ", ".join(list(takes)[:_MOST_LISTED]) + (" ..." if len(takes) > _MOST_LISTED else "")
    what = f"there are {len(takes)} recordings" if take is None else f"there is no recording {take}"
    raise MocapError(f"{what}: {listed}", path=folder, remedy="choose one with --take")
