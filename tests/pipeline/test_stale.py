"""Kernels that numba has kept are forgotten when what they are made of has changed, and no others."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

# The kernels of the first take some from those of the second; nothing else of the package is compiled into both.
CALLER, CALLED, OTHER = (
    "mocap/likelihood/residuals/_descent_kernels.py",
    "mocap/likelihood/residuals/_outline_kernels.py",
    "mocap/foreground/_kernels.py",
)


@pytest.fixture
def package(tmp_path: Path) -> Path:
    """A copy of the sources, all of them old, with an index of a kernel of three modules that is younger."""
    root = Path(__file__).parents[2]
    for source in (root / "mocap").rglob("*.py"):
        copy = tmp_path / source.relative_to(root)
        copy.parent.mkdir(parents=True, exist_ok=True)
        copy.write_bytes(source.read_bytes())
        os.utime(copy, (1000, 1000))
    for source in (CALLER, CALLED, OTHER):
        index = _index(tmp_path / source)
        index.parent.mkdir(exist_ok=True)
        index.write_bytes(b"")
        os.utime(index, (2000, 2000))
    return tmp_path


def _index(source: Path) -> Path:
    return source.parent / "__pycache__" / f"{source.stem}.kernel-1.py311.nbi"


def _kept(package: Path) -> list[bool]:
    """Whether the three are there afterwards."""
    code = "from mocap.pipeline.stale import forget_stale_kernels; print(forget_stale_kernels())"
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=package, check=True, capture_output=True, text=True
    )
    kept = [_index(package / source).exists() for source in (CALLER, CALLED, OTHER)]
    assert int(done.stdout) == kept.count(False)
    return kept


def test_nothing_is_forgotten_while_nothing_has_changed(package: Path) -> None:
    assert _kept(package) == [True, True, True]


def test_a_changed_kernel_takes_those_that_call_it_with_it(package: Path) -> None:
    os.utime(package / CALLED, (3000, 3000))
    assert _kept(package) == [False, False, True]


def test_a_caller_does_not_take_what_it_calls(package: Path) -> None:
    os.utime(package / CALLER, (3000, 3000))
    assert _kept(package) == [False, True, True]


def test_a_module_that_is_no_kernel_counts_where_constants_are_taken_from_it(package: Path) -> None:
    os.utime(package / "mocap/likelihood/residuals/outlines.py", (3000, 3000))
    assert _kept(package) == [True, True, True]
    os.utime(package / "mocap/likelihood/voxels/exact.py", (3000, 3000))  # OCCUPIED_BIT
    assert _kept(package) == [False, True, True]


def test_a_run_forgets_them_first(package: Path) -> None:
    """Before it looks at anything else."""
    os.utime(package / CALLED, (3000, 3000))
    code = "from mocap.pipeline.run import run_session; run_session('nowhere', 'out')"
    subprocess.run([sys.executable, "-c", code], cwd=package, check=False, capture_output=True)
    assert not _index(package / CALLER).exists()
