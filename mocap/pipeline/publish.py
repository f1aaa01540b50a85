"""Publication: the outputs of a run replace those of an earlier one together, when all are written."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from mocap.io._files import writing

_UNPUBLISHED = ".outputs.partial"
_EXPORTS = (".bvh", ".trc", ".c3d", ".glb")


@contextmanager
def published(out: Path, persons: set[int] | None) -> Iterator[Path]:
    """A hidden folder to write outputs into; they replace earlier ones in `out` together, after a clean exit.

    persons : those found by a run with exports; exports of others, from an earlier run, are then removed.
    """
    folder = out / _UNPUBLISHED
    try:
        with writing(folder):
            shutil.rmtree(folder, ignore_errors=True)
            folder.mkdir()
        yield folder
        with writing(out):
            for path in sorted(folder.iterdir()):
                os.replace(path, out / path.name)
            if persons is not None:
                _forget_others(out, persons)
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def _forget_others(out: Path, persons: set[int]) -> None:
    for path in out.glob("person_*"):
        number = path.stem.removeprefix("person_")
        if number.isdigit() and int(number) not in persons and path.suffix in _EXPORTS:
            path.unlink()
