"""Clocks of cameras: `mocap sync` finds when each clip began."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, get_args

import typer

from mocap.cli.options import CalibrationOption, SessionPath, ThreadsOption, check_choice
from mocap.cli.progress import progress_bar

if TYPE_CHECKING:
    from mocap.pipeline.sync import SessionClocks


def sync(
    session: SessionPath,
    calibration: CalibrationOption = None,
    max_lag_s: Annotated[
        float, typer.Option("--max-lag-s", min=0.1, max=3600.0, help="Largest lag between two clips, s.")
    ] = 10.0,
    by: Annotated[
        str,
        typer.Option(
            "--by",
            help="people who move (needs where cameras stand), light (a flash, a lamp) or sound (a clap).",
        ),
    ] = "people",
    reference: Annotated[
        str | None, typer.Option("--reference", help="Camera on whose clock frames are counted; else chosen.")
    ] = None,
    picture: Annotated[
        Path | None, typer.Option("--picture", help="PNG that shows what was found: before and after.")
    ] = None,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Say what is found, and write nothing.")] = False,
    threads: ThreadsOption = None,
) -> None:
    """When each clip began and how fast its clock runs; written to SESSION/session.toml.

    The clips may have different lengths and frame rates. Every command then shows each frame by the pictures taken
    nearest to it. One person who walks through the room for five seconds is enough; a flash or a clap tells clocks
    before anybody knows where the cameras stand.
    """
    from mocap.pipeline.sync import By, find_clocks, write_clocks, write_picture

    check_choice("--by", by, get_args(By))
    told_by: By = by  # type: ignore[assignment]
    with progress_bar() as progress:
        found = find_clocks(
            session,
            calibration=calibration,
            by=told_by,
            max_lag_s=max_lag_s,
            reference=reference,
            n_threads=threads,
            progress=progress,
        )
    for name in found.found.clocks:
        typer.echo(f"{name}: {_in_words(name, found)}")
    if picture is not None:
        write_picture(picture, found)
        typer.echo(f"Picture in {picture}")
    if dry_run:
        return
    written = write_clocks(session, found)
    if written:
        typer.echo(f"Written: {', '.join(map(str, written))}")
    else:
        typer.echo(
            "session.toml says so already." if found.off else "All clocks agree; nothing has to be written."
        )


def _in_words(name: str, clocks: SessionClocks) -> str:
    """What was found of one camera."""
    clock = clocks.found.clocks[name]
    if name == clocks.found.reference:
        return "the reference"
    if not clock.is_certain:
        return "cannot be told: it shares nothing clear with another camera; taken as it is"
    if not clock.is_off:
        return f"agrees ({1000 * clock.offset_s:+.1f} ms, uncertain by {1000 * clock.offset_std_s:.1f} ms)"
    later = "later" if clock.offset_s > 0 else "earlier"
    drift = f", its clock runs {1e6 * abs(clock.drift):.0f} ppm {'slow' if clock.drift > 0 else 'fast'}"
    return (
        f"begins {abs(clock.offset_s):.4f} s ± {1000 * clock.offset_std_s:.1f} ms {later} than "
        f"{clocks.found.reference} ({clock.offset_s * clocks.fps:+.2f} frames){drift if clock.drift else ''}"
    )
