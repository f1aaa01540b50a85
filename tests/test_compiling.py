"""Kernels that are compiled are counted and shown; their cache finds a folder that can be written."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from mocap import compiling
from mocap.compiling import COMPILING, compilation_shown, find_cache_folder
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


@pytest.mark.parametrize("given", [None, "chosen"])
def test_the_cache_finds_a_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, given: str | None) -> None:
    """Where neither the package nor the user's folder can be written, among temporary files; what is set stays."""
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    if given:
        monkeypatch.setenv("NUMBA_CACHE_DIR", given)
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    find_cache_folder()
    assert os.environ.get("NUMBA_CACHE_DIR") == given  # the package can be written here
    monkeypatch.setattr(compiling, "_is_writable", lambda folder: False)
    find_cache_folder()
    folder = Path(os.environ["NUMBA_CACHE_DIR"])
    if given:
        assert str(folder) == given
        return
    assert folder.parent == tmp_path
    assert folder.stat().st_mode & 0o077 == 0
    monkeypatch.delenv("NUMBA_CACHE_DIR")
    find_cache_folder()
    assert Path(os.environ["NUMBA_CACHE_DIR"]) == folder  # found again by the next command
