"""The viewer that shows a scene while it happens: on this machine alone, and nobody waits for one that is gone."""

from __future__ import annotations

import importlib.util
import sys
import time
import urllib.request
from collections.abc import Callable, Iterator
from pathlib import Path
from urllib.parse import parse_qs, urlparse

import pytest
import view_world as world

from mocap.errors import MissingExtra, MocapError
from mocap.view import viewer as viewer_module
from mocap.view.scene import SceneFrame
from mocap.view.viewer import LiveViewer, start_viewer

needs_rerun = pytest.mark.skipif(
    importlib.util.find_spec("rerun") is None, reason="rerun-sdk is not installed"
)


@pytest.fixture
def viewer() -> Iterator[LiveViewer]:
    shown = LiveViewer(world.rig(), "web", bounds_m=((-2.0, -1.5, 0.0), (2.0, 1.5, 2.2)))
    yield shown
    shown.close()


def frame(number: int) -> SceneFrame:
    landmarks = world.pose(0.2)
    return SceneFrame(number, number / 20, persons={3: landmarks}, parts={3: world.body(landmarks)})


def listening() -> set[tuple[str, int]]:
    """Addresses of this machine, in hexadecimal, and ports that somebody listens to."""
    tables = [Path("/proc/net", name).read_text() for name in ("tcp", "tcp6")]
    rows = [line.split() for table in tables for line in table.splitlines()]
    places = [row[1].split(":") for row in rows if row[3] == "0A"]
    return {(address, int(port, 16)) for address, port in places}


def wait_until(is_so: Callable[[], bool]) -> None:
    until_s = time.monotonic() + 60.0
    while not is_so():
        assert time.monotonic() < until_s, "waited in vain"
        time.sleep(0.1)


@needs_rerun
@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
def test_the_page_is_shown_to_this_machine_alone(viewer: LiveViewer) -> None:
    url = urlparse(viewer.url)
    (address,) = parse_qs(url.query)["url"]
    ports = {url.port, urlparse(address.removeprefix("rerun+")).port}
    for number in range(5):
        viewer.put(frame(number))
    wait_until(lambda: len({place for place in listening() if place[1] in ports}) == 2)
    assert {place for place in listening() if place[1] in ports} == {("0100007F", port) for port in ports}
    assert b"rerun" in urllib.request.urlopen(viewer.url, timeout=20.0).read().lower()
    viewer.close()
    wait_until(lambda: not {place for place in listening() if place[1] in ports})


@needs_rerun
def test_a_viewer_that_is_closed_stops_nobody(viewer: LiveViewer) -> None:
    viewer.put(frame(0))
    viewer_module._end(viewer._process)
    started = time.monotonic()
    for number in range(1, 50):
        viewer.put(frame(number))
    assert time.monotonic() - started < 20.0


@needs_rerun
def test_a_window_needs_a_display(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "platform", "linux")
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    with pytest.raises(MocapError, match="--view web"):
        LiveViewer(world.rig(), "window")


def test_a_missing_extra_is_one_clear_message(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "rerun", None)
    for start in (lambda: LiveViewer(world.rig(), "web"), lambda: start_viewer("scene.rrd")):
        with pytest.raises(MissingExtra, match=r"mocap-volumes\[view\]"):
            start()
