"""`mocap init`: from a heap of clips to a session folder."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from mocap.cli.progress import progress_bar

if TYPE_CHECKING:
    from mocap.io.session.heap import HeapClip, SortedHeap

_TITLES = {"background": "empty scene", "board": "board", "masks": "masks"}


def init(
    heap: Annotated[Path, typer.Argument(metavar="DIR", help="Folder with clips, in any order and depth.")],
    out: Annotated[
        Path | None,
        typer.Option(
            "-o", "--out", help="Folder of the session; else DIR, or DIR/session.", show_default=False
        ),
    ] = None,
    take: Annotated[
        str | None,
        typer.Option("--take", help="Which of several takes; else the one that most cameras filmed."),
    ] = None,
    copy: Annotated[bool, typer.Option("--copy", help="Copy the clips in place of links to them.")] = False,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Say what is found, and write nothing.")] = False,
) -> None:
    """Sort a heap of clips into a session: which camera, which clip is empty or shows a board, what is missing.

    Nothing is asked, moved or changed: the session holds links to the clips, and a session.toml that says what was
    found.
    """
    from mocap.io.session.heap import sort_heap
    from mocap.io.session.layout import plan_layout, write_layout

    with progress_bar() as progress:
        found = sort_heap(heap, take=take, without=out or heap / "session", progress=progress)
    layout = plan_layout(found, out)
    for line in _told(found):
        typer.echo(line)
    for note in (*found.notes, *layout.notes):
        typer.echo(f"note: {note}")
    for lack in found.missing:
        typer.echo(f"missing: {lack.replace('SESSION', str(layout.root))}")
    if dry_run:
        return
    write_layout(layout, copies=copy)
    typer.echo(f"Written: {layout.root / 'session.toml'}")
    if found.calibration is not None:
        typer.echo(f"Next: mocap check {layout.root}")


def _told(found: SortedHeap) -> list[str]:
    """What is in the heap, a line per camera."""
    lines = []
    if found.other_takes:
        others = ", ".join(t or "(without a name)" for t in found.other_takes)
        lines.append(f"take {found.take or '(without a name)'}; others: {others} (--take NAME)")
    kinds = {"background": found.background, "board": found.board, "masks": found.masks}
    for name, clip in found.recording.items():
        with_it = [
            f"{_TITLES[kind]} {_shown(own[name], found)}" for kind, own in kinds.items() if name in own
        ]
        rate = f"{clip.info.fps:g} frames/s" if clip.info.fps else "no frame rate"
        lines.append(
            f"{name}: {_shown(clip, found)}, {clip.info.size[0]} x {clip.info.size[1]}, {clip.info.n_frames} frames, "
            f"{rate}{''.join(f'; {text}' for text in with_it)}"
        )
    only_board = [name for name in found.board if name not in found.recording]
    lines += [f"{name}: board only" for name in only_board]
    if found.calibration is not None:
        lines.append(f"calibration: {found.calibration.name}")
    return lines


def _shown(clip: HeapClip, found: SortedHeap) -> str:
    more = f" and {len(clip.later)} more chapter{'s' * (len(clip.later) != 1)}" if clip.later else ""
    return f"{clip.path.relative_to(found.root)}{more}"
