"""Differences between operating systems: memory, processes, signals, and files on the disk."""

from __future__ import annotations

import atexit
import os
import shutil
import signal
import sys
import tempfile
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO, Any

_BYTES_PER_MB = 2**20
# Windows locks bytes, not files; one far behind the end leaves the content readable.
_LOCKED_BYTE = 2**30
_SYNCING = 8  # files that are brought to the disk at once; more are no faster


def peak_memory_mb() -> float | None:
    """Largest resident memory of this process so far, MB; None where the system does not tell."""
    if sys.platform == "win32":
        return _peak_memory_of_windows_mb()
    try:
        import resource
    except ImportError:
        return None
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    # Linux counts kB, macOS bytes.
    return round(peak * (1 if sys.platform == "darwin" else 1024) / _BYTES_PER_MB, 1)


def limit_memory(n_bytes: int) -> None:
    """Let this process map no more than so many bytes; nothing where the system knows no such limit."""
    try:
        import resource
    except ImportError:
        return
    _, most = resource.getrlimit(resource.RLIMIT_AS)
    if most == resource.RLIM_INFINITY or n_bytes < most:
        # macOS knows the limit and refuses to set it.
        with suppress(OSError, ValueError):
            resource.setrlimit(resource.RLIMIT_AS, (n_bytes, most))


def memory_limit_bytes() -> int | None:
    """What this process may map at most, by `ulimit -v` or a batch system; None where there is no such limit."""
    try:
        import resource
    except ImportError:
        return None
    soft, _ = resource.getrlimit(resource.RLIMIT_AS)
    return None if soft == resource.RLIM_INFINITY else soft


class Stopped(BaseException):
    """A signal that ends the command; not an Exception, so that nobody on the way takes it for a failure."""

    def __init__(self, number: int) -> None:
        self.number = number
        super().__init__(signal.Signals(number).name)


@contextmanager
def stoppable() -> Iterator[None]:
    """Let Ctrl-C, a terminal that closes, and a batch system that wants its machine back raise `Stopped`.

    A second signal ends at once. What the caller's shell ignores, as `nohup` does, stays ignored.
    """
    known = (getattr(signal, name, None) for name in ("SIGINT", "SIGTERM", "SIGHUP"))
    numbers = [n for n in known if n is not None and signal.getsignal(n) != signal.SIG_IGN]

    def stop(number: int, frame: object) -> None:
        for other in numbers:
            signal.signal(other, signal.SIG_DFL)
        raise Stopped(number)

    before = {number: signal.signal(number, stop) for number in numbers}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def total_memory_bytes() -> int | None:
    """Memory of this machine; None where the system does not tell."""
    if sys.platform == "win32":
        return None
    try:
        return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    except (OSError, ValueError):
        return None


def kernel_cache_dir() -> Path | None:
    """Where compiled kernels are kept from run to run; None where no folder for them may be written."""
    named = os.environ.get("NUMBA_CACHE_DIR")
    package = Path(__file__).resolve().parent
    # In this order numba looks for a place: what is named, beside the source, the user's.
    for place in (Path(named),) if named else (package, _user_cache_dir()):
        if _may_be_written(place):
            return place
    return None


def find_kernel_cache() -> None:
    """Let kernels be compiled where nothing may be kept, into a private folder that goes with this process."""
    if kernel_cache_dir() is None:
        place = tempfile.mkdtemp(prefix="mocap-kernels-")
        os.environ["NUMBA_CACHE_DIR"] = place
        atexit.register(shutil.rmtree, place, ignore_errors=True)


@contextmanager
def utf8_name(path: Path) -> Iterator[str]:
    """The name of a file, or of one that is to be written, for a library that takes names to be UTF-8, as OpenCV does:
    of others it does not find the file, or ends the process.

    Where a name is written otherwise (ASCII and Latin locales, folders out of old archives) it is a link, which may go
    as soon as the file is open.
    """
    if sys.platform == "win32" or os.fsencode(path) == str(path).encode("utf-8", "replace"):
        yield str(path)
        return
    with tempfile.TemporaryDirectory(prefix="mocap-") as folder:
        link = Path(folder) / ("file" + path.suffix if path.suffix.isascii() else "file")
        link.symlink_to(path.resolve())
        yield str(link)


