"""OpenCV's FileStorage files (YAML, XML, JSON) as plain values: maps, lists, numbers, text and matrices."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from mocap.io.calibration.record import bad

Array = NDArray[np.float64]
Map = dict[str, Any]

# A matrix is a map with these keys, beside `rows` and `cols` or `sizes`.
_MATRIX_KEYS = {"dt", "data"}


def read_storage(path: Path) -> Map:
    """The content of a FileStorage file; a matrix is an array, an empty node None.

    Raises MocapError for what is no FileStorage file or no map.
    """
    try:
        storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_READ)
    except (cv2.error, SystemError) as error:
        raise bad(path, "not an OpenCV FileStorage file (a YAML one starts with %YAML:1.0)") from error
    if not storage.isOpened():
        raise bad(path, "not an OpenCV FileStorage file (a YAML one starts with %YAML:1.0)")
    try:
        root = _value(storage.root())
    except cv2.error as error:
        raise bad(path, f"a matrix of the file makes no sense: {error.err}") from error
    finally:
        storage.release()
    if not isinstance(root, dict) or not root:
        raise bad(path, "the file holds no camera")
    return root


def _value(node: Any) -> Any:
    if node.isMap():
        keys = node.keys()
        return node.mat() if set(keys) >= _MATRIX_KEYS else {key: _value(node.getNode(key)) for key in keys}
    if node.isSeq():
        return [_value(node.at(i)) for i in range(node.size())]
    if node.isString():
        return node.string()
    return None if node.isNone() else node.real()


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
