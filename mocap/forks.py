"""A forked process beside this one: for work that keeps the interpreter busy, which threads would have to share."""

from __future__ import annotations

import mmap
import os
import signal
import sys
import warnings
import weakref
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import AbstractContextManager, ExitStack, contextmanager, nullcontext, suppress
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from multiprocessing.reduction import register
from threading import Thread, current_thread, main_thread
from typing import Any, TypeVar, cast

import numpy as np
from numpy.typing import DTypeLike, NDArray

# A job, given a function that is told of every step that is done.
Job = Callable[[Callable[[int], None]], None]
T = TypeVar("T")
R = TypeVar("R")
Question = TypeVar("Question")
Answer = TypeVar("Answer")

# Answers whose large arrays may lie on a shelf at once, and room for those of one, of which only what is used is ever
# taken: three masks of each of sixteen cameras of 640 x 480 are 15 MB. What finds no room goes through the pipe.
_PLACES, _PLACE_BYTES = 5, 1 << 25
_LARGE_BYTES = 1 << 16  # of an array that is worth a place
_LINE_BYTES = 64  # of the cache: where arrays begin


def can_fork() -> bool:
    """Whether a process may be forked that goes on working: elsewhere than on Linux libraries do not allow for it, and
    nor does CUDA once this process has opened a device (`likelihood.voxels.device`)."""
    return sys.platform.startswith("linux") and "numba.cuda" not in sys.modules


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
    raised here. Large arrays of answers lie in memory that both share, until nobody looks at them here any more. Raises
    ChildProcessError when the process is gone.
    """
    with _served(serve) as (tell, heard):

        def ask(question: Question) -> Answer:
            tell(question)
            return heard()

        yield ask


@contextmanager
def given(
    items: Callable[[], AbstractContextManager[Iterator[Answer]]], n_ahead: int
) -> Iterator[Iterator[Answer]]:
    """What a process of its own gives, item by item; it has begun that many when the next one is waited for.

    items : begins them there, and is left when this is; they do not end by themselves. For errors, and where large
    arrays lie, see `answering`, which has nothing to do between an answer and the next question.
    """

    @contextmanager
    def serve() -> Iterator[Callable[[None], Answer]]:
        with items() as coming:
            yield lambda _: next(coming)

    with _served(serve) as (tell, heard):
        for _ in range(n_ahead):
            tell(None)

        def taken() -> Iterator[Answer]:
            while True:
                tell(None)
                yield heard()

        yield taken()


@contextmanager
def begun(job: Callable[[], R], n_processes: int) -> Iterator[Callable[[], R]]:
    """A job that a forked process does while the body of the `with` statement runs in this one; gives what waits for
    the result, which must be something that can be sent.

    With one process, where none can be forked, or when it is killed, the job is done when it is waited for. Leaving
    waits for the end.
    """
    if n_processes < 2 or not can_fork():
        yield job
        return
    with _served(lambda: nullcontext(lambda _: job())) as (tell, heard):
        tell(None)

        def result() -> R:
            try:
                return heard()
            except ChildProcessError:
                return job()

        yield result


@contextmanager
def _served(
    serve: Callable[[], AbstractContextManager[Callable[[Question], Answer]]],
) -> Iterator[tuple[Callable[[Question], None], Callable[[], Answer]]]:
    """`answering`, with what tells the process a question and what waits for the answer apart from each other."""
    here, there = Pipe()
    shelf = _Shelf()
    process = _fork()
    if process == 0:
        here.close()
        register(np.ndarray, shelf.put)
        _serve(serve, there, shelf)
    there.close()

    def tell(question: Question) -> None:
        with suppress(OSError):  # heard() says why
            here.send(question)

    def heard() -> Any:
        try:
            is_answer, value = here.recv()
        except (EOFError, OSError) as error:
            raise ChildProcessError("the forked process is gone") from error
        if not is_answer:
            raise value
        return value

    try:
        heard()  # it is ready
        yield tell, heard
    finally:
        here.close()
        os.waitpid(process, 0)


def in_processes(job: Callable[[T], R], items: Sequence[T], n_processes: int) -> list[R]:
    """job(item) of every item, in their order, by up to n_processes processes, of which this one is one.

    All that is left of a job is what it gives, which must be something that can be sent. Who is free takes the next
    item; what a process was at that is killed is done here. Raises what a job raises. With one process, or where none
    can be forked, the jobs are done in turn. Call it where no other thread is at work: what that holds while processes
    are forked, a lock for instance, nobody there releases.
    """
    n_others = min(n_processes, len(items)) - 1
    if n_others < 1 or not can_fork():
        return [job(item) for item in items]
    coming = iter(range(len(items)))  # its next() is one step of the interpreter

    def here(k: int) -> R:
        return job(items[k])

    def found_by(worker: Callable[[int], R]) -> dict[int, R]:
        found = {}
        try:
            for k in coming:
                found[k] = worker(k)
        except ChildProcessError:
            pass  # what it was at is done below
        except BaseException:
            list(coming)  # nobody begins another one
            raise
        return found

    with ExitStack() as stack:
        others = [stack.enter_context(answering(lambda: nullcontext(here))) for _ in range(n_others)]
        # Its threads have heard the last answer before the processes are left.
        threads = stack.enter_context(ThreadPoolExecutor(n_others))
        parts = [threads.submit(found_by, ask) for ask in others]
        found = found_by(here)
        for part in parts:
            found |= part.result()
    return [found[k] if k in found else job(items[k]) for k in range(len(items))]


class _Shelf:
    """Memory in which one process puts large arrays, and another looks at them where they lie.

    It has some places. The arrays of one answer lie in one; it is free when the last of them is gone.
    """

    def __init__(self) -> None:
        _SHELVES[id(self)] = self
        self._rooms = [shared_zeros((_PLACE_BYTES,), np.uint8) for _ in range(_PLACES)]
        self._is_taken = shared_zeros((_PLACES,), np.bool_)
        self._place, self._end = -1, 0  # of the answer that is put together
        self._watched: dict[int, weakref.ref[NDArray[Any]]] = {}

    def next_answer(self) -> None:
        """What is put from now on belongs to another answer."""
        free = np.flatnonzero(~self._is_taken)
        self._place, self._end = (int(free[0]) if len(free) else -1), 0

    def put(self, array: NDArray[Any]) -> Any:
        """How an array is sent: as where it lies, if it is large and there is room."""
        begin = -(-self._end // _LINE_BYTES) * _LINE_BYTES
        end = begin + array.nbytes
        is_fit = array.flags.c_contiguous and array.nbytes >= _LARGE_BYTES and end <= _PLACE_BYTES
        if self._place < 0 or not is_fit or array.dtype.hasobject:
            return array.__reduce__()
        self._rooms[self._place][begin:end] = array.reshape(-1).view(np.uint8)
        self._is_taken[self._place], self._end = True, end
        return _lying, (id(self), self._place, begin, array.shape, array.dtype)

    def look(self, place: int, begin: int, shape: tuple[int, ...], dtype: np.dtype[Any]) -> NDArray[Any]:
        """An array that lies there."""
        watched = self._watched.get(place)
        room = None if watched is None else watched()
        if room is None:
            # Through a buffer: otherwise views of it would hold the memory, but not this array, which is watched.
            room = np.frombuffer(self._rooms[place].data, np.uint8)
            self._watched[place] = weakref.ref(room, lambda _: self._free(place))
        return np.ndarray(shape, dtype, buffer=room, offset=begin)

    def _free(self, place: int) -> None:
        self._is_taken[place] = False


_SHELVES: weakref.WeakValueDictionary[int, _Shelf] = weakref.WeakValueDictionary()


def _lying(shelf: int, *where: Any) -> NDArray[Any]:
    """An array on a shelf; a forked process calls it as this one does."""
    return _SHELVES[shelf].look(*where)


def _serve(
    serve: Callable[[], AbstractContextManager[Callable[[Question], Answer]]],
    there: Connection,
    shelf: _Shelf,
) -> None:
    """The whole life of a forked process that answers; it ends when nobody can ask any more."""
    with suppress(BaseException), _told(there), serve() as answer:  # nobody is left to be told
        there.send((True, None))
        while True:
            question = there.recv()
            with _told(there):
                found = answer(question)
                shelf.next_answer()
                there.send((True, found))
    os._exit(0)


@contextmanager
def _told(there: Connection) -> Iterator[None]:
    """Send an error to who has asked; that fails where nobody is there to ask."""
    try:
        yield
    except Exception as error:
        there.send((False, error))


# What ends a command. Ctrl-C is told to all processes of a terminal, and a forked one ends with the one that asks.
_ENDING = {
    number: handler
    for name, handler in (("SIGINT", signal.SIG_IGN), ("SIGTERM", signal.SIG_DFL), ("SIGHUP", signal.SIG_DFL))
    if (number := getattr(signal, name, None)) is not None
}


def _fork() -> int:
    """`os.fork` of a process whose libraries have threads, and who may be told to end at any time.

    What a handler raises inside a hook of `os.fork` is lost, and with it the lock of `logging` that the hook was to
    release: handlers wait until the process is there. In the new process signals wait until it has handlers of its own;
    with those of this one it would do what only this one may, clean up for instance.
    """
    import cv2

    n = cv2.getNumThreads()
    # The child has none of the threads that OpenCV would wait for there.
    cv2.setNumThreads(1)
    came: list[int] = []
    before = {number: signal.getsignal(number) for number in _ENDING}
    # Handlers of Python run in the main thread alone: another one that forks has none to wait for.
    is_main = current_thread() is main_thread()
    waiting = [number for number, handler in before.items() if is_main and callable(handler)]
    for number in waiting:
        signal.signal(number, lambda number, frame: came.append(number))
    blocked = signal.pthread_sigmask(signal.SIG_BLOCK, _ENDING)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # Python warns of all threads, of idle ones too
        process = os.fork()
    if process == 0:
        for number, handler in _ENDING.items():
            if before[number] != signal.SIG_IGN:  # as `nohup` has it
                signal.signal(number, handler)
        signal.pthread_sigmask(signal.SIG_SETMASK, blocked)
        return 0
    cv2.setNumThreads(n)
    try:
        signal.pthread_sigmask(signal.SIG_SETMASK, blocked)
        for number in waiting:
            signal.signal(number, before[number])
        for number in came:
            cast(Callable[[int, None], None], before[number])(number, None)
    except BaseException:
        os.kill(process, signal.SIGKILL)  # nobody else knows of it yet
        os.waitpid(process, 0)
        raise
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
