"""The room of a live run: a session whose pictures come from cameras, with backgrounds learnt before anybody enters.

It is a session folder too, so that what is recorded into it can be run again.
"""

from __future__ import annotations

import shutil
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import TracebackType

import cv2
import numpy as np
from numpy.typing import NDArray

from mocap.data import Camera, CameraRig
from mocap.errors import MocapError
from mocap.io._files import IMAGE_SUFFIXES, VIDEO_SUFFIXES, atomic_text
from mocap.io.calibration import read_calibration, write_calibration
from mocap.io.session import Session
from mocap.io.session.sources import sources_in
from mocap.io.session.timeline import TIMESTAMPS_FILE
from mocap.io.tables import TIMESTAMP_COLUMNS
from mocap.pipeline.live.capture import Shot
from mocap.pipeline.live.engine import ENDLESS
from mocap.pipeline.live.pairing import Pairing
from mocap.portable import utf8_name

Image = NDArray[np.uint8]

MIN_CAMERAS = 3
_FEWEST_PICTURES = 10  # of the empty room: fewer say nothing of its noise
_MOST_PICTURES = 40
_FASTEST_PNG = [cv2.IMWRITE_PNG_COMPRESSION, 1]


def sources_by_camera(words: Sequence[str], rig: CameraRig, calibration: Path) -> dict[str, str]:
    """Camera -> source, from words CAMERA=SOURCE. Raises MocapError for what is no camera of the rig, or too few."""
    found: dict[str, str] = {}
    for word in words:
        name, equals, source = word.partition("=")
        if not equals or not source:
            raise MocapError(
                f"--camera is {word!r}", remedy="write --camera CAMERA=SOURCE, for example cam_0=0"
            )
        if name not in rig.names:
            raise MocapError(
                f"the calibration has no camera {name!r}",
                path=calibration,
                remedy=f"use {', '.join(rig.names)}",
            )
        found[name] = source
    if len(found) < MIN_CAMERAS:
        raise MocapError(
            f"{len(found)} cameras are given; a volume needs at least {MIN_CAMERAS}",
            remedy="give --camera CAMERA=SOURCE for each",
        )
    return found


def live_session(root: Path, calibration: Path, names: Sequence[str], fps: float) -> Session:
    """A session of cameras that film now; its folder holds the calibration.

    Raises MocapError for a folder with a recording, whose calibration and empty room are kept as they are.
    """
    if (root / TIMESTAMPS_FILE).exists() or any((root / "videos").glob("*")):
        raise MocapError("there is a recording already", path=root, remedy="choose another folder with -o")
    found = read_calibration(calibration)
    rig = found.rig.subset([name for name in found.rig.names if name in names])
    root.mkdir(parents=True, exist_ok=True)
    write_calibration(root / "calibration.toml", rig)
    atomic_text(root / "session.toml", f"fps = {fps}\n")
    return Session(
        root=root,
        name=root.name,
        rig=rig,
        fps=fps,
        frames=ENDLESS,
        image_sources={},
        background_sources={name: root / "background" / name for name in rig.names},
        mask_sources={},
        detection_sources={},
        room_bounds_m=None,
        person_height_m=None,
        warnings=(),
        truth_dir=None,
        calibration_path=calibration,
        calibration=found,
        clips={},
    )


def backgrounds_in(folder: Path, rig: CameraRig) -> dict[str, Path]:
    """Camera -> clip or pictures of the empty room, in a session or its background/. Raises MocapError for a gap."""
    inner = folder / "background"
    found = sources_in(inner if inner.is_dir() else folder, VIDEO_SUFFIXES | IMAGE_SUFFIXES)
    for name in rig.names:
        if name not in found:
            raise MocapError(
                "there is no clip of the empty room",
                path=folder,
                camera=name,
                remedy="leave --background out",
            )
    return {name: found[name] for name in rig.names}


