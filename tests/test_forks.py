"""A job in a forked process: what it leaves, what it tells, and what becomes of one that fails."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import cv2
import numpy as np
import pytest

from mocap.errors import MocapError
from mocap.forks import answering, begun, can_fork, forked, given, in_processes, shared_zeros

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


def test_a_job_is_begun_before_its_result_is_waited_for() -> None:
    is_done, here = shared_zeros((1,)), os.getpid()

    def job() -> tuple[str, int]:
        is_done[0] = 1.0
        return "found", os.getpid()

    with begun(job, 2) as result:
        while not is_done[0]:  # ends only if the job is done meanwhile
            time.sleep(0.001)
        found, process = result()
    assert found == "found"
    assert process != here
    with pytest.raises(ProcessLookupError):
        os.kill(process, 0)


def test_with_one_process_a_job_is_done_when_it_is_waited_for() -> None:
    done = []
    with begun(lambda: done.append(os.getpid()) or 7, 1) as result:  # type: ignore[func-returns-value]
        assert done == []
        assert result() == 7
    assert done == [os.getpid()]


def test_a_begun_job_whose_process_is_killed_is_done_here() -> None:
    here = os.getpid()

    def job() -> int:
        if os.getpid() != here:
            os.kill(os.getpid(), signal.SIGKILL)
        return os.getpid()

    with begun(job, 2) as result:
        assert result() == here


def test_the_error_of_a_begun_job_is_raised_where_it_is_waited_for() -> None:
    def job() -> None:
        raise MocapError("no report", remedy="another")

    with begun(job, 2) as result:
        time.sleep(0.01)
        with pytest.raises(MocapError, match="no report"):
            result()


def test_several_processes_work_at_once_and_results_have_the_order_of_the_items() -> None:
    begun = shared_zeros((3,))

    def job(k: int) -> tuple[int, int]:
        begun[min(k, 2)] = 1.0
        while not begun.all():  # ends only if three of them work at once
            time.sleep(0.001)
        return 10 * k, os.getpid()

    found = in_processes(job, [0, 1, 2, 3, 4], 3)
    assert [value for value, _ in found] == [0, 10, 20, 30, 40]
    by = [process for _, process in found]
    assert len(set(by)) == len(set(by[:3])) == 3
    assert os.getpid() in by
    for process in set(by) - {os.getpid()}:
        with pytest.raises(ProcessLookupError):
            os.kill(process, 0)


@pytest.mark.parametrize(("n_items", "n_processes"), [(0, 3), (1, 3), (4, 1)])
def test_nothing_is_forked_for_one_process(n_items: int, n_processes: int) -> None:
    found = in_processes(lambda k: (k, os.getpid()), range(n_items), n_processes)
    assert found == [(k, os.getpid()) for k in range(n_items)]


def test_no_more_processes_than_items(monkeypatch: pytest.MonkeyPatch) -> None:
    forks = []
    fork = os.fork
    monkeypatch.setattr(os, "fork", lambda: forks.append(1) or fork())  # type: ignore[func-returns-value]
    assert in_processes(lambda k: k, range(3), 7) == [0, 1, 2]
    assert len(forks) == 2


def test_what_a_killed_process_was_at_is_done_here() -> None:
    here, killed = os.getpid(), shared_zeros((1,))

    def job(k: int) -> tuple[int, int]:
        while os.getpid() == here and not killed[0]:
            time.sleep(0.001)
        if os.getpid() != here:
            killed[0] = k
            os.kill(os.getpid(), signal.SIGKILL)
        return k, os.getpid()

    assert in_processes(job, [1, 2, 3, 4], 2) == [(k, here) for k in (1, 2, 3, 4)]
    assert killed[0]


@pytest.mark.parametrize("is_here", [False, True])
def test_an_error_of_one_item_is_raised_and_nobody_begins_another(is_here: bool) -> None:
    here, n_begun = os.getpid(), shared_zeros((100,))

    def job(k: int) -> None:
        n_begun[k] = 1.0
        if (os.getpid() == here) == is_here:
            raise MocapError("no pose", remedy="another", frame=k)
        time.sleep(0.02)

    with pytest.raises(MocapError, match="no pose"):
        in_processes(job, range(100), 2)
    assert n_begun.sum() < 50


def test_what_cannot_be_sent_is_said() -> None:
    """And not made again here, where nobody would notice that it was made in vain."""
    here = os.getpid()

    def job(k: int) -> object:
        time.sleep(0.02)
        return k if os.getpid() == here else (lambda: k)

    with pytest.raises((AttributeError, TypeError), match="pickle"):
        in_processes(job, range(10), 2)


@contextmanager
def counting() -> Iterator[Callable[[object], tuple[int, int, object]]]:
    """Answers with the process, how many questions there were, and the question."""
    n = 0

    def answer(question: object) -> tuple[int, int, object]:
        nonlocal n
        n += 1
        if isinstance(question, str) and question == "mistake":
            raise MocapError("not this", remedy="another", frame=7)
        if isinstance(question, str) and question == "disk":
            raise OSError(5, "broken")
        if isinstance(question, str) and question == "die":
            os.kill(os.getpid(), signal.SIGKILL)
        return os.getpid(), n, question

    yield answer


def test_questions_are_answered_in_order_by_a_process_that_remembers() -> None:
    with answering(counting) as ask:
        array = np.arange(200_000.0)
        process, n, echo = ask(array)
        assert n == 1
        np.testing.assert_array_equal(echo, array)
        assert process != os.getpid()
        assert [ask(k) for k in "abc"] == [(process, 2, "a"), (process, 3, "b"), (process, 4, "c")]
    with pytest.raises(ProcessLookupError):
        os.kill(process, 0)


def test_what_an_answer_raises_is_raised_here_and_others_are_answered() -> None:
    with answering(counting) as ask:
        with pytest.raises(MocapError, match="not this") as told:
            ask("mistake")
        assert told.value.frame == 7
        with pytest.raises(OSError, match="broken"):  # not that of the pipe
            ask("disk")
        assert ask("next")[1:] == (3, "next")


def test_who_cannot_begin_says_so_at_once() -> None:
    @contextmanager
    def unable() -> Iterator[Callable[[object], object]]:
        raise MocapError("no room", remedy="a larger one")
        yield lambda question: question

    with pytest.raises(MocapError, match="no room"), answering(unable):
        pytest.fail("it has begun")


def test_a_process_that_is_gone_is_told() -> None:
    with answering(counting) as ask:
        with pytest.raises(ChildProcessError):
            ask("die")
        with pytest.raises(ChildProcessError):
            ask("anybody there?")


def test_what_answers_is_left_at_the_end(tmp_path: Path) -> None:
    left = tmp_path / "left"

    @contextmanager
    def noting() -> Iterator[Callable[[object], object]]:
        try:
            yield lambda question: question
        finally:
            left.touch()

    with answering(noting) as ask:
        assert ask(3) == 3
        assert not left.exists()
    assert left.exists()


@pytest.mark.parametrize("n_ahead", [0, 1, 3])
def test_items_come_in_order_from_a_process_that_is_so_many_ahead(n_ahead: int, tmp_path: Path) -> None:
    begun_there, left = shared_zeros((1,)), tmp_path / "left"

    @contextmanager
    def items() -> Iterator[Iterator[tuple[int, int, np.ndarray]]]:
        def made() -> Iterator[tuple[int, int, np.ndarray]]:
            for k in range(1000):
                begun_there[0] = k + 1
                yield os.getpid(), k, np.full(100_000, k)

        try:
            yield made()
        finally:
            left.touch()

    with given(items, n_ahead) as coming:
        for k in range(5):
            process, n, array = next(coming)
            assert (n, array[0], array[-1]) == (k, k, k)
            assert process != os.getpid()
        time.sleep(0.3)
        assert begun_there[0] == 5 + n_ahead
    assert left.exists()
    with pytest.raises(ProcessLookupError):
        os.kill(process, 0)


def test_what_an_item_raises_is_raised_where_it_would_have_been_taken() -> None:
    @contextmanager
    def items() -> Iterator[Iterator[int]]:
        def made() -> Iterator[int]:
            yield 1
            raise MocapError("no picture", remedy="another", frame=7)

        yield made()

    with given(items, 2) as coming:
        assert next(coming) == 1
        with pytest.raises(MocapError, match="no picture"):
            next(coming)


def test_it_ignores_ctrl_c_and_ends_with_who_asks() -> None:
    with answering(counting) as ask:
        process, _, _ = ask("who?")
        os.kill(process, signal.SIGINT)
        assert ask("still there?") == (process, 2, "still there?")


@pytest.mark.parametrize("is_ignored", [False, True])
def test_it_has_no_handler_of_the_one_that_it_is_forked_from(is_ignored: bool) -> None:
    """Which would clean up what is not its own. What the shell ignores, as for `nohup`, stays ignored."""

    @contextmanager
    def telling() -> Iterator[Callable[[int], object]]:
        yield lambda number: (signal.getsignal(number), signal.pthread_sigmask(signal.SIG_BLOCK, []))

    def stop(number: int, frame: object) -> None:
        raise AssertionError

    before = signal.signal(signal.SIGHUP, signal.SIG_IGN if is_ignored else stop)
    try:
        with answering(telling) as ask:
            assert ask(signal.SIGHUP) == (signal.SIG_IGN if is_ignored else signal.SIG_DFL, set())
            assert ask(signal.SIGINT) == (signal.SIG_IGN, set())
    finally:
        signal.signal(signal.SIGHUP, before)


_TOLD_TO_END_WHILE_FORKING = """
import logging, os, signal, threading
from contextlib import contextmanager
from mocap.forks import answering
from mocap.portable import Stopped, stoppable

