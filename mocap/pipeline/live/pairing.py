"""Pairing: pictures of several cameras that were taken at one time; the newest complete set wins."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field

from mocap.pipeline.live.capture import Shot, kept_shots


@dataclass(frozen=True, eq=False)
class PictureSet:
    """Pictures of one time.  shots : one per camera in order, None of a camera that has fallen silent."""

    shots: tuple[Shot | None, ...]

    @property
    def time_s(self) -> float:
        """That the latest of them shows."""
        return max(shot.time_s for shot in self.shots if shot is not None)

    @property
    def taken_s(self) -> float:
        """When the latest of them was taken over."""
        return max(shot.taken_s for shot in self.shots if shot is not None)


@dataclass
class PairingCounts:
    """n_sets : that were given.  n_dropped : complete ones that a newer one has overtaken.  n_partial : of those given,
    without all cameras."""

    n_sets: int = 0
    n_dropped: int = 0
    n_partial: int = 0


@dataclass(eq=False)
class Pairing:
    """Collects pictures from several threads and gives the newest set.

    tolerance_s : the pictures of a set lie within this time.  stalled_s : a camera that is silent for so long, while
    others are not, is waited for no more.  min_cameras : fewer make no set.
    """

    names: Sequence[str]
    tolerance_s: float
    stalled_s: float
    min_cameras: int
    counts: PairingCounts = field(default_factory=PairingCounts)

    def __post_init__(self) -> None:
        self._waiting: dict[str, deque[Shot]] = {name: kept_shots() for name in self.names}
        self._last_s: dict[str, float] = {}
        self._first_s = float("inf")  # of any camera: who was never heard of is waited for from then on
        self._has_news = threading.Condition()

    def add(self, name: str, shot: Shot) -> None:
        """A picture of a camera; called on the camera's thread."""
        with self._has_news:
            self._waiting[name].append(shot)
            self._first_s = min(self._first_s, shot.time_s)
            self._last_s[name] = shot.time_s
            self._has_news.notify_all()

    def take(self, timeout_s: float) -> PictureSet | None:
        """The newest set that was not taken yet, at once or as soon as there is one; None after timeout_s."""
        with self._has_news:
            found: PictureSet | None = None

            def is_there() -> bool:
                nonlocal found
                found = self._newest()
                return found is not None

            self._has_news.wait_for(is_there, timeout_s)
            return found

    def _newest(self) -> PictureSet | None:
        """The newest complete set of the cameras that are not silent; all that is older is forgotten."""
        newest_s = max(self._last_s.values(), default=0.0)
        present = [n for n in self.names if newest_s - self._last_s.get(n, self._first_s) < self.stalled_s]
        if len(present) < self.min_cameras or not all(self._waiting[name] for name in present):
            return None
        # The latest time of which every camera may have a picture: that of the camera that is behind.
        at_s = min(self._waiting[name][-1].time_s for name in present)
        chosen = {n: min(self._waiting[n], key=lambda shot: abs(shot.time_s - at_s)) for n in present}
        times = [shot.time_s for shot in chosen.values()]
        if max(times) - min(times) > self.tolerance_s:
            return None
        self._forget(chosen)
        shots = tuple(chosen.get(name) for name in self.names)
        self.counts.n_sets += 1
        self.counts.n_partial += len(chosen) < len(self.names)
        return PictureSet(shots)

    def _forget(self, chosen: dict[str, Shot]) -> None:
        passed = []
        for name, shot in chosen.items():
            waiting, n = self._waiting[name], 0
            while waiting and waiting[0].time_s <= shot.time_s:
                n += waiting.popleft() is not shot
            passed.append(n)
        for name in self.names:
            if name not in chosen:
                self._waiting[name].clear()
        self.counts.n_dropped += min(passed, default=0)
