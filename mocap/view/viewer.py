"""The viewer of rerun-sdk: opened on a file, or shown a scene while it happens, on this machine alone."""

from __future__ import annotations

import math
import os
import signal
import socket
import subprocess
import sys
from collections.abc import Mapping, Sequence
from contextlib import suppress
from urllib.parse import quote

from mocap.data import CameraRig
from mocap.errors import MocapError
from mocap.view.scene import CodedPictures, Image, SceneFrame, SceneLog, ScenePictures, import_rerun

LOOPBACK = "127.0.0.1"
PLACES = ("window", "web")
"""Where a live scene can be shown."""
_MEMORY = "1GB"  # of what was shown, the oldest goes when there is more


def start_viewer(*words: str) -> subprocess.Popen[bytes]:
    """Start the viewer with command-line words, as a process that outlives this one.

    Its usage statistics are switched off before. Raises MissingExtra.
    """
    import_rerun("use a Rerun viewer of your own")
    rerun = [sys.executable, "-m", "rerun"]
    subprocess.run([*rerun, "analytics", "disable"], check=False, capture_output=True)
    return subprocess.Popen(
        [*rerun, *words], start_new_session=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )


class LiveViewer:
    """A scene that the viewer shows while it happens; the viewer and its page listen to this machine alone.

    where : one of PLACES: a window, which stays open at the end, or a page for a browser, which ends with `close`.
    url : of the page, None of a window. A viewer that is closed meanwhile stops nobody.
    Raises MocapError without rerun-sdk, and for a window where there is no display.
    """

    def __init__(
        self,
        rig: CameraRig,
        where: str,
        *,
        bounds_m: Sequence[Sequence[float]] | None = None,
    ) -> None:
        rr = import_rerun()
        if where == "window" and sys.platform == "linux" and not _has_display():
            raise MocapError("there is no display for the window of the 3D scene", remedy="write --view web")
        port, page = free_ports(2)
        words = ["--bind", LOOPBACK, "--port", str(port), "--memory-limit", _MEMORY]
        if where == "web":
            words += ["--serve-web", "--web-viewer-port", str(page), "--server-memory-limit", _MEMORY]
        self._where, self._process = where, start_viewer(*words)
        address = f"rerun+http://{LOOPBACK}:{port}/proxy"
        self.url = f"http://{LOOPBACK}:{page}/?url={quote(address, safe='')}" if where == "web" else None
        self._stream = rr.RecordingStream("mocap", recording_id="live", send_properties=False)
        self._stream.connect_grpc(address)
        self._log = SceneLog(self._stream, rig, bounds_m=bounds_m)
        self._pictures = ScenePictures(rig, 1, max_bytes=math.inf)

    def put(self, item: SceneFrame, pictures: Mapping[str, Image] | None = None) -> None:
        """Show a frame; may wait for a viewer that is slow or just starting.

        pictures : camera name -> (H, W, 3) uint8 RGB as filmed; None = those of before stay.
        """
        self._log.put(item)
        files = self._pictures.fitting(pictures or {})
        if files:
            self._log.put_pictures(CodedPictures(item.frame, item.time_s, files))

    def close(self) -> None:
        """Send what is left, and end the page."""
        self._stream.disconnect()
        if self._where == "web":
            _end(self._process)


def _end(process: subprocess.Popen[bytes]) -> None:
    """End a viewer: what was started is a script of Python, which has started the program, in a session of its own."""
    if hasattr(os, "killpg"):
        with suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGTERM)
    else:
        process.terminate()
    process.wait()


def _has_display() -> bool:
    return any(os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY"))


def free_ports(n: int) -> list[int]:
    """Ports of this machine that nobody listens to now."""
    taken = [socket.socket() for _ in range(n)]
    try:
        for one in taken:
            one.bind((LOOPBACK, 0))
        return [one.getsockname()[1] for one in taken]
    finally:
        for one in taken:
            one.close()