def learn_room(
    session: Session, pairing: Pairing, seconds: float, count_down: Callable[[float], None]
) -> None:
    """Film the empty room into the session's background/; `count_down` is told how many seconds are left.

    Raises MocapError for a camera that gives no pictures.
    """
    until_s = time.monotonic() + seconds
    pictures: dict[str, list[Image]] = {name: [] for name in session.rig.names}
    while (left_s := until_s - time.monotonic()) > 0 or _is_short(pictures, until_s):
        count_down(max(0.0, left_s))
        found = pairing.take(0.2)
        if found is None:
            continue
        for name, shot in zip(pairing.names, found.shots, strict=True):
            if shot is not None:
                pictures[name].append(shot.picture)
    for name, own in pictures.items():
        if len(own) < _FEWEST_PICTURES:
            raise MocapError(
                f"there are {len(own)} pictures of the empty room, {_FEWEST_PICTURES} are needed",
                camera=name,
                remedy="check the source; the cameras' clocks and rates (--tolerance-ms)",
            )
        folder = session.root / "background" / name
        folder.mkdir(parents=True, exist_ok=True)
        for old in folder.glob("*.png"):
            old.unlink()
        for i, picture in enumerate(own[:: -(-len(own) // _MOST_PICTURES)]):
            bgr = cv2.cvtColor(picture, cv2.COLOR_RGB2BGR)
            with utf8_name(folder / f"{i:03d}.png") as place:
                is_written = cv2.imwrite(place, bgr, _FASTEST_PNG)
            if not is_written:
                raise MocapError(
                    "a picture could not be written", path=folder, remedy="make room on the disk"
                )


def _is_short(pictures: Mapping[str, Sequence[Image]], until_s: float) -> bool:
    """Whether to wait on for a camera that was late to begin."""
    return time.monotonic() < until_s + 5.0 and min(map(len, pictures.values())) < _FEWEST_PICTURES


def keep_backgrounds(session: Session) -> None:
    """Copy clips of the empty room that lie elsewhere into the session's background/, so that it can be run."""
    folder = session.root / "background"
    for name, source in session.background_sources.items():
        if source.parent.resolve() == folder.resolve():
            continue
        target = folder / f"{name}{source.suffix}"
        folder.mkdir(parents=True, exist_ok=True)
        if source.is_dir():
            shutil.copytree(source, target, dirs_exist_ok=True)
        else:
            shutil.copyfile(source, target)


class Recording:
    """All pictures of the cameras as videos/ of a session, with when they were taken; use as context manager.

    `put` is called on the cameras' threads: each codes its own pictures, so that nobody else waits for it.
    Raises MocapError where none can be written.
    """

    def __init__(self, session: Session) -> None:
        self._session = session
        self._folder = session.root / "videos"
        self._stamps_path = session.root / TIMESTAMPS_FILE
        self._folder.mkdir(parents=True, exist_ok=True)
        self._writers = {camera.name: self._opened(camera) for camera in session.rig}
        self._n_of = dict.fromkeys(self._writers, 0)
        self._locks = {name: threading.Lock() for name in self._writers}  # a camera's picture, or the end
        self._stamping = threading.Lock()
        self._stamps = self._stamps_path.open("w", encoding="utf-8")
        self._stamps.write(",".join(TIMESTAMP_COLUMNS) + "\n")
        self._is_over = False

    def _opened(self, camera: Camera) -> cv2.VideoWriter:
        with utf8_name(self._folder / f"{camera.name}.mp4") as path:
            codec = cv2.VideoWriter.fourcc(*"mp4v")
            writer = cv2.VideoWriter(path, codec, self._session.fps, camera.size)
        if not writer.isOpened():
            raise _unwritable(self._folder, "check the folder")
        return writer

    def __enter__(self) -> Recording:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._is_over = True
        for name, writer in self._writers.items():
            with self._locks[name]:
                writer.release()
            if not self._n_of[name]:  # no clip of a camera that never filmed
                (self._folder / f"{name}.mp4").unlink(missing_ok=True)
        self._stamps.close()
        if not any(self._n_of.values()):
            self._stamps_path.unlink()

    def put(self, name: str, shot: Shot) -> None:
        """One picture of a camera. Raises MocapError when the disk is full."""
        picture = cv2.cvtColor(shot.picture, cv2.COLOR_RGB2BGR)
        with self._locks[name]:
            if self._is_over:
                return
            self._writers[name].write(picture)
            self._n_of[name] += 1
            try:
                with self._stamping:
                    self._stamps.write(f"{name},{shot.time_s:.6f}\n")
            except OSError as error:
                raise _unwritable(self._folder, "make room on the disk") from error


def _unwritable(folder: Path, remedy: str) -> MocapError:
    return MocapError("the recording cannot be written", path=folder, remedy=remedy)
