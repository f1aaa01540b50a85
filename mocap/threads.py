"""Threads that are kept: starting one costs more than many of the jobs."""

from __future__ import annotations

import itertools
import os
import queue
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from contextlib import contextmanager
from functools import cache
from types import TracebackType
from typing import Any, Generic, TypeVar

T = TypeVar("T")
R = TypeVar("R")

_TURN_S = 1e-4  # a tenth of the kernels that are called most


def worker_threads(n: int) -> ThreadPoolExecutor:
    """The process' pool of n threads. A job must not wait for another job of the same pool."""
    return _pool(n, os.getpid())


@cache
def _pool(n: int, process: int) -> ThreadPoolExecutor:
    # A forked process inherits the pool but not its threads: every process makes its own.
    return ThreadPoolExecutor(n, thread_name_prefix="mocap")


def in_parallel(job: Callable[[T], R], items: Sequence[T], n_threads: int) -> list[R]:
    """job(item) of every item, in their order, on up to n_threads threads, of which the caller's is one.

    The caller takes the next item like everybody else, so that it never waits for threads that are busy elsewhere.
    Raises what the first job that fails raises.
    """
    if n_threads <= 1 or len(items) <= 1:
        return [job(item) for item in items]
    found: list[Any] = [None] * len(items)
    failed: dict[int, BaseException] = {}
    coming = itertools.count()  # its next() is one step of the interpreter

    def work() -> None:
        while (k := next(coming)) < len(items) and not failed:
            try:
                found[k] = job(items[k])
            except BaseException as error:
                failed[k] = error

    others = [worker_threads(n_threads).submit(work) for _ in range(min(n_threads, len(items)) - 1)]
    work()
    for other in others:
        if not other.cancel():  # it has begun: perhaps it is at work on the last item
            other.result()
    if failed:
        raise failed[min(failed)]
    return found


@contextmanager
def quick_turns() -> Iterator[None]:
    """A thread that wants the interpreter inside gets it sooner than Python would give it.

    Compiled kernels run beside it and want it for moments: with Python's own 5 ms a frame's poses wait for it longer
    than they take.
    """
    before = sys.getswitchinterval()
    sys.setswitchinterval(min(before, _TURN_S))
    try:
        yield
    finally:
        sys.setswitchinterval(before)


class AtOnce(Executor):
    """No thread at all: a job is done when it is submitted."""

    def submit(self, fn: Callable[..., R], /, *args: Any, **kwargs: Any) -> Future[R]:
        done: Future[R] = Future()
        try:
            done.set_result(fn(*args, **kwargs))
        except Exception as error:
            done.set_exception(error)
        return done


class Ahead(Generic[T]):
    """The items of an iterator in their order, made on a thread of its own, at most n_items before they are taken.

    With one, the next item is begun when the last one is taken. An error is raised where the item would have been
    taken. Use as context manager: leaving it ends the thread.
    """

    def __init__(self, items: Iterator[T], n_items: int) -> None:
        self._items = items
        self._room = threading.Semaphore(n_items)
        self._made: queue.SimpleQueue[tuple[T] | BaseException] = queue.SimpleQueue()
        self._is_stopped = threading.Event()
        self._thread = threading.Thread(target=self._work, name="mocap-ahead", daemon=True)

    def __enter__(self) -> Ahead[T]:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._is_stopped.set()
        self._room.release()
        self._thread.join()

    def __iter__(self) -> Iterator[T]:
        return self

    def __next__(self) -> T:
        item = self._made.get()
        if isinstance(item, BaseException):
            raise item
        self._room.release()
        return item[0]

    def _work(self) -> None:
        try:
            while True:
                self._room.acquire()
                if self._is_stopped.is_set():
                    return
                self._made.put((next(self._items),))
        except Exception as error:
            # Not swallowed: who takes the items raises it in his own thread.
            self._made.put(error)
