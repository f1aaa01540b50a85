"""A recording of a public set as its files have it, and how files are found below a folder."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from fnmatch import fnmatch
from pathlib import Path

from mocap.errors import MocapError
from mocap.io._files import VIDEO_SUFFIXES
from mocap.io.calibration.record import RawRig
from mocap.io.formats.table import PoseFile

# A set unpacked as its archives have it lies less deep.
_MOST_DEEP = 6


@dataclass(frozen=True, eq=False)
class Clock:
    """When pictures were taken, where a set says it.

    begins_s : camera -> its first picture, s after the first row of the truth.  fps : camera -> pictures per second.
    """

    begins_s: Mapping[str, float]
    fps: Mapping[str, float]


@dataclass(frozen=True, eq=False)
class Recording:
    """One recording: cameras, clips and truth, in the unit and the axes of its files.

    rig, rig_path : all cameras, and where they were read.  clips : camera -> video or folder of pictures.
    truth : points of the persons, in the world of the cameras; without a clock its frames are those of the clips.
    landmarks : landmark -> points whose mean it is; empty = their names tell.  fps : pictures per second; None = as the
    clips say.  empty : camera -> clip of the empty scene.  notes : what is to be known of it.
    """

    rig: RawRig
    rig_path: Path
    clips: Mapping[str, Path]
    truth: PoseFile
    landmarks: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    fps: float | None = None
    clock: Clock | None = None
    empty: Mapping[str, Path] = field(default_factory=dict)
    notes: tuple[str, ...] = ()


def files_below(root: Path, pattern: str) -> list[Path]:
    """Files below a folder whose path ends like the pattern (`*/Videos/*.mp4`), case left aside, in order."""
    wanted = f"*/{pattern.lower()}"
    return sorted(path for path in _walk(root) if fnmatch(path.as_posix().lower(), wanted))


def _walk(root: Path) -> Iterator[Path]:
    for folder, below, files in os.walk(root):
        here = Path(folder)
        below[:] = [name for name in below if not name.startswith(".")]
        if len(here.relative_to(root).parts) >= _MOST_DEEP:
            below.clear()
        yield from (here / name for name in files if not name.startswith("."))


def the_file(root: Path, pattern: str, what: str) -> Path:
    """The only file below a folder that ends like the pattern; MocapError where there is none or several."""
    found = files_below(root, pattern)
    if len(found) != 1:
        count = "several" if found else "no"
        raise MocapError(
            f"{count} {what} ({pattern}) below the folder",
            path=root,
            remedy="see docs/public-sets.md for the layout",
        )
    return found[0]


def clips_named(files: list[Path], camera: re.Pattern[str]) -> dict[str, Path]:
    """Camera -> video, of files whose name the pattern matches; its group is the camera."""
    clips = {}
    for file in files:
        match = camera.search(file.name)
        if match and file.suffix.lower() in VIDEO_SUFFIXES:
            clips[match.group(1)] = file
    return clips


def subject_of(path: Path) -> tuple[str, Path]:
    """The subject (S1, S11) that a file is of, and its folder; MocapError where no folder above it is called so."""
    for parent in path.parents:
        if re.fullmatch(r"[sS]\d+", parent.name):
            return parent.name, parent
    raise MocapError(
        "no folder above the file is called S1, S2 ...",
        path=path,
        remedy="keep the folders of the set as they are",
    )


def from_zero(truth: PoseFile) -> PoseFile:
    """The truth with its rows for frames: the first row is frame 0 at 0 s, whatever a file counts them by."""
    people = tuple(
        replace(table, frames=table.frames - table.frames[0], time_s=table.time_s - table.time_s[0])
        for table in truth.people
        if len(table.frames)
    )
    return replace(truth, people=people)
