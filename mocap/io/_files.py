"""Small helpers on files: atomic writing with clear errors, natural order of names."""

from __future__ import annotations

import errno
import os
import re
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from mocap.errors import MocapError

IMAGE_SUFFIXES = frozenset({".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".webp", ".pgm", ".ppm"})
VIDEO_SUFFIXES = frozenset({".mp4", ".avi", ".mov", ".mkv", ".m4v", ".webm", ".mpg", ".mpeg", ".wmv", ".mts"})


def natural_key(name: str) -> tuple[tuple[int, int | str], ...]:
    """Sort key under which frame_2 comes before frame_10."""
    return tuple((0, int(p)) if p.isdigit() else (1, p) for p in re.split(r"(\d+)", name) if p)


def write_error(error: OSError, path: Path) -> MocapError:
    """The error to raise (from `error`) when `path` could not be written."""
    if error.errno in (errno.ENOSPC, errno.EDQUOT):
        return MocapError(
            "the disk is full", path=path, remedy="free some space or choose another output folder"
        )
    return MocapError(
        f"cannot write: {error.strerror or error}",
        path=path,
        remedy="choose an output folder that you may write to",
    )


@contextmanager
def writing(path: Path) -> Iterator[None]:
    """Turn the OSErrors of a block that writes `path` into MocapError."""
    try:
        yield
    except OSError as error:
        raise write_error(error, path) from error


def atomic_text(path: Path, text: str) -> None:
    """Write a text file so that a reader sees the old one or the whole new one, never half of it."""
    with writing(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, temporary = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.", suffix=".partial")
        try:
            with os.fdopen(handle, "w", encoding="utf-8", newline="") as file:
                file.write(text)
            # mkstemp makes private files; a result should be as readable as any other file.
            mask = os.umask(0)
            os.umask(mask)
            os.chmod(temporary, 0o666 & ~mask)
            os.replace(temporary, path)
        except BaseException:
            Path(temporary).unlink(missing_ok=True)
            raise
