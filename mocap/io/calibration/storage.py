"""OpenCV's FileStorage files (YAML, XML, JSON) as plain values: maps, lists, numbers, text and matrices."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mocap.files import DOCUMENT_LIMIT_BYTES, read_text
from mocap.io._child import read_in_child
from mocap.io.calibration.record import bad

Array = NDArray[np.float64]
Map = dict[str, Any]

_REMEDY = "correct the file or calibrate again"


def read_storage(path: Path) -> Map:
    """The content of a FileStorage file; a matrix is an array, an empty node None.

    Raises MocapError for what is no FileStorage file or no map.
    """
    if not read_text(path, "the calibration", limit=DOCUMENT_LIMIT_BYTES, remedy=_REMEDY).strip():
        raise bad(path, "the file is empty")
    values, arrays = read_in_child("storage", path, "the calibration", remedy=_REMEDY)
    root = _with_arrays(values, arrays)
    if not isinstance(root, dict) or not root:
        raise bad(path, "the file holds no camera")
    return root


def _with_arrays(value: Any, arrays: dict[str, NDArray[Any]]) -> Any:
    """Values as the child sends them, with their matrices put in."""
    if isinstance(value, list):
        return [_with_arrays(v, arrays) for v in value]
    if not isinstance(value, dict):
        return value
    if "$array" in value:
        return arrays[value["$array"]]
    return {key: _with_arrays(v, arrays) for key, v in value["$map"].items()}


def first_numbers(holder: Map, names: Sequence[str]) -> Array | None:
    """Numbers of the first of the named nodes that is a matrix or a list; None when none is."""
    for name in names:
        value = holder.get(name)
        if isinstance(value, np.ndarray):
            return value
        if isinstance(value, list):
            return np.array(list(_flat(value)), dtype=np.float64)
    return None


def _flat(values: list[Any]) -> Iterator[float]:
    for value in values:
        if isinstance(value, list):
            yield from _flat(value)
        else:
            # NaN is refused by who asked for numbers.
            yield value if isinstance(value, float) else float("nan")