@contextmanager
def serve():
    yield lambda question: question

threading.Thread(target=threading.Event().wait, daemon=True).start()  # signals reach a process by any of its threads
signal.signal(signal.SIGTERM, signal.SIG_DFL)
os.register_at_fork(before=lambda: os.kill(os.getpid(), signal.SIGTERM))
try:
    with stoppable(), answering(serve):
        print("went on")
except Stopped as error:
    print("stopped by", error)
print("lock is free:", logging._lock.acquire(blocking=False))
try:
    os.waitpid(-1, os.WNOHANG)
except ChildProcessError:
    print("nobody is left")
"""


def test_a_signal_that_comes_while_forking_is_not_lost() -> None:
    """Hooks of `os.fork` lose what handlers raise in them: the run went on, and waited for a lock for ever."""
    said = subprocess.run(
        [sys.executable, "-c", _TOLD_TO_END_WHILE_FORKING],
        capture_output=True,
        text=True,
        timeout=60,
        check=True,
    )
    assert said.stdout.splitlines() == ["stopped by SIGTERM", "lock is free: True", "nobody is left"]
    assert "Exception ignored" not in said.stderr


@contextmanager
def drawing() -> Iterator[Callable[[int], list[np.ndarray]]]:
    """Answers with pictures of the number that it is asked for, of which some are large, and one lies across."""

    def answer(n: int) -> list[np.ndarray]:
        large = np.full((300, 400), n, dtype=np.uint16)
        return [large, np.arange(n, n + 5), np.asfortranarray(large[:200]), large[::2, ::2], large > 0]

    yield answer


def test_large_arrays_come_as_they_are_and_stay_while_somebody_looks() -> None:
    """More answers than there are places: none is written over while a part of it is in use."""
    with answering(drawing) as ask:
        parts = [ask(n)[0][10:20, 3] for n in range(1, 12)]
        whole = ask(20)
        for n, part in enumerate(parts, 1):
            assert np.all(part == n)
        for found, expected in zip(whole, next(_drawn(20)), strict=True):
            np.testing.assert_array_equal(found, expected)
            assert found.dtype == expected.dtype
            assert found.flags.writeable
        assert whole[2].flags.f_contiguous
        del parts
        assert all(np.all(ask(n)[0] == n) for n in range(30, 50))
    assert np.all(whole[0] == 20)


def _drawn(n: int) -> Iterator[list[np.ndarray]]:
    with drawing() as answer:
        yield answer(n)
