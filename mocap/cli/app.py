"""The table of commands, and how every mistake ends: one message with file, camera, frame and remedy, exit code 2."""

from __future__ import annotations

import inspect
import sys
from collections.abc import Callable
from typing import Annotated

import typer

from mocap.cli import (
    calibrate,
    cluster,
    compare,
    depth,
    edit,
    import_set,
    init,
    join,
    live,
    run,
    sync,
    synth,
    tools,
)
from mocap.cli.interrupt import leave
from mocap.errors import DISTRIBUTION, MocapError
from mocap.portable import Stopped, find_kernel_cache, memory_limit_bytes, stoppable

app = typer.Typer(
    name="mocap",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)
# Address space that loading all libraries takes, most of it never touched: `mocap check` with `ulimit -v` fails with
# 700 MB and passes with 900 MB.
_LEAST_MAPPED_BYTES = 900 * 2**20
_USUAL_MAPPED_GB = 4
# What Python, cv2.error, threads and llvmlite call it.
_SHORT_OF_MEMORY = (
    "failed to map segment",
    "cannot allocate memory",
    "Cannot allocate memory",
    "Insufficient memory",
    "can't start new thread",
    "libllvmlite",
)
_OUT_OF_MEMORY = (
    "out of memory. Remedy: close other programs or raise the limit (ulimit -v), use larger voxels "
    "(--set volume.voxel_size_m=0.03) or a smaller room."
)
# In the order of `mocap --help`.
COMMANDS: dict[str, dict[str, Callable[..., None]]] = {
    "To begin": {"demo": run.demo, "doctor": tools.doctor, "warm-up": tools.warm_up},
    "Before a run": {
        "init": init.init,
        "import": import_set.import_set,
        "check": tools.check,
        "board": calibrate.board,
        "calibrate": calibrate.calibrate,
        "sync": sync.sync,
        "convert-calibration": tools.convert_calibration,
        "depth": depth.depth,
    },
    "Run": {
        "run": run.run,
        "segment": run.segment,
        "carve": run.carve,
        "track": run.track,
        "pose": run.pose,
        "live": live.live,
    },
    "With a result": {
        "report": tools.report,
        "view": tools.view,
        "edit": edit.edit,
        "export": tools.export,
        "eval": compare.evaluate,
        "bundle": tools.bundle,
    },
    "Many runs": {
        "batch": cluster.batch,
        "join": join.join,
        "sweep": cluster.sweep,
        "synth": synth.synth,
    },
}


def _help(command: Callable[..., None]) -> str:
    """A command's documentation with its paragraphs on one line each: the terminal is as wide as it is."""
    paragraphs = inspect.cleandoc(command.__doc__ or "").split("\n\n")
    return "\n\n".join(" ".join(paragraph.split()) for paragraph in paragraphs)


for _group, _commands in COMMANDS.items():
    for _name, _command in _commands.items():
        app.command(name=_name, help=_help(_command), rich_help_panel=_group)(_command)


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
    # Looked at beforehand: with less, libraries of others end the process without a word that could be caught.
    limit = memory_limit_bytes()
    if limit is not None and limit < _LEAST_MAPPED_BYTES:
        raise MocapError(
            f"this shell lets a program use {limit / 2**20:.0f} MB of memory, which is less than its libraries take",
            remedy=f"raise the limit to {_USUAL_MAPPED_GB} GB or more (ulimit -v unlimited), or ask the batch system "
            "for as much",
        )


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
        if _is_short_of_memory(error):
            _fail(_OUT_OF_MEMORY)
        name = f" (file {error.filename})" if error.filename else ""
        _fail(
            f"{error.strerror or error}{name}. Remedy: check that the disk has space left and that files and "
            "folders may be read and written."
        )
    except Exception as error:
        if not _is_short_of_memory(error):
            raise
        _fail(_OUT_OF_MEMORY)


def _is_short_of_memory(error: BaseException) -> bool:
    """Python says MemoryError; libraries that are loaded, OpenCV and threads have words of their own."""
    return isinstance(error, MemoryError) or any(words in str(error) for words in _SHORT_OF_MEMORY)


def _fail(message: str, code: int = 2) -> None:
    sys.stderr.write(f"mocap: error: {message}\n")
    sys.exit(code)
