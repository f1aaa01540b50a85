"""Capture: every camera is read on a thread of its own; one that stalls or dies stops no other, and is opened again."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import nullcontext, suppress
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from mocap.data import Camera
from mocap.errors import MocapError
from mocap.io.video import iter_clip
from mocap.portable import utf8_name

Image = NDArray[np.uint8]

_OPEN_MS, _READ_MS = 3000, 3000  # a stream that is silent for so long is opened again
_RETRY_S = 0.5  # pause before a source is opened again
_KEPT = 8  # pictures of a camera that wait to be paired: a quarter of a second


@dataclass(frozen=True, eq=False)
class Shot:
    """One picture (H, W, 3) uint8 RGB.

    time_s : that it shows; of a file, which may be played at another pace, its own.  taken_s : on the clock
    (time.monotonic) when it was taken over.
    """

    time_s: float
    taken_s: float
    picture: Image


@dataclass(frozen=True)
class Pace:
    """How a file is played.

    fps : of the file.  rate : of its own pace.  clip_frames : the pictures of the file that show frames 0, 1, ... where
    its clock is another; None = picture k shows frame k.  first : frame that all files begin with.
    """

    fps: float
    rate: float = 1.0
    clip_frames: NDArray[np.int64] | None = None
    first: int = 0


def is_file(source: str) -> bool:
    """Whether a source is a file or folder: no number of a device and no URL."""
    return not source.isdecimal() and "://" not in source


class CameraThread:
    """One camera, read on a thread of its own.

    source : number of a device, URL (RTSP, HTTP), or a file, which is played once at its pace.
    on_shot : called on the thread with every picture.  n_shots : pictures so far.  n_failures : how often the source
    could not be opened or fell silent.  is_over : a file has come to its end.
    """

    def __init__(
        self, camera: Camera, source: str, on_shot: Callable[[str, Shot], None], *, pace: Pace, start_s: float
    ) -> None:
        self.camera, self.source = camera, source
        self.n_shots = self.n_failures = 0
        self.is_over = False
        self.error: MocapError | None = None
        self._on_shot, self._pace, self._start_s = on_shot, pace, start_s
        self._is_stopped = threading.Event()
        self._thread = threading.Thread(target=self._work, name=f"mocap-live-{camera.name}", daemon=True)

    def start(self) -> None:
        self._thread.start()

    def stop(self) -> None:
        """End the thread; a source that hangs is left behind with it."""
        self._is_stopped.set()
        self._thread.join(0.5)

    def _work(self) -> None:
        try:
            if is_file(self.source):
                self._play()
            else:
                self._film()
        except MocapError as error:
            self.error = error

    def _film(self) -> None:
        """A device or stream, which is opened again whenever it fails."""
        while not self._is_stopped.is_set():
            for picture in _stream(self.source):
                now_s = time.monotonic()
                self._take(Shot(now_s, now_s, picture))
                if self._is_stopped.is_set():
                    return
            self.n_failures += 1
            self._is_stopped.wait(_RETRY_S)

    def _play(self) -> None:
        """A file at its own pace: each picture when it is due, however long the last one took."""
        try:
            for frame, picture in self._shown():
                shown_s = (frame - self._pace.first) / self._pace.fps
                due_s = self._start_s + shown_s / self._pace.rate
                if self._is_stopped.wait(max(0.0, due_s - time.monotonic())):
                    return
                self._take(Shot(self._start_s + shown_s, due_s, picture))
        finally:
            self.is_over = True

    def _shown(self) -> Iterator[tuple[int, Image]]:
        """Frames of the session, ascending, with the picture that shows each."""
        places = self._pace.clip_frames
        clip = iter_clip(Path(self.source), size=self.camera.size, camera=self.camera.name)
        for i, picture in enumerate(clip):
            frames = [i] if places is None else np.flatnonzero(places == i).tolist()
            yield from ((frame, picture) for frame in frames if frame >= self._pace.first)

    def _take(self, shot: Shot) -> None:
        height, width = shot.picture.shape[:2]
        if (width, height) != self.camera.size:
            raise MocapError(
                f"the source gives pictures of {width} x {height}, the calibration says "
                f"{self.camera.size[0]} x {self.camera.size[1]}",
                camera=self.camera.name,
                remedy="set the camera to the size that it was calibrated with, or calibrate it again",
            )
        self.n_shots += 1
        self._on_shot(self.camera.name, shot)


def _stream(source: str) -> Iterator[Image]:
    """The pictures of a device or URL until it fails."""
    capture = _open(source)
    try:
        while capture.isOpened():
            ok, bgr = capture.read()
            if not ok or bgr is None:
                return
            yield np.asarray(cv2.cvtColor(bgr, cv2.COLOR_BGR2RGB), dtype=np.uint8)
    finally:
        capture.release()


def _open(source: str) -> cv2.VideoCapture:
    if source.isdecimal():
        capture = cv2.VideoCapture(int(source))
        # The newest picture, not those that have waited in the driver.
        with suppress(cv2.error):
            capture.set(cv2.CAP_PROP_BUFFERSIZE, 1)
        return capture
    # One thread: with more, FFmpeg gives each picture so many pictures late.
    options = [
        cv2.CAP_PROP_OPEN_TIMEOUT_MSEC, _OPEN_MS, cv2.CAP_PROP_READ_TIMEOUT_MSEC, _READ_MS, cv2.CAP_PROP_N_THREADS, 1,
    ]  # fmt: skip
    with utf8_name(Path(source)) if Path(source).is_file() else nullcontext(source) as name:
        return cv2.VideoCapture(name, cv2.CAP_FFMPEG, options)


def kept_shots() -> deque[Shot]:
    """Room for the pictures of a camera that wait to be paired; the oldest ones give way."""
    return deque(maxlen=_KEPT)
