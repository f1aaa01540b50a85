"""Compiled kernels that are out of date: numba looks at the file that a kernel is in, and not at those that the kernel
takes other kernels and constants from."""

from __future__ import annotations

from contextlib import suppress
from functools import cache
from pathlib import Path

from mocap.pipeline.reach import ROOT, all_from, file_of, imported_by


def forget_stale_kernels() -> int:
    """Delete what numba has kept, beside the package, of kernels that are made of a file which was changed since.

    Without it sources that are updated by git, or worked on, would go on running the old code of what they call. What
    cannot be deleted stays. Returns how many kernels are forgotten.
    """
    n = 0
    for index in ROOT.rglob("*.nbi"):
        with suppress(OSError):
            if index.stat().st_mtime < _changed(_module_of(index)):
                index.unlink()
                n += 1
    return n


def _module_of(index: Path) -> str:
    """The module of a kernel: ROOT/a/b/__pycache__/_kernels.name-12.py311.nbi is of mocap.a.b._kernels."""
    folder = index.parent.parent.relative_to(ROOT.parent)
    return ".".join((*folder.parts, index.name.split(".")[0]))


def _changed(module: str) -> float:
    """When any of the files that the kernels of a module are made of was changed last."""
    files = (file_of(name) for name in _made_of(module))
    return max((path.stat().st_mtime for path in files if path is not None), default=0.0)


@cache
def _made_of(module: str) -> frozenset[str]:
    """A module of kernels, those that it takes kernels from, and theirs; of other modules constants, and no more."""
    return all_from(module, lambda name: imported_by(name) if name.endswith("kernels") else ())
