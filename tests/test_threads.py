"""Jobs on several threads: what they find, what they raise, and that nobody waits for threads that are busy."""

from __future__ import annotations

import sys
import threading

import pytest

from mocap.threads import in_parallel, quick_turns, worker_threads


@pytest.mark.parametrize("n_threads", [1, 2, 3])
@pytest.mark.parametrize("n_items", [0, 1, 2, 7])
def test_answers_come_in_the_order_of_the_items(n_threads: int, n_items: int) -> None:
    assert in_parallel(lambda k: k * k, list(range(n_items)), n_threads) == [k * k for k in range(n_items)]


@pytest.mark.parametrize("n_threads", [1, 2])
def test_the_first_job_that_fails_is_raised(n_threads: int) -> None:
    def job(k: int) -> int:
        if k in (2, 3):
            raise ValueError(f"job {k}")
        return k

    with pytest.raises(ValueError, match="job 2"):
        in_parallel(job, list(range(6)), n_threads)


def test_a_failure_is_raised_when_all_that_began_has_ended() -> None:
    begun, may_end, ended = threading.Event(), threading.Event(), []

    def job(k: int) -> None:
        if threading.current_thread() is threading.main_thread():
            assert begun.wait(10)
            threading.Timer(0.05, may_end.set).start()
            raise ValueError("in the caller")
        begun.set()
        assert may_end.wait(10)
        ended.append(k)

    with pytest.raises(ValueError, match="in the caller"):
        in_parallel(job, [0, 1], 2)
    assert len(ended) == 1


def test_the_caller_does_it_all_while_the_others_are_busy() -> None:
    free = threading.Event()
    busy = [worker_threads(2).submit(free.wait, 10) for _ in range(2)]
    try:
        done_by = in_parallel(lambda _: threading.current_thread(), [0, 1, 2], 2)
    finally:
        free.set()
    assert set(done_by) == {threading.current_thread()}
    assert all(wait.result() for wait in busy)


def test_turns_are_short_inside_alone() -> None:
    before = sys.getswitchinterval()
    with quick_turns():
        assert sys.getswitchinterval() < before
    assert sys.getswitchinterval() == before
