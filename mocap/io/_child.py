"""Parsers that a damaged file can crash, run in a process of their own: FileStorage, C3D, MATLAB's .mat and CDF.

They trust their input: some files end them with a segmentation fault, take all memory or never come back.
The parent starts `python -m mocap.io._child KIND PATH`, which may take so much time and memory and no more, and reads
arrays and plain values from its output.
"""

from __future__ import annotations

import io
import json
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mocap.errors import MissingExtra, MocapError
from mocap.files import MB, check_regular

# Starting takes half a second, longer on a busy machine; then a megabyte of C3D takes a fifth of a second.
LIMIT_S, LIMIT_S_PER_BYTE = 8.0, 2.0 / MB
# Address space: the libraries themselves map some 2 GB; ezc3d takes some 30 bytes for one of the file.
LIMIT_BYTES, LIMIT_BYTES_PER_BYTE = 4096 * MB, 64

_NO_PACKAGE = 3
# Parser -> package that it needs, and the extra that brings it.
_PACKAGES = {"c3d": ("ezc3d", "export"), "cdf": ("cdflib", "sets")}
# A matrix of FileStorage is a map with these keys, beside `rows` and `cols` or `sizes`.
_MATRIX_KEYS = {"dt", "data"}

Content = tuple[Any, dict[str, NDArray[Any]]]
"""Plain values (of JSON), and arrays by name."""


def read_in_child(kind: str, path: Path, what: str, *, remedy: str) -> Content:
    """What the parser `kind` (one of PARSERS) finds in a file.

    Raises MocapError when the file cannot be read, and when the parser says so, crashes, or takes too long or too much.
    """
    size = check_regular(path, what)
    seconds, memory = LIMIT_S + LIMIT_S_PER_BYTE * size, LIMIT_BYTES + LIMIT_BYTES_PER_BYTE * size
    try:
        code, output = _output_of_child(kind, path, memory, seconds)
    except subprocess.TimeoutExpired as error:
        raise MocapError(
            f"{what} cannot be read: its parser took more than {seconds:.0f} s", path=path, remedy=remedy
        ) from error
    return _answer(code, output, kind, path, what, remedy)


def _output_of_child(kind: str, path: Path, memory: int, seconds: float) -> tuple[int, bytes]:
    """Exit code and standard output of a child that parses one file."""
    package_root = Path(__file__).resolve().parents[2]
    search = os.pathsep.join(filter(None, [str(package_root), os.environ.get("PYTHONPATH")]))
    done = subprocess.run(
        [sys.executable, "-m", "mocap.io._child", kind, os.fspath(path), str(memory)],
        stdin=subprocess.DEVNULL,
        capture_output=True,
        timeout=seconds,
        env={**os.environ, "PYTHONPATH": search, "PYTHONSAFEPATH": "1"},
        check=False,
    )
    return done.returncode, done.stdout


def _answer(code: int, output: bytes, kind: str, path: Path, what: str, remedy: str) -> Content:
    """The content that a child has written; MocapError for one that failed."""
    if code == _NO_PACKAGE:
        package, extra = _PACKAGES[kind]
        raise MissingExtra(
            f"reading {kind.upper()} needs the package {package}, which is not installed", extra, path=path
        )
    if code == 0:
        with np.load(io.BytesIO(output), allow_pickle=False) as arrays:
            content = {name: arrays[name] for name in arrays.files}
        values = json.loads(content.pop("values").tobytes())
        if "error" not in values:
            return values["values"], content
        raise MocapError(f"{what} cannot be read: {values['error']}", path=path, remedy=remedy)
    how = f"signal {-code}" if code < 0 else f"exit {code}"
    raise MocapError(
        f"{what} cannot be read: it is damaged, so that its parser failed ({how})", path=path, remedy=remedy
    )


# --- in the child -------------------------------------------------------------------------------------------


def main(kind: str, path: str, memory: str) -> int:
    """Parse one file and write what it holds to the standard output."""
    from mocap.portable import limit_memory

    limit_memory(int(memory))
    sys.stdout.buffer.write(packed(kind, path))
    return 0


