"""Progress of long work on standard error: bars on a terminal, plain lines elsewhere."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from mocap.compiling import COMPILING

if TYPE_CHECKING:
    from mocap.pipeline.cluster import Standing
    from mocap.progress import Progress

_EVERY_S = 10.0  # between two lines where nothing can be rewritten


@contextmanager
def progress_bar() -> Iterator[Progress]:
    """A bar with time left per stage on a terminal, plain lines elsewhere."""
    if sys.stderr.isatty():
        with _bars() as show:
            yield show
    else:
        yield _lines()


@contextmanager
def _bars() -> Iterator[Progress]:
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    bar = Progress(
        TextColumn("{task.description:>10}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeRemainingColumn(elapsed_when_finished=True),
        console=Console(stderr=True),
    )
    tasks: dict[str, Any] = {}

    def show(stage: str, done: int, total: int) -> None:
        if stage not in tasks:
            tasks[stage] = bar.add_task(stage, total=total)
        bar.update(tasks[stage], completed=done, total=total)

    with bar:
        yield show


def _lines() -> Progress:
    """A line per stage every ten seconds, with the time left, and at its end; short stages give one."""
    last: dict[str, float] = {}
    begun: dict[str, tuple[float, int]] = {}
    finished: dict[str, int] = {}

    def show(stage: str, done: int, total: int) -> None:
        now = time.monotonic()
        if stage == COMPILING and stage not in last:
            sys.stderr.write("compiling: once after installation, or with `mocap warm-up`\n")
        if stage not in last:
            last[stage] = now  # the first line comes after ten seconds, or at the end
            begun[stage] = now, done
        if done == total and total == finished.get(stage):
            return
        if done == total or now - last[stage] > _EVERY_S:
            last[stage] = now
            if done == total:
                finished[stage] = total
            sys.stderr.write(f"{stage}: {done}/{total}{_left(begun[stage], now, done, total)}\n")
            sys.stderr.flush()

    return show


def _left(begun: tuple[float, int], now: float, done: int, total: int) -> str:
    """How long the rest will take if it goes on as it did, in words; nothing at the end and before anything is known.

    begun : when progress was heard first, and how much was done then.
    """
    since, n_then = begun
    if done >= total or done <= n_then:
        return ""
    return f", about {duration_text((now - since) * (total - done) / (done - n_then))} left"


class FinishedStages:
    """Which stages came to their end, heard from their progress."""

    def __init__(self) -> None:
        self._left: dict[str, int] = {}

    def watching(self, show: Progress) -> Progress:
        """The progress to hand on, which tells `show` and is remembered here."""

        def heard(stage: str, done: int, total: int) -> None:
            if stage != COMPILING:
                self._left[stage] = total - done
            show(stage, done, total)

        return heard

    @property
    def stages(self) -> tuple[str, ...]:
        """In the order in which they began; one that began its frames anew is not finished."""
        return tuple(stage for stage, left in self._left.items() if left == 0)


def cell_progress(name: str) -> Callable[[Standing], None]:
    """How many cells are done and how long the rest will take: one line that is rewritten on a terminal, a line every
    ten seconds elsewhere."""
    is_terminal = sys.stderr.isatty()
    last = time.monotonic()

    def say(standing: Standing) -> None:
        nonlocal last
        is_end = standing.n_finished == standing.n_total
        if not (is_terminal or is_end or time.monotonic() - last > _EVERY_S):
            return
        last = time.monotonic()
        text = f"{name}: {progress_text(standing)}"
        sys.stderr.write(f"\r\x1b[K{text}" + "\n" * is_end if is_terminal else f"{text}\n")
        sys.stderr.flush()

    return say


def progress_text(standing: Standing) -> str:
    """For example `3/10 cells, 1 failed, 2 from earlier, 4 workers, about 1 min 20 s left`."""
    parts = [f"{standing.n_finished}/{standing.n_total} cells"]
    if standing.n_failed:
        parts.append(f"{standing.n_failed} failed")
    if standing.n_reused:
        parts.append(f"{standing.n_reused} from earlier")
    if standing.n_workers:
        parts.append(f"{standing.n_workers} worker{'s' * (standing.n_workers != 1)}")
    left = standing.left_s
    if left is not None and standing.n_finished < standing.n_total:
        parts.append(f"about {duration_text(left)} left")
    return ", ".join(parts)


def duration_text(seconds: float) -> str:
    """40 s, 1 min 20 s, 2 h 5 min."""
    whole = max(1, round(seconds))
    if whole < 60:
        return f"{whole} s"
    if whole < 3600:
        return f"{whole // 60} min {whole % 60} s"
    return f"{whole // 3600} h {whole % 3600 // 60} min"
