"""Kernels that are compiled are counted and shown."""

from __future__ import annotations

from mocap import compiling
from mocap.compiling import COMPILING, compilation_shown
from mocap.progress import no_progress


def test_compiled_kernels_are_counted_and_others_are_not() -> None:
    from numba import njit

    def double(x: float) -> float:
        return 2.0 * x

    ours, others = njit(double), njit(double)
    said: list[tuple[str, int, int]] = []
    with compilation_shown(lambda *what: said.append(what)) as compiled:
        others(1.0)
        assert compiled.n == 0
        ours.py_func.__module__ = "mocap.toy"
        ours(1.0)
        ours(2.0)
        assert compiled.n == 1
    assert said == [(COMPILING, 1, compiling.N_KERNELS), (COMPILING, 1, 1)]
    with compilation_shown(no_progress) as compiled:
        ours(3.0)
    assert compiled.n == 0
