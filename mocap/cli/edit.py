"""`mocap edit`: correct a result by hand; what is corrected is kept beside it and applied whenever it is run again."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from mocap.cli import complete
from mocap.cli.options import CalibrationOption, RunPath, ThreadsOption, check_choice, parse_frames
from mocap.cli.progress import progress_bar
from mocap.errors import MocapError

if TYPE_CHECKING:
    from mocap.pipeline.edits.model import Edits

# How many persons each edit names.
_PERSONS = {
    "merge": (2, 2),
    "split": (1, 1),
    "swap": (2, 2),
    "delete": (1, 1),
    "exchange": (1, 1),
    "bad": (0, 1),
    "pin": (1, 1),
}
# Option -> the edits that take it.
_TAKES = {
    "--frames": ("merge", "split", "swap", "delete", "exchange", "bad"),
    "--new": ("split",),
    "--sides": ("exchange",),
    "--landmark": ("pin",),
    "--frame": ("pin",),
    "--at": ("pin",),
    "--seen": ("pin",),
}


def edit(
    result: RunPath,
    what: Annotated[
        str | None,
        typer.Argument(
            metavar="EDIT",
            help="merge, split, swap, delete, exchange, bad or pin.",
            autocompletion=complete.edits,
        ),
    ] = None,
    persons: Annotated[
        list[int] | None, typer.Argument(metavar="PERSON", help="Numbers of persons, as in tracks.csv.")
    ] = None,
    frames: Annotated[
        str | None, typer.Option("--frames", help="a:b, frames a to b - 1; either may be left out.")
    ] = None,
    new: Annotated[int | None, typer.Option("--new", min=1, help="split: number of the new person.")] = None,
    sides: Annotated[
        str | None, typer.Option("--sides", help="exchange: legs, arms, or body (it faces the other way).")
    ] = None,
    landmark: Annotated[
        str | None,
        typer.Option("--landmark", help="pin: such as left_wrist.", autocompletion=complete.landmarks),
    ] = None,
    frame: Annotated[int | None, typer.Option("--frame", min=0, help="pin: the frame.")] = None,
    at: Annotated[str | None, typer.Option("--at", help="pin: x,y,z in the world, metres.")] = None,
    seen: Annotated[
        list[str] | None,
        typer.Option("--seen", help="pin: CAMERA=u,v in the picture, pixels; for two cameras or more."),
    ] = None,
    show: Annotated[bool, typer.Option("--list", help="Print the edits.")] = False,
    undo: Annotated[bool, typer.Option("--undo", help="Take the last edit back.")] = False,
    doubtful: Annotated[
        bool, typer.Option("--doubtful", help="Print the frames worth looking at, most doubtful first.")
    ] = False,
    apply: Annotated[
        Path | None,
        typer.Option(
            "--apply",
            metavar="SESSION",
            help="Write the result again, from what is stored; the run's session.",
        ),
    ] = None,
    calibration: CalibrationOption = None,
    threads: ThreadsOption = None,
) -> None:
    """Correct a result by hand: who is who, left and right, bad frames, a landmark's place; kept in OUT/edits.toml."""
    from mocap.pipeline.edits.model import KINDS

    options = {
        "--frames": frames,
        "--new": new,
        "--sides": sides,
        "--landmark": landmark,
        "--frame": frame,
        "--at": at,
        "--seen": seen or None,
    }
    if what is not None:
        check_choice("EDIT", what, KINDS)
        if undo:
            raise MocapError("an edit and --undo were both given", remedy="give one after the other")
        _add(result, _values(what, persons or [], options))
    elif given := [name for name, value in options.items() if value is not None]:
        raise MocapError(f"{given[0]} says nothing without an edit", remedy=f"name one of {', '.join(KINDS)}")
    if undo:
        _undo(result)
    if doubtful:
        _echo_doubts(result)
    if show or not (what or undo or doubtful or apply):
        _echo_edits(result)
    if apply is not None:
        _apply(result, apply, calibration, threads)


def _values(what: str, persons: list[int], options: dict[str, Any]) -> dict[str, Any]:
    """An edit as the file has it. Raises MocapError for what it does not take, or lacks."""
    least, most = _PERSONS[what]
    if not least <= len(persons) <= most:
        wanted = f"{least}" if least == most else f"{least} or {most}"
        raise MocapError(
            f"{what} takes {wanted} person{'s' * (most > 1)}, got {len(persons)}",
            remedy=f"write mocap edit OUT {what} {' '.join(str(n + 1) for n in range(most))}",
        )
    for name, value in options.items():
        if value is not None and what not in _TAKES[name]:
            takes = ", ".join(option for option, kinds in _TAKES.items() if what in kinds)
            raise MocapError(f"{what} takes no {name}", remedy=f"it takes {takes}")
    values: dict[str, Any] = {"do": what}
    if most == 2:
        values["persons"] = persons
    elif persons:
        values["person"] = persons[0]
    if options["--frames"] is not None:
        parse_frames(options["--frames"])
    elif what in ("split", "bad"):
        raise MocapError(f"{what} needs --frames", remedy="write --frames a:b, for example 120:")
    values["frames"] = options["--frames"]
    values["new"], values["sides"] = options["--new"], options["--sides"]
    return {**values, **(_pin(options) if what == "pin" else {})}


