"""A live run: cameras, pairing, engine and outputs, until somebody stops it."""

from __future__ import annotations

import tempfile
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from mocap.data import Occluders
from mocap.io.session import Session
from mocap.io.store import StageStore
from mocap.pipeline.checks import check_device
from mocap.pipeline.config import Config
from mocap.pipeline.live.capture import CameraThread, Pace, Shot
from mocap.pipeline.live.engine import Engine, FrameResult
from mocap.pipeline.live.outputs import Sink
from mocap.pipeline.live.pairing import Pairing, PairingCounts, PictureSet
from mocap.pipeline.live.room import MIN_CAMERAS, Recording, keep_backgrounds, learn_room
from mocap.pipeline.stale import forget_stale_kernels
from mocap.threads import quick_turns

_WINDOW = 100  # results that the rate and the latency on the screen are of
_SHOWN_S = 1.0
_POLL_S = 0.1
_START_S = 0.5  # files begin so long after their threads

Taker = Callable[[str, Shot], None]

# A first pose is wanted soon: 2.5 s of a core instead of 3.8 s; whoever sets more gets more.
LIVE_DEFAULTS = ("pose.n_start_frames=1", "pose.n_first_poses=4")
# Both need the end of the clip.
LIVE_SETTINGS = ("volume.on_bad_camera=ignore", "volume.occluders=ignore")


@dataclass(frozen=True, eq=False)
class LiveOrder:
    """What is to be followed.

    session : rig, fps and backgrounds.  sources : camera -> device, URL or file.  rate : of files, of their own pace.
    background_s : how long the empty room is filmed first; 0 = the session has backgrounds.
    tolerance_s, stalled_s : see `Pairing`.  seconds : to run for; None = until the sources end or it is stopped.
    """

    session: Session
    sources: Mapping[str, str]
    config: Config
    rate: float = 1.0
    background_s: float = 0.0
    tolerance_s: float = 0.02
    stalled_s: float = 0.25
    seconds: float | None = None
    is_recorded: bool = False
    seed: int = 0
    n_threads: int = 2


@dataclass(eq=False)
class LiveStatus:
    """How a live run stands.  n_failures : by camera, how often its source failed.  latest : result."""

    counts: PairingCounts = field(default_factory=PairingCounts)
    n_results: int = 0
    n_failures: dict[str, int] = field(default_factory=dict)
    latest: FrameResult | None = None
    _latencies_s: deque[float] = field(default_factory=lambda: deque(maxlen=_WINDOW))
    _done_s: deque[float] = field(default_factory=lambda: deque(maxlen=_WINDOW))

    def note(self, result: FrameResult) -> None:
        """One more result."""
        self.n_results += 1
        self.latest = result
        self._latencies_s.append(result.latency_s)
        self._done_s.append(time.monotonic())

    @property
    def results_per_s(self) -> float:
        """Of the last results."""
        span_s = self._done_s[-1] - self._done_s[0] if len(self._done_s) > 1 else 0.0
        return (len(self._done_s) - 1) / span_s if span_s > 0 else 0.0

    def latency_s(self, percentile: float) -> float:
        """From the picture to the result, of the last results."""
        return float(np.percentile(self._latencies_s, percentile)) if self._latencies_s else 0.0


def run_live(
    order: LiveOrder,
    sinks: Sequence[Sink],
    *,
    show: Callable[[LiveStatus], None],
    count_down: Callable[[float], None],
) -> LiveStatus:
    """Follow who is before the cameras; `show` is told every second how it goes.

    Raises MocapError for a device that does not answer, and a camera that gives no usable pictures at the beginning.
    """
    forget_stale_kernels()
    check_device(order.config)
    session, rig = order.session, order.session.rig
    pairing = Pairing(rig.names, order.tolerance_s, order.stalled_s, min(MIN_CAMERAS, len(rig)))
    status = LiveStatus(pairing.counts)
    with ExitStack() as stack:
        stack.enter_context(quick_turns())
        store = StageStore(
            Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="mocap-"))) / "store.zarr"
        )

        def engine() -> Engine:
            nothing = Occluders({}, 1)
            made = Engine(session, order.config, store, nothing, seed=order.seed, n_threads=order.n_threads)
            return stack.enter_context(made)

        takers = [pairing.add]
        recording = stack.enter_context(Recording(session)) if order.is_recorded else None
        # Files begin when all is ready; cameras film the empty room first.
        made = engine() if order.background_s <= 0 else None
        threads = _filming(order, takers, stack)
        if order.background_s > 0:
            learn_room(session, pairing, order.background_s, count_down)
        made = made or engine()
        if recording is not None:
            keep_backgrounds(session)
            takers.append(recording.put)
        last_s = time.monotonic()
        for result in made.results(_sets(order, pairing, threads)):
            status.note(result)
            for sink in sinks:
                sink.put(result)
            if time.monotonic() - last_s > _SHOWN_S:
                last_s = time.monotonic()
                status.n_failures = {t.camera.name: t.n_failures for t in threads}
                show(status)
        status.n_failures = {t.camera.name: t.n_failures for t in threads}
    return status


def _filming(order: LiveOrder, takers: Sequence[Taker], stack: ExitStack) -> list[CameraThread]:
    """The cameras at work, until the stack is left; every picture goes to all takers, also those that come later."""

    def take(name: str, shot: Shot) -> None:
        for taker in takers:
            taker(name, shot)

    session, start_s = order.session, time.monotonic() + _START_S
    threads = [
        CameraThread(
            camera,
            order.sources[camera.name],
            take,
            pace=_pace(session, camera.name, order.rate),
            start_s=start_s,
        )
        for camera in session.rig
    ]
    for thread in threads:
        stack.callback(thread.stop)
        thread.start()
    return threads


def _pace(session: Session, name: str, rate: float) -> Pace:
    """How a camera's file is played: a session's clips by its clocks."""
    places = session.clip_frames.get(name)
    return Pace(session.fps, rate, places, 0 if places is None else session.frames.start)


def _sets(order: LiveOrder, pairing: Pairing, threads: Sequence[CameraThread]) -> Iterator[PictureSet]:
    """The newest set whenever one is asked for, until the sources end or the time is over."""
    until_s = None if order.seconds is None else time.monotonic() + order.seconds
    while until_s is None or time.monotonic() < until_s:
        found = pairing.take(_POLL_S)
        if found is not None:
            yield found
            continue
        errors = [thread.error for thread in threads if thread.error is not None]
        if len(threads) - len(errors) < pairing.min_cameras:
            raise errors[0]
        if all(thread.is_over or thread.error for thread in threads):
            return
