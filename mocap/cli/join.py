"""`mocap join`: runs of pieces of one recording become the run of the whole."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from mocap.cli.interrupt import how_to_go_on
from mocap.cli.options import CalibrationOption, OutPath, SessionPath, command_line
from mocap.cli.progress import progress_bar
from mocap.cli.run import echo_result


def join(
    session: SessionPath,
    pieces: Annotated[
        list[Path],
        typer.Argument(
            metavar="PIECE", help="Output folders of runs on frames of the session, `--frames a:b`."
        ),
    ],
    out: OutPath,
    calibration: CalibrationOption = None,
) -> None:
    """Put runs of pieces of one recording together; neighbours share frames, some two seconds."""
    from mocap.pipeline.join import join_runs

    with how_to_go_on(lambda: "The pieces are as they were; repeat the command."), progress_bar() as show:
        result = join_runs(
            session, pieces, out, calibration=calibration, progress=show, command=command_line()
        )
    echo_result(result)