def _user_cache_dir() -> Path:
    if sys.platform == "win32":
        return Path(os.environ.get("LOCALAPPDATA", str(Path.home())))
    if sys.platform == "darwin":
        return Path.home() / "Library" / "Caches"
    return Path(os.environ.get("XDG_CACHE_HOME", str(Path.home() / ".cache")))


def _may_be_written(folder: Path) -> bool:
    """Whether a folder, or the nearest above it that is there, may be written."""
    while not folder.exists() and folder != folder.parent:
        folder = folder.parent
    return folder.is_dir() and os.access(folder, os.W_OK | os.X_OK)


def is_running(pid: int) -> bool:
    """Whether a process of this machine is there; True where that cannot be asked."""
    if sys.platform == "win32":
        return True  # os.kill would end it
    try:
        os.kill(pid, 0)
    except (ProcessLookupError, OverflowError):
        return False
    except OSError:
        return True  # somebody else's
    return True


def sync_tree(folder: Path) -> None:
    """Bring all files of a folder, and their names, from memory to the disk: a power cut does not undo them then.

    Many at once, for a disk writes what several wait for in one go: 340 files take .06 s instead of 1 s.
    """
    with ThreadPoolExecutor(_SYNCING) as threads:
        list(threads.map(_sync, [*folder.rglob("*"), folder]))


def _sync(path: Path) -> None:
    if path.is_file():
        with path.open("rb+") as stream:  # Windows syncs only what may be written
            os.fsync(stream.fileno())
    else:
        sync_folder(path)


def sync_folder(folder: Path) -> None:
    """Bring the names in a folder to the disk; Windows does that by itself."""
    if sys.platform == "win32":
        return
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def lock_file(stream: IO[Any]) -> bool | None:
    """Lock an open file for this process alone: False when another process holds it, None where there are no locks.

    The lock goes with the process, however it ends.
    """
    if sys.platform == "win32":
        return _lock_file_of_windows(stream)
    try:
        import fcntl
    except ImportError:
        return None
    try:
        fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:
        return None  # such as some network file systems
    return True


if sys.platform == "win32":

    def _lock_file_of_windows(stream: IO[Any]) -> bool:
        import msvcrt

        place = stream.tell()
        stream.seek(_LOCKED_BYTE)
        try:
            msvcrt.locking(stream.fileno(), msvcrt.LK_NBLCK, 1)
        except OSError:
            return False
        finally:
            stream.seek(place)
        return True

    def _peak_memory_of_windows_mb() -> float | None:
        import ctypes
        from ctypes import wintypes

        class Counters(ctypes.Structure):
            """PROCESS_MEMORY_COUNTERS of psapi.h."""

            _fields_ = [
                ("cb", wintypes.DWORD),
                ("PageFaultCount", wintypes.DWORD),
                *(
                    (name, ctypes.c_size_t)
                    for name in (
                        "PeakWorkingSetSize",
                        "WorkingSetSize",
                        "QuotaPeakPagedPoolUsage",
                        "QuotaPagedPoolUsage",
                        "QuotaPeakNonPagedPoolUsage",
                        "QuotaNonPagedPoolUsage",
                        "PagefileUsage",
                        "PeakPagefileUsage",
                    )
                ),
            ]

        counters = Counters()
        counters.cb = ctypes.sizeof(counters)
        process = ctypes.windll.kernel32.GetCurrentProcess
        process.restype = wintypes.HANDLE
        info = ctypes.windll.psapi.GetProcessMemoryInfo
        info.argtypes = [wintypes.HANDLE, ctypes.POINTER(Counters), wintypes.DWORD]
        if not info(process(), ctypes.byref(counters), counters.cb):
            return None
        return round(counters.PeakWorkingSetSize / _BYTES_PER_MB, 1)
