"""The input files of a session, hashed whole; a file that has not been touched since is not read again."""

from __future__ import annotations

import hashlib
import json
import os
import time
from collections.abc import Iterator
from dataclasses import fields
from pathlib import Path

import numpy as np

from mocap.errors import MocapError
from mocap.io._files import atomic_text
from mocap.io.session import Session
from mocap.pipeline.stages.detect import labels_path

_FORMAT = 1
# A file may change again within one tick of its file system's clock, 2 s on FAT, without its time telling.
_SETTLED_S = 3.0

# size, time of content, time of attributes, device and number of a file, and its hash.
_Entry = tuple[int, int, int, int, int, str]
# A sweep opens the same sessions again and again in one process.
_OF_THIS_PROCESS: dict[str, _Entry] = {}


class FileHashes:
    """Hashes of whole files, remembered by size, both times, device and number of the file.

    path : where they are kept from run to run; None = not at all.  is_trusted : False = what is kept there is not used,
    and every file is read again.
    """

    def __init__(self, path: Path | None = None, *, is_trusted: bool = True) -> None:
        self._path = path
        self._known = {**_read(path), **_OF_THIS_PROCESS} if is_trusted else {}
        self._used: dict[str, _Entry] = {}

    def of(self, file: Path) -> str:
        """Hash of the file's content. Raises MocapError when it cannot be read."""
        try:
            place, stat = str(file.resolve()), file.stat()
            marks = (stat.st_size, stat.st_mtime_ns, stat.st_ctime_ns, stat.st_dev, stat.st_ino)
            known = self._used.get(place) or self._known.get(place)
            if known is None or known[:5] != marks:
                with file.open("rb") as stream:
                    known = (*marks, hashlib.file_digest(stream, "blake2b").hexdigest()[:32])
        except OSError as error:
            raise MocapError(
                f"cannot be read: {error.strerror or error}",
                path=file,
                remedy="check that it is there and may be read",
            ) from error
        if time.time() - max(stat.st_mtime, stat.st_ctime) > _SETTLED_S:
            self._used[place] = _OF_THIS_PROCESS[place] = known
        return known[5]

    def keep(self) -> None:
        """Write down what was used, for the next run."""
        if self._path is not None and self._used:
            document = {"format": _FORMAT, "files": self._used}
            atomic_text(self._path, json.dumps(document) + "\n")


def _read(path: Path | None) -> dict[str, _Entry]:
    """What an earlier run wrote down; nothing when that cannot be read."""
    if path is None:
        return {}
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
        if document["format"] != _FORMAT:
            return {}
        return {
            str(file): (int(a), int(b), int(c), int(d), int(e), str(digest))
            for file, (a, b, c, d, e, digest) in document["files"].items()
        }
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return {}


def input_hash(session: Session, hashes: FileHashes) -> str:
    """Hash of frame range, clocks, cameras and the whole content of the files that a session is made of."""
    digest = hashlib.sha256()
    digest.update(repr((session.frames.start, session.frames.stop)).encode())
    for camera in session.rig:
        for field in fields(camera):
            value = getattr(camera, field.name)
            digest.update(f"{field.name} ".encode())
            digest.update(value.tobytes() if isinstance(value, np.ndarray) else repr(value).encode())
    for name, places in session.clip_frames.items():
        digest.update(f"clip_frames {name} ".encode() + places[session.frames.start :].tobytes())
    for frame, later in session.later_calibrations.items():
        digest.update(f"from {frame} {hashes.of(later.path)} ".encode())
    for name, file in input_files(session):
        digest.update(f"{name} {os.fsencode(file.name)!r} {hashes.of(file)} ".encode())
    return digest.hexdigest()[:16]


def input_files(session: Session) -> Iterator[tuple[str, Path]]:
    """Every file that a result depends on, with what it is of, in an order that does not change."""
    labels = labels_path(session)
    has_labels = not session.detection_sources and labels.exists()
    kinds = {
        "images": session.image_sources,
        "background": session.background_sources,
        "masks": session.mask_sources,
        "roi": session.roi_sources,
        "detections": session.detection_sources,
        "keypoints": session.keypoint_sources,
        "depth": session.depth_sources,
        "labels": {"labels": labels} if has_labels else {},
    }
    for kind, sources in kinds.items():
        for name in sorted(sources):
            source = sources[name]
            files = sorted(p for p in source.rglob("*") if p.is_file()) if source.is_dir() else [source]
            for file in files:
                yield f"{kind} {name}", file
