"""A job in a forked process: what it leaves, what it tells, and what becomes of one that fails."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable

import cv2
import numpy as np
import pytest

from mocap.forks import can_fork, forked, shared_zeros

pytestmark = pytest.mark.skipif(not can_fork(), reason="processes are forked on Linux alone")
Tick = Callable[[int], None]


def test_both_work_at_once_on_shared_arrays() -> None:
    shared = shared_zeros((2, 3))
    told: list[int] = []

    def job(tick: Tick) -> None:
        shared[1] = os.getpid()
        while shared[0, 0] == 0.0:  # ends only if the other one works meanwhile
            time.sleep(0.001)
        tick(2)
        tick(3)

    with forked(job, told.append):
        shared[0] = os.getpid()
    assert np.all(shared[0] == os.getpid())
    assert np.all(shared[1] != os.getpid())
    assert np.all(shared[1] > 0)
    assert sum(told) == 5


def test_shared_zeros_are_zeros_of_their_kind() -> None:
    flags = shared_zeros((5, 0, 2), np.bool_)
    assert flags.shape == (5, 0, 2)
    assert flags.dtype == np.bool_
    counts = shared_zeros((3,), np.int32)
    assert counts.dtype == np.int32
    assert not counts.any()


def test_the_libraries_work_in_both() -> None:
    """OpenCV's own threads are none of a forked process: it would wait for them for ever."""
    rng = np.random.default_rng(0)
    picture = rng.integers(0, 255, (700, 900), dtype=np.uint8)
    expected = cv2.GaussianBlur(picture, (9, 9), 2.0)
    n_threads = cv2.getNumThreads()
    shared = shared_zeros(picture.shape, np.uint8)

    def job(tick: Tick) -> None:
        shared[:] = cv2.GaussianBlur(picture, (9, 9), 2.0)

    with forked(job, lambda n: None):
        here = cv2.GaussianBlur(picture, (9, 9), 2.0)
    np.testing.assert_array_equal(shared, expected)
    np.testing.assert_array_equal(here, expected)
    assert cv2.getNumThreads() == n_threads


def test_a_job_whose_process_is_killed_is_done_here() -> None:
    shared, here = shared_zeros((1,)), os.getpid()

    def job(tick: Tick) -> None:
        if os.getpid() != here:
            os.kill(os.getpid(), signal.SIGKILL)
        shared[0] = 7.0

    with forked(job, lambda n: None):
        pass
    assert shared[0] == 7.0


def test_the_error_of_a_job_is_raised_here() -> None:
    def job(tick: Tick) -> None:
        raise ValueError("frame 17")

    with pytest.raises(ValueError, match="frame 17"), forked(job, lambda n: None):
        pass


def test_an_error_here_ends_the_other_process() -> None:
    shared = shared_zeros((1,))

    def job(tick: Tick) -> None:
        shared[0] = os.getpid()
        time.sleep(60.0)

    def fail() -> None:
        with forked(job, lambda n: None):
            while shared[0] == 0.0:
                time.sleep(0.001)
            raise KeyError("mine")

    started = time.monotonic()
    with pytest.raises(KeyError, match="mine"):
        fail()
    assert time.monotonic() - started < 30.0
    with pytest.raises(ProcessLookupError):
        os.kill(int(shared[0]), 0)
