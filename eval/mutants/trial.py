"""Trial of mutants: planted one by one in a copy of the checkout, where their tests must fail."""

from __future__ import annotations

import hashlib
import multiprocessing
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

from eval.mutants.registry import ROOT, Mutant

_COPIED = ("mocap", "tests", "eval", "docs", "pyproject.toml", "CHANGELOG.md", "README.md", "Makefile")
RESULTS_NAME = "mutants.csv"
_TIMEOUT_S = 600  # a mutant that never ends is noticed too
_OPTIONS = ("-q", "-x", "-n", "0", "-p", "no:cacheprovider", "--assert=plain")
_LIBRARIES = ("numpy", "scipy.optimize", "scipy.stats", "numba", "cv2", "pytest", "hypothesis")


def checkout_digest(root: Path = ROOT) -> str:
    """Hash of all that a trial copies: names and bytes."""
    digest = hashlib.sha256()
    for name in _COPIED:
        for path in sorted([root / name] if (root / name).is_file() else (root / name).rglob("*")):
            if path.is_file() and "__pycache__" not in path.parts and RESULTS_NAME not in path.name:
                digest.update(f"{path.relative_to(root)}\0".encode() + path.read_bytes())
    return digest.hexdigest()


def try_all(mutants: Iterable[Mutant], folder: Path, kept: dict[str, bool], keep: Callable[[], None]) -> None:
    """Try the mutants of which it is not known yet whether a test notices them.

    folder : an empty one.  kept : name -> noticed, grows.  keep : called after every trial, so that a run that is
    stopped need not begin again.
    Raises RuntimeError when tests fail without any mutant: they would prove nothing.
    """
    copy = folder / "copy"
    copy.mkdir()
    for name in _COPIED:
        if (ROOT / name).is_dir():
            shutil.copytree(ROOT / name, copy / name, ignore=shutil.ignore_patterns("__pycache__", "out"))
        elif (ROOT / name).is_file():
            shutil.copy(ROOT / name, copy / name)
    healthy: set[tuple[tuple[str, ...], bool]] = set()
    for mutant in mutants:
        if mutant.name in kept:
            continue
        key = (mutant.tests, mutant.is_compiled)
        if key not in healthy:
            if not passes(mutant, copy, folder):
                raise RuntimeError(f"fails without any mutant: pytest {' '.join(mutant.tests)}")
            healthy.add(key)
        path = copy / mutant.file
        text = path.read_text("utf-8")
        path.write_text(text.replace(mutant.old, mutant.new), "utf-8")
        is_alive = passes(mutant, copy, folder)
        path.write_text(text, "utf-8")
        print(f"{'SURVIVED' if is_alive else 'killed'}  {mutant.name}  {mutant.file}", flush=True)
        kept[mutant.name] = not is_alive
        keep()


def passes(mutant: Mutant, copy: Path, folder: Path) -> bool:
    """Whether the mutant's tests pass in the copy as it is."""
    code = _in_new_compiler(mutant, copy, folder) if mutant.is_compiled else _in_plain_python(mutant, copy)
    if code not in (0, 1, None):
        # Neither passed nor failed: nothing was collected, or a word of the command is wrong.
        raise RuntimeError(f"pytest {' '.join(mutant.tests)} ended with {code}")
    return code == 0


def _in_plain_python(mutant: Mutant, copy: Path) -> int | None:
    """Exit code of pytest without the compiler, None after the timeout; libraries are imported once for all mutants."""
    method = "forkserver" if "forkserver" in multiprocessing.get_all_start_methods() else "spawn"
    context: Any = multiprocessing.get_context(method)  # the common base of contexts knows no Process
    context.set_forkserver_preload(list(_LIBRARIES))
    process = context.Process(target=_run_pytest, args=(copy, mutant.tests))
    process.start()
    process.join(_TIMEOUT_S)
    if process.is_alive():
        process.kill()
        process.join()
        return None
    return process.exitcode


def _run_pytest(copy: Path, tests: tuple[str, ...]) -> None:
    import numba
    import pytest

    def plain(function: Any = None, **options: Any) -> Any:
        """`njit` without the compiler; tests compare kernels with their `py_func`."""
        if function is None:
            return plain
        function.py_func = function
        return function

    numba.njit = plain
    os.chdir(copy)
    sys.path.insert(0, str(copy))
    sys.dont_write_bytecode = True
    silence = os.open(os.devnull, os.O_WRONLY)
    os.dup2(silence, 1)
    os.dup2(silence, 2)
    sys.exit(int(pytest.main([*_OPTIONS, *tests])))


def _in_new_compiler(mutant: Mutant, copy: Path, folder: Path) -> int | None:
    """Exit code of pytest with the compiler and a cache of its own: that of numba knows the file of a kernel, but not
    those of the kernels it calls."""
    cache = tempfile.mkdtemp(dir=folder)
    environment = {
        **os.environ,
        "PYTHONPATH": str(copy),
        "PYTHONDONTWRITEBYTECODE": "1",
        "NUMBA_CACHE_DIR": cache,
    }
    command = [sys.executable, "-m", "pytest", *_OPTIONS, *mutant.tests]
    try:
        done = subprocess.run(command, cwd=copy, env=environment, capture_output=True, timeout=_TIMEOUT_S)
    except subprocess.TimeoutExpired:
        return None
    finally:
        shutil.rmtree(cache, ignore_errors=True)
    return done.returncode
