"""A walk over the clip: stages side by side, each some frames behind the one before, and a recorder that writes.

A frame goes from hand to hand: what a stage finds in it is shown to the next one, which need not read it from the
store. While one stage works on a frame, the next one works on the frame before.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Executor, Future, ThreadPoolExecutor, wait
from contextlib import AbstractContextManager, ExitStack, contextmanager
from dataclasses import replace
from functools import partial
from itertools import chain, repeat
from types import TracebackType
from typing import Any, TypeVar

from mocap.forks import can_fork, given
from mocap.io.store import StageWriter
from mocap.pipeline.stage import ClipWork, Ending, FrameWork, Job, Row, Seen, Sources, Stage
from mocap.profiling import Measured, heard, measured_apart, part
from mocap.threads import Ahead, in_parallel

T = TypeVar("T")

# Frames that a stage may be ahead of the next one; pictures and volumes of no more are held.
_AHEAD_FRAMES = 2
# And that a forked process may be ahead of the thread that hears it: with none it waits for the next question.
_TOLD_AHEAD = 1


def walks(stages: Sequence[Stage]) -> Iterator[tuple[Stage, ...]]:
    """The stages in order, those together that can walk together: frame by frame, and none needs the end of another, or
    it presumes what that will be."""
    together: list[Stage] = []
    for stage in stages:
        is_whole = isinstance(stage.work, ClipWork)
        waits_for = {s.name for s in together if s.found_nothing is None}
        if together and (is_whole or waits_for & set(stage.needs_whole)):
            yield tuple(together)
            together = []
        together.append(stage)
        if is_whole:
            yield tuple(together)
            together = []
    if together:
        yield tuple(together)


def run_stage(stage: Stage, job: Job) -> None:
    """Compute the products of one stage into the store; of the configuration it is shown what its key holds."""
    run_together([(stage, job)])


def run_together(stages: Sequence[tuple[Stage, Job]]) -> dict[str, float]:
    """Compute the products of stages that walk together into the store; the seconds that each has worked.

    The result is that of one stage after the other.
    """
    names = frozenset(stage.name for stage, _ in stages)
    shown = [
        (stage, replace(job, config=job.config.only(stage.sections), presumed=names & {*stage.needs_whole}))
        for stage, job in stages
    ]
    (first, job), *_ = shown
    if isinstance(first.work, ClipWork):
        started = time.perf_counter()
        with part(first.name):
            first.work.run(job)
        return {first.name: time.perf_counter() - started}
    each = partial(_each, job.n_threads)
    walkers = [Walker(stage, replace(own, each=each)) for stage, own in shown]
    left: Sequence[Walker] = walkers
    while left:
        left = _walk(left)
    return {walker.stage.name: walker.wall_s for walker in walkers}


def _each(n_threads: int, job: Callable[..., T], *columns: Sequence[Any]) -> list[T]:
    """`map` on threads of the process that asks, which may be a forked one."""
    return in_parallel(lambda row: job(*row), list(zip(*columns, strict=False)), n_threads)


Found = tuple[Seen, Sequence[Row]]
"""A frame with what was found in it, and the rows that are certain by now."""


class Walker:
    """A stage that works frame by frame, with its state.  busy_s : how long each half of its steps has worked.
    is_refuted : whether a frame has shown that what it presumes is not so."""

    def __init__(self, stage: Stage, job: Job) -> None:
        assert isinstance(stage.work, FrameWork)
        self.stage, self.work, self.job = stage, stage.work, job
        self.busy_s = [0.0, 0.0]
        self.start()

    def start(self, state: Any = None) -> None:
        """Begin a walk, with a state or anew."""
        self.is_refuted = False
        with self._timed(0):
            self.state = self.work.start(self.job) if state is None else state

    @property
    def wall_s(self) -> float:
        """How long it has worked; of halves side by side, the longer."""
        return sum(self.busy_s) if self.job.n_threads == 1 else max(self.busy_s)

    def step(self, seen: Seen) -> Found:
        """One frame, both halves."""
        return self._second(self._first(seen))

    def steps(
        self, frames: Iterable[Seen], recorder: Recorder, apart: Callable[[Iterator[Found]], Iterator[Found]]
    ) -> Iterator[Seen]:
        """The frames in order, with what was found in them.  apart : has what it is given made on another thread, or by
        another process; called at once, by who asks."""
        found = map(self._first, frames)
        return self._recorded(found if self.work.then is None else map(self._second, apart(found)), recorder)

    def _recorded(self, found: Iterable[Found], recorder: Recorder) -> Iterator[Seen]:
        n = len(self.job.session.frames)
        for seen, rows in found:
            recorder.take(rows)
            # The last one is done when the products are; a walk that is of no use is not told of.
            if seen.index + 1 < n and not self.is_refuted:
                self.job.progress(self.stage.name, seen.index + 1, n)
            yield seen

    def _first(self, seen: Seen) -> Found:
        if seen.is_refuted:
            self.is_refuted = True
            return seen, ()
        with self._timed(0), part(self.stage.name):
            self.state, seen, rows = self.work.step(self.state, seen)
        return seen, rows

    def _second(self, found: Found) -> Found:
        if self.work.then is None:
            return found
        if self.is_refuted:
            return replace(found[0], begun=None), ()
        with self._timed(1), part(self.stage.name):
            seen, rows = self.work.then(self.state, found[0])
        return replace(seen, begun=None), (*found[1], *rows)

    @contextmanager
    def _timed(self, half: int) -> Iterator[None]:
        started = time.perf_counter()
        try:
            yield
        finally:
            self.busy_s[half] += time.perf_counter() - started


class Recorder:
    """Writes the rows of one stage into its products; with a thread of its own, while the stage goes on.

    Use as context manager: what has not come to its end by then leaves nothing.
    """

    def __init__(self, writers: Mapping[str, StageWriter], thread: Executor | None = None) -> None:
        self._writers, self._thread = writers, thread
        self._last: Future[None] | None = None
        self._open = ExitStack()

    def __enter__(self) -> Recorder:
        with ExitStack() as opened:
            for writer in self._writers.values():
                opened.enter_context(writer)
            self._open = opened.pop_all()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        wait(() if self._last is None else (self._last,))  # what it has raised has been told, or is of no use
        for writer in self._writers.values():
            writer.discard()
        self._open.close()

    def take(self, rows: Sequence[Row]) -> None:
        """Write rows, behind those of before; raises what writing these has raised."""
        self.catch_up()
        if self._thread is None:
            self._write(rows)
        elif rows:
            self._last = self._thread.submit(self._write, rows)

    def catch_up(self) -> None:
        """Wait until all is written."""
        if self._last is not None:
            self._last.result()

    def end(self, ending: Ending) -> None:
        """What is known when all frames have been seen: with it the products are complete, and put in place."""
        self.take(ending.rows)
        self.catch_up()
        for product, attrs in ending.attrs.items():
            self._writers[product].describe(attrs)
        self._open.close()

    def _write(self, rows: Sequence[Row]) -> None:
        for row in rows:
            self._writers[row.product].append(row.frame, **row.arrays)


def _walk(walkers: Sequence[Walker]) -> Sequence[Walker]:
    """One walk over all frames, and word of those that are done; gives the others, which have to walk again."""
    try:
        again = _once(walkers, may_fork=True)
    except ChildProcessError:  # it was killed, for its memory perhaps
        for walker in walkers:
            walker.start()
        again = _once(walkers, may_fork=False)
    for walker in walkers[: len(walkers) - len(again)]:
        n = len(walker.job.session.frames)
        walker.job.progress(walker.stage.name, n, n)
    return again


def _once(walkers: Sequence[Walker], *, may_fork: bool) -> Sequence[Walker]:
    """One walk over all frames; gives those that have to walk again, each with its new state."""
    with ExitStack() as stack:
        thread = stack.enter_context(ThreadPoolExecutor(1)) if walkers[0].job.n_threads > 1 else None
        recorders = [
            stack.enter_context(Recorder({p: walker.job.writer(p) for p in walker.stage.products}, thread))
            for walker in walkers
        ]
        with ExitStack() as streams:
            _go(walkers, recorders, streams, may_fork=may_fork)
        for k, walker in enumerate(walkers):
            ending = walker.work.finish(walker.state) if _presumed_rightly(walker, walkers[:k]) else None
            if ending is None or ending.again is not None:
                return _again(walkers[k:], None if ending is None else ending.again)
            recorders[k].end(ending)
    return ()


def _presumed_rightly(walker: Walker, done: Sequence[Walker]) -> bool:
    """Whether what a walker has presumed of others, whose products are there by now, was so."""
    presumed = [other for other in done if other.stage.name in walker.job.presumed]
    return not walker.is_refuted and all(
        other.stage.found_nothing is not None and other.stage.found_nothing(other.job) for other in presumed
    )


def _again(walkers: Sequence[Walker], state: Any) -> Sequence[Walker]:
    """Walkers that begin another walk, the first one with a state if there is one; they presume nothing of those that
    are done."""
    names = {walker.stage.name for walker in walkers}
    for walker in walkers:
        walker.job = replace(walker.job, presumed=walker.job.presumed & names)
        walker.start(state if walker is walkers[0] else None)
    return walkers


def _go(
    walkers: Sequence[Walker], recorders: Sequence[Recorder], streams: ExitStack, *, may_fork: bool
) -> None:
    """Every frame through the hands of all walkers, each half of a step on a thread of its own where there are some.

    The very first half has a process of its own where that can be: an interpreter runs one thread at a time.
    """
    first, n_threads = walkers[0], walkers[0].job.n_threads
    reads = [walker.work.reads(walker.job) for walker in walkers]
    apart = first.work.apart if may_fork and n_threads > 1 and can_fork() else None
    n_left = n_threads if apart is None else n_threads - 1

    def on_thread(stream: Iterator[T]) -> Iterator[T]:
        return stream if n_left == 1 else streams.enter_context(Ahead(stream, _AHEAD_FRAMES))

    def by_process(found: Iterator[Found]) -> Iterator[Found]:
        spent = reads[0].keys() - {*(apart or ()), *(name for others in reads[1:] for name in others)}
        told = streams.enter_context(given(lambda: _telling(first, found, spent), _TOLD_AHEAD))
        return streams.enter_context(Ahead(_heard(first, told), _AHEAD_FRAMES))

    stream: Iterator[Seen] = _frames(walkers, reads, streams)
    for walker, recorder in zip(walkers, recorders, strict=True):
        if walker is first:
            stream = walker.steps(stream, recorder, on_thread if apart is None else by_process)
        else:
            stream = walker.steps(on_thread(stream), recorder, on_thread)
    for _ in stream:
        pass


Told = tuple[Found | None, float, Measured]
"""What a forked process found in a frame, None behind the last; how long its half has worked; parts of a profile."""


@contextmanager
def _telling(walker: Walker, found: Iterator[Found], spent: Iterable[str]) -> Iterator[Iterator[Told]]:
    """In a forked process: tells what it finds, frame by frame.  spent : fields of `Seen` of no use from here on."""
    leaves: dict[str, Any] = dict.fromkeys(spent)
    less = ((replace(seen, **leaves), rows) for seen, rows in found)
    with measured_apart() as measured:
        yield ((own, walker.busy_s[0], measured()) for own in chain(less, repeat(None)))


def _heard(walker: Walker, told: Iterator[Told]) -> Iterator[Found]:
    """What a forked process finds."""
    for found, walker.busy_s[0], measured in told:
        heard(measured)
        if found is None:
            return
        yield found


def _frames(walkers: Sequence[Walker], reads: Sequence[Sources], streams: ExitStack) -> Iterator[Seen]:
    """The frames of the session in order, with what is read of them; every source is opened once.

    The first walker's time is that of the reading too.
    """
    sources: dict[str, Iterable[tuple[int, Any]]] = {}
    found: set[str] = set()
    for walker, own in zip(walkers, reads, strict=True):
        sources.update({name: rows for name, rows in own.items() if name not in found | sources.keys()})
        found.update(walker.work.finds)
    for source in sources.values():
        if isinstance(source, AbstractContextManager):
            streams.enter_context(source)
    return _read(walkers[0], {name: iter(source) for name, source in sources.items()})


def _read(first: Walker, values: Mapping[str, Iterator[tuple[int, Any]]]) -> Iterator[Seen]:
    for i, frame in enumerate(first.job.session.frames):
        started = time.perf_counter()
        with part("read"):
            seen = Seen(i, frame, **{name: next(rows)[1] for name, rows in values.items()})
        first.busy_s[0] += time.perf_counter() - started
        yield seen
