"""Threads that are kept: starting one costs more than many of the jobs."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from typing import TypeVar

T = TypeVar("T")
R = TypeVar("R")


def worker_threads(n: int) -> ThreadPoolExecutor:
    """The process' pool of n threads. A job must not wait for another job of the same pool."""
    return _pool(n, os.getpid())


@cache
def _pool(n: int, process: int) -> ThreadPoolExecutor:
    # A forked process inherits the pool but not its threads: every process makes its own.
    return ThreadPoolExecutor(n, thread_name_prefix="mocap")


def in_parallel(job: Callable[[T], R], items: Sequence[T], n_threads: int) -> list[R]:
    """job(item) of every item, in their order, on up to n_threads threads.

    Raises what the first job that fails raises.
    """
    if n_threads <= 1 or len(items) <= 1:
        return [job(item) for item in items]
    return list(worker_threads(n_threads).map(job, items))
