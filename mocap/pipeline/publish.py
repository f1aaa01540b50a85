"""Publication: the outputs of a run take the place of those of the run before, together, when all are written."""

from __future__ import annotations

import os
import re
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from mocap.errors import MocapError
from mocap.io._files import writing
from mocap.portable import sync_folder, sync_tree

_UNPUBLISHED = ".outputs.partial"
# Without it a folder holds no result: it goes first and comes last.
RUN_FILE = "run.json"
# Every name that a run, or a command on a finished run, gives a file in its output folder.
_OUTPUT = re.compile(
    r"run\.json|tracks\.csv|landmarks\.csv|angles\.csv|contacts\.csv|steps\.csv|cycles\.csv|moves\.csv|"
    r"pose\.npz|scores\.json|body(_\d+)?\.toml|"
    r"person_\d+\.(bvh|trc|c3d|glb|mot|osim)|"
    r"person_\d+(_filled\.csv|_ik_filled\.csv|_ik\.(trc|mot|xml)|_markers\.xml|_scale\.xml)|"
    r"scene\.rrd|report\.html|overlay_.+\.mp4"
)


def outputs_in(out: Path) -> set[str]:
    """Names of the outputs that lie in a folder, whichever run wrote them."""
    return {path.name for path in out.iterdir() if _OUTPUT.fullmatch(path.name)} if out.is_dir() else set()


@contextmanager
def published(out: Path) -> Iterator[Path]:
    """A hidden folder to write outputs into; after a clean exit they are all the outputs that `out` holds.

    What an earlier run wrote and this one did not is removed: it would lie there as if it belonged to the new tables.
    A process that is killed in between leaves no run.json, so that nobody takes the mixture for a result.
    """
    folder = out / _UNPUBLISHED
    try:
        with writing(folder):
            shutil.rmtree(folder, ignore_errors=True)
            folder.mkdir()
        yield folder
        check_replaceable(out)
        with writing(out):
            sync_tree(folder)
            names = sorted(path.name for path in folder.iterdir())
            for name in sorted(outputs_in(out), key=lambda name: name != RUN_FILE):
                if name == RUN_FILE or name not in names:
                    (out / name).unlink()
            for name in sorted(names, key=lambda name: name == RUN_FILE):
                os.replace(folder / name, out / name)
            sync_folder(out)
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def check_replaceable(out: Path) -> None:
    """Raises MocapError for a folder in the place of an output, which no file can replace."""
    for name in sorted(outputs_in(out)):
        if (out / name).is_dir() and not (out / name).is_symlink():
            raise MocapError(
                f"there is a folder where {name} is to be written",
                path=out / name,
                remedy="move it away, or choose another folder with -o",
            )
