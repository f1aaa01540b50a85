"""A forked process beside this one: for work that keeps the interpreter busy, which threads would have to share."""

from __future__ import annotations

import mmap
import os
import signal
import sys
import warnings
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, suppress
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from threading import Thread
from typing import Any, TypeVar

import numpy as np
from numpy.typing import DTypeLike, NDArray

# A job, given a function that is told of every step that is done.
Job = Callable[[Callable[[int], None]], None]
Question = TypeVar("Question")
Answer = TypeVar("Answer")


def can_fork() -> bool:
    """Whether a process may be forked that goes on working: elsewhere than on Linux libraries do not allow for it."""
    return sys.platform.startswith("linux")


def shared_zeros(shape: tuple[int, ...], dtype: DTypeLike = np.float64) -> NDArray[Any]:
    """Zeros that this process and those forked from it later all read and write."""
    size = int(np.prod(shape)) * np.dtype(dtype).itemsize
    return np.frombuffer(mmap.mmap(-1, max(size, 1)), dtype, count=int(np.prod(shape))).reshape(shape)


@contextmanager
def forked(job: Job, tick: Callable[[int], None]) -> Iterator[None]:
    """Do a job in a process of its own while the body of the `with` statement runs in this one.

    All that is left of the job is what it has written into `shared_zeros`. tick : told here, by a thread, of every
    step that is done there. Leaving waits for the end. A job that fails there, whatever the reason, is done again here,
    so that its error is raised where it can be told.
    """
    reading, writing = os.pipe()
    process = _fork()
    if process == 0:
        _work(job, reading, writing)
    os.close(writing)
    listener = Thread(target=_listen, args=(reading, tick), name="mocap-fork", daemon=True)
    listener.start()
    try:
        yield
    except BaseException:
        os.kill(process, signal.SIGKILL)
        raise
    finally:
        listener.join()
        _, status = os.waitpid(process, 0)
    if status != 0:
        job(lambda n: None)


@contextmanager
def answering(
    serve: Callable[[], AbstractContextManager[Callable[[Question], Answer]]],
) -> Iterator[Callable[[Question], Answer]]:
    """A process of its own that answers questions, one after the other; gives what asks it, and waits for the answer.

    serve : gives there, before the first question, what answers; it is left when this is. What either raises there is
    raised here. Raises ChildProcessError when the process is gone.
    """
    here, there = Pipe()
    process = _fork()
    if process == 0:
        here.close()
        _serve(serve, there)
    there.close()

    def heard() -> Any:
        try:
            is_answer, value = here.recv()
        except (EOFError, OSError) as error:
            raise ChildProcessError("the forked process is gone") from error
        if not is_answer:
            raise value
        return value

    def ask(question: Question) -> Answer:
        with suppress(OSError):  # heard() says why
            here.send(question)
        answer: Answer = heard()
        return answer

    try:
        heard()  # it is ready
        yield ask
    finally:
        here.close()
        os.waitpid(process, 0)


def _serve(
    serve: Callable[[], AbstractContextManager[Callable[[Question], Answer]]], there: Connection
) -> None:
    """The whole life of a forked process that answers; it ends when nobody can ask any more."""
    # Ctrl-C is told to all processes of a terminal: this one ends with the one that asks.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    with suppress(BaseException), _told(there), serve() as answer:  # nobody is left to be told
        there.send((True, None))
        while True:
            question = there.recv()
            with _told(there):
                there.send((True, answer(question)))
    os._exit(0)


@contextmanager
def _told(there: Connection) -> Iterator[None]:
    """Send an error to who has asked; not that nobody is there to ask."""
    try:
        yield
    except (EOFError, OSError):
        raise
    except Exception as error:
        there.send((False, error))


def _fork() -> int:
    """`os.fork` of a process whose libraries have threads."""
    import cv2

    n = cv2.getNumThreads()
    # The child has none of the threads that OpenCV would wait for there.
    cv2.setNumThreads(1)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # Python warns of all threads, of idle ones too
        process = os.fork()
    if process:
        cv2.setNumThreads(n)
    return process


def _work(job: Job, reading: int, writing: int) -> None:
    """The whole life of a forked process. It ends with the one that it was forked from: nobody reads its steps then."""
    status = 1
    try:
        os.close(reading)
        job(lambda n: _tell(writing, n))
        status = 0
    finally:
        os._exit(status)


def _tell(writing: int, n_steps: int) -> None:
    os.write(writing, bytes(n_steps))


def _listen(reading: int, tick: Callable[[int], None]) -> None:
    while steps := os.read(reading, 4096):
        tick(len(steps))
    os.close(reading)