def packed(kind: str, path: str) -> bytes:
    """What the parser finds, or what it says against the file, as the bytes of an .npz."""
    try:
        values, arrays = PARSERS[kind](path)
        answer = {"values": values}
    except ImportError:
        raise
    except Exception as error:
        # Whatever C++ or its wrapper raises is the file's fault.
        answer, arrays = {"error": str(error)[:300]}, {}
    text = np.frombuffer(json.dumps(answer).encode(), dtype=np.uint8)
    buffer = io.BytesIO()
    members: Any = {"values": text, **arrays}
    np.savez(buffer, **members)
    return buffer.getvalue()


def _storage(path: str) -> Content:
    """All nodes of a FileStorage file; a matrix is {"$array": name}, a map {"$map": {...}}."""
    import cv2

    storage = cv2.FileStorage(path, cv2.FILE_STORAGE_READ)
    if not storage.isOpened():
        raise ValueError("not an OpenCV FileStorage file (a YAML one starts with %YAML:1.0)")
    arrays: dict[str, NDArray[Any]] = {}

    def value(node: Any) -> Any:
        if node.isMap():
            keys = node.keys()
            if set(keys) >= _MATRIX_KEYS:
                name = f"a{len(arrays)}"
                arrays[name] = np.asarray(node.mat())
                return {"$array": name}
            return {"$map": {key: value(node.getNode(key)) for key in keys}}
        if node.isSeq():
            return [value(node.at(i)) for i in range(node.size())]
        if node.isString():
            return node.string()
        return None if node.isNone() else node.real()

    return value(storage.root()), arrays


def _c3d(path: str) -> Content:
    """Names, rate, unit, up axis and first frame of a C3D file; arrays `points` and `residuals` as ezc3d has them."""
    import ezc3d

    c3d = ezc3d.c3d(path)
    point = c3d["parameters"]["POINT"]

    def first(key: str) -> Any:
        value = np.ravel(point[key]["value"]) if key in point else np.zeros(0)
        return value[0].item() if value.size else None

    labels: list[str] = []
    for key in ["LABELS", *(f"LABELS{i}" for i in range(2, 20))]:
        labels += [str(label) for label in point[key]["value"]] if key in point else []
    values = {
        "labels": labels,
        "rate": first("RATE"),
        "up": first("Y_SCREEN"),
        "units": first("UNITS"),
        "first_frame": int(c3d["header"]["points"]["first_frame"]),
    }
    points = np.asarray(c3d["data"]["points"], dtype=np.float64)
    residuals = np.asarray(c3d["data"]["meta_points"]["residuals"], dtype=np.float64)
    return values, {"points": points, "residuals": residuals}


def _mat(path: str) -> Content:
    """The numbers of a MATLAB file: `NAME` of a plain array, `NAME/k` of the k-th cell of a cell array.

    Objects and functions, which would have to be understood as MATLAB's, are left out; scipy keeps them as bytes.
    """
    import scipy.io

    found = scipy.io.loadmat(path, appendmat=False)
    arrays: dict[str, NDArray[Any]] = {}
    for name, value in found.items():
        if not isinstance(value, np.ndarray) or name.startswith("__"):
            continue
        cells = {f"{name}/{k}": cell for k, cell in enumerate(value.ravel())} if value.dtype == object else {}
        for key, array in (cells or {name: value}).items():
            if isinstance(array, np.ndarray) and array.dtype.kind in "iuf":
                arrays[key] = array
    return {}, arrays


def _cdf(path: str) -> Content:
    """The variables of a CDF file that hold numbers."""
    import cdflib

    file = cdflib.CDF(Path(path))
    info = file.cdf_info()
    arrays: dict[str, NDArray[Any]] = {}
    for name in [*info.zVariables, *info.rVariables]:
        value = np.asarray(file.varget(name))
        if value.dtype.kind in "iuf":
            arrays[name] = value
    return {}, arrays


PARSERS: dict[str, Callable[[str], Content]] = {"storage": _storage, "c3d": _c3d, "mat": _mat, "cdf": _cdf}

if __name__ == "__main__":
    try:
        code = main(*sys.argv[1:])
    except ImportError:
        code = _NO_PACKAGE
    # C++ destructors of damaged objects have nothing to clean up that the system does not.
    sys.stdout.flush()
    os._exit(code)
