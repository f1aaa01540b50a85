"""Kernels are compiled by numba when they are first called, once after installation; that is counted and shown here."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from mocap.progress import Progress

COMPILING = "compiling"
"""What the progress of compilation is called."""
N_KERNELS = 122
"""Functions of this package that a run with the preset `default` compiles; `mocap warm-up` prints how many it were."""


@dataclass
class CompiledKernels:
    """n : kernels of this package that were compiled so far."""

    n: int = 0


@contextmanager
def compilation_shown(progress: Progress) -> Iterator[CompiledKernels]:
    """Tell `progress` of every kernel that is compiled inside, as one of about N_KERNELS, and of the end.

    Kernels that come out of numba's cache are not compiled and say nothing.
    """
    from numba.core import event

    compiled = CompiledKernels()

    class Listener(event.Listener):  # type: ignore[misc]
        def on_start(self, happened: Any) -> None:
            """numba has begun to compile a function."""

        def on_end(self, happened: Any) -> None:
            """numba has compiled a function, perhaps one of its own."""
            if happened.data["dispatcher"].py_func.__module__.startswith("mocap."):
                compiled.n += 1
                progress(COMPILING, compiled.n, max(N_KERNELS, compiled.n + 1))

    listener = Listener()
    event.register("numba:compile", listener)
    try:
        yield compiled
    finally:
        event.unregister("numba:compile", listener)
        if compiled.n:
            progress(COMPILING, compiled.n, compiled.n)


def find_cache_folder() -> None:
    """Give numba a folder where what it compiles can be kept, before it is imported.

    It keeps compiled kernels beside the source or in the user's cache folder. Where neither can be written it fails;
    then they go to a folder of this user among the temporary files, which the next command finds again.
    """
    if os.environ.get("NUMBA_CACHE_DIR") or _is_writable(Path(__file__).parent) or _is_writable(Path.home()):
        return
    import tempfile

    user = getattr(os, "getuid", lambda: os.environ.get("USERNAME", "user"))()
    folder = Path(tempfile.gettempdir()) / f"mocap-kernels-{user}"
    with suppress(OSError):
        folder.mkdir(mode=0o700, exist_ok=True)
        # What lies there is executed: a folder that somebody else has put there is none of ours.
        if not hasattr(os, "getuid") or folder.stat().st_uid == os.getuid():
            os.environ["NUMBA_CACHE_DIR"] = str(folder)
            return
    os.environ["NUMBA_CACHE_DIR"] = tempfile.mkdtemp(prefix="mocap-kernels-")


def _is_writable(folder: Path) -> bool:
    return folder.is_dir() and os.access(folder, os.W_OK)
