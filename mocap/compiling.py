"""Kernels are compiled by numba when they are first called, once after installation; that is counted and shown here."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from mocap.progress import Progress

COMPILING = "compiling"
"""What the progress of compilation is called."""
N_KERNELS = 172
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
