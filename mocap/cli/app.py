"""The table of commands, and how every mistake ends: one message with file, camera, frame and remedy, exit code 2."""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import Annotated

import typer

from mocap.cli import calibrate, cluster, compare, edit, init, join, live, run, sync, synth, tools
from mocap.cli.interrupt import leave
from mocap.errors import DISTRIBUTION, MocapError
from mocap.portable import Stopped, find_kernel_cache, stoppable

app = typer.Typer(
    name="mocap",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)
# In the order of `mocap --help`.
COMMANDS: dict[str, Callable[..., None]] = {
    "demo": run.demo,
    "init": init.init,
    "run": run.run,
    "live": live.live,
    "segment": run.segment,
    "carve": run.carve,
    "track": run.track,
    "pose": run.pose,
    "join": join.join,
    "eval": compare.evaluate,
    "edit": edit.edit,
    "export": tools.export,
    "check": tools.check,
    "synth": synth.synth,
    "convert-calibration": tools.convert_calibration,
    "board": calibrate.board,
    "calibrate": calibrate.calibrate,
    "sync": sync.sync,
    "view": tools.view,
    "report": tools.report,
    "warm-up": tools.warm_up,
    "doctor": tools.doctor,
    "bundle": tools.bundle,
    "batch": cluster.batch,
    "sweep": cluster.sweep,
}
for _name, _command in COMMANDS.items():
    app.command(name=_name)(_command)


def _print_version(value: bool) -> None:
    if value:
        from importlib.metadata import PackageNotFoundError, version

        try:
            typer.echo(f"mocap {version(DISTRIBUTION)}")
        except PackageNotFoundError:
            typer.echo("mocap, not installed: run from a checkout")
        raise typer.Exit


@app.callback()
def _program(
    version: Annotated[
        bool,
        typer.Option("--version", is_eager=True, callback=_print_version, help="Print the version."),
    ] = False,
) -> None:
    """Calibrated multi-camera video to 3D human motion, without neural weights.

    Start with `mocap demo`, then `mocap check SESSION` and `mocap run SESSION -o OUT` on your own folder.
    """


def main() -> None:
    """Entry point: user mistakes become one message and exit code 2, without a traceback."""
    find_kernel_cache()
    try:
        with stoppable():
            app(standalone_mode=True)
    except MocapError as error:
        _fail(str(error))
    except Stopped as stopped:
        leave(stopped, "It was not done; repeat the command.")
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
