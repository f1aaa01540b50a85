"""Profile: where the time of a run goes, by part. Parts are measured while somebody listens, all by one clock."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager

Path = tuple[str, ...]
Measured = Mapping[Path, tuple[float, int]]
"""Path of a part -> seconds in it but not in parts inside it, and calls."""


class Profile:
    """What was measured.  own_s : path of a part -> seconds in it but not in parts inside it, summed over calls and
    threads.  n_calls : path -> calls. A path begins anew on every thread.
    """

    def __init__(self) -> None:
        self.own_s: dict[Path, float] = {}
        self.n_calls: dict[Path, int] = {}
        self._lock = threading.Lock()
        self._of_thread = threading.local()

    @contextmanager
    def measured(self, name: str) -> Iterator[None]:
        """Measure a block as a part of the one around it."""
        # Open parts of this thread: [path, seconds in parts inside it].
        stack: list[tuple[Path, list[float]]] = self._of_thread.__dict__.setdefault("stack", [])
        path = (*(stack[-1][0] if stack else ()), name)
        inside = [0.0]
        stack.append((path, inside))
        started = time.perf_counter()
        try:
            yield
        finally:
            took = time.perf_counter() - started
            stack.pop()
            if stack:
                stack[-1][1][0] += took
            self.add({path: (took - inside[0], 1)})

    def add(self, measured: Measured) -> None:
        """What was measured elsewhere."""
        with self._lock:
            for path, (seconds, n) in measured.items():
                self.own_s[path] = self.own_s.get(path, 0.0) + seconds
                self.n_calls[path] = self.n_calls.get(path, 0) + n

    def taken(self) -> Measured:
        """What was measured since this was asked last."""
        with self._lock:
            found = {path: (seconds, self.n_calls[path]) for path, seconds in self.own_s.items()}
            self.own_s, self.n_calls = {}, {}
        return found

    def lines(self, n_frames: int) -> list[str]:
        """The parts as a table, the parts of each part below it, the longest first."""
        whole = {
            path: sum(s for other, s in self.own_s.items() if other[: len(path)] == path)
            for path in self.own_s
        }

        def rank(path: Path) -> list[tuple[float, str]]:
            return [(-whole.get(path[: i + 1], 0.0), path[i]) for i in range(len(path))]

        rows = [f"{'part':<40} {'calls':>7} {'seconds':>9} {'own':>9} {'ms per frame':>13}"]
        for path in sorted(whole, key=rank):
            name = "  " * (len(path) - 1) + path[-1]
            per_frame = 1e3 * whole[path] / max(n_frames, 1)
            rows.append(
                f"{name:<40} {self.n_calls[path]:7d} {whole[path]:9.2f} {self.own_s[path]:9.2f} {per_frame:13.1f}"
            )
        return rows


_listening: Profile | None = None


@contextmanager
def profiled() -> Iterator[Profile]:
    """Measure the parts of what is done inside, on all threads."""
    global _listening
    before, _listening = _listening, Profile()
    try:
        yield _listening
    finally:
        _listening = before


@contextmanager
def part(name: str) -> Iterator[None]:
    """A part of the work, measured if somebody listens."""
    if _listening is None:
        yield
        return
    with _listening.measured(name):
        yield


@contextmanager
def measured_apart() -> Iterator[Callable[[], Measured]]:
    """For a forked process, whose parts nobody here hears of: gives what tells those since it was asked last."""
    if _listening is None:
        yield dict
        return
    with profiled() as own:
        yield own.taken


def heard(measured: Measured) -> None:
    """Take over what a forked process has measured, if somebody listens."""
    if _listening is not None:
        _listening.add(measured)