def _pin(options: dict[str, Any]) -> dict[str, Any]:
    for name in ("--landmark", "--frame"):
        if options[name] is None:
            raise MocapError(f"pin needs {name}", remedy="write --landmark left_wrist --frame 57")
    at, seen = options["--at"], options["--seen"]
    if (at is None) == (seen is None):
        raise MocapError(
            "pin needs --at or --seen, one of them",
            remedy="write --at x,y,z in metres, or --seen cam_0=412,233 --seen cam_2=120,301 in pixels",
        )
    values = {"landmark": options["--landmark"], "frame": options["--frame"]}
    if at is not None:
        return {**values, "place_m": _numbers("--at", at, 3)}
    places = {}
    for text in seen:
        camera, sign, place = text.partition("=")
        if not sign or not camera.strip():
            raise MocapError(f"--seen is {text!r}", remedy="write it as --seen cam_0=412,233")
        places[camera.strip()] = _numbers("--seen", place, 2)
    return {**values, "seen_px": places}


def _numbers(option: str, text: str, n: int) -> list[float]:
    try:
        found = [float(word) for word in text.split(",")]
    except ValueError:
        found = []
    if len(found) != n:
        example = {2: "cam_0=412,233", 3: "0.41,0.20,1.13"}[n]
        raise MocapError(f"{option} is {text!r}, expected {n} numbers", remedy=f"write {option} {example}")
    return found


def _add(result: Path, values: dict[str, Any]) -> None:
    """One more edit in the file, looked at before."""
    from mocap.pipeline.edits.model import (
        EDITS_FILE,
        described,
        edits_text,
        parse_edits,
        with_edit,
        write_edits,
    )

    text = with_edit(edits_text(result), values)
    edits = parse_edits(text, result / EDITS_FILE)
    _check(result, edits)
    write_edits(result, text)
    typer.echo(f"{result / EDITS_FILE}, {described(edits.edit[-1])}")
    typer.echo(f"Apply it with: mocap edit {result} --apply SESSION")


def _check(result: Path, edits: Edits) -> None:
    from mocap.pipeline.finished import check_edits

    check_edits(result, edits)


def _undo(result: Path) -> None:
    from mocap.pipeline.edits.model import EDITS_FILE, edits_text, without_last, write_edits

    try:
        text, last = without_last(edits_text(result))
    except ValueError as error:
        raise MocapError(
            "there is no edit to take back", path=result / EDITS_FILE, remedy="see --list"
        ) from error
    write_edits(result, text)
    typer.echo("taken back: " + ", ".join(line for line in last.splitlines()[1:] if line.strip()))


def _echo_edits(result: Path) -> None:
    from mocap.pipeline.edits.model import Edits, edits_in, lines_of
    from mocap.pipeline.finished import read_record

    edits = edits_in(result) or Edits()
    for line in lines_of(edits):
        typer.echo(line)
    n = len(edits.edit)
    is_applied = edits.is_same(read_record(result).config.edits)
    left = "" if is_applied else f"; to be applied with: mocap edit {result} --apply SESSION"
    typer.echo(f"{n} edit{'s' * (n != 1)}{left}")


def _echo_doubts(result: Path) -> None:
    from mocap.pipeline.finished import doubts_in

    found = doubts_in(result)
    for doubt in found:
        frames = f"{doubt.frames.start}:{doubt.frames.stop}"
        typer.echo(
            f"{doubt.value:6.1f}  person {doubt.person}  frames {frames:<11} worst {doubt.worst:<6} "
            + "; ".join(doubt.reasons)
        )
    typer.echo(
        f"{len(found)} place{'s' * (len(found) != 1)} to look at" if found else "No frame is in doubt."
    )


def _apply(result: Path, session: Path, calibration: Path | None, threads: int | None) -> None:
    """Run again what depends on the edits, with the settings of the run."""
    from mocap.cli.run import echo_result
    from mocap.pipeline.finished import run_again

    with progress_bar() as progress:
        echo_result(run_again(result, session, calibration=calibration, n_threads=threads, progress=progress))
