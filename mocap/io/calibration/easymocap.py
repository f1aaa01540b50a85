"""EasyMocap: intrinsics in intri.yml, poses in extri.yml, cameras by name."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from mocap.errors import MocapError
from mocap.io.calibration.record import (
    RawCamera,
    RawRig,
    bad,
    camera_name,
    distortion,
    numbers,
    picture_size,
    rotation,
)
from mocap.io.calibration.storage import Map, first_numbers, read_storage


def read_easymocap(path: Path) -> RawRig:
    """All cameras of the pair of files that `path` (either of them) belongs to.

    Raises MocapError with file and camera when one is missing or lacks a node.
    """
    intri, extri = (path.with_name(stem + path.suffix) for stem in ("intri", "extri"))
    for part in (intri, extri):
        if not part.is_file():
            raise MocapError(
                "EasyMocap keeps a calibration in two files and one is missing",
                path=part,
                remedy="put intri.yml and extri.yml into one folder",
            )
    inner, outer = read_storage(intri), read_storage(extri)
    names = _names(inner) or _names(outer)
    if not names:
        raise bad(intri, "the list `names` is missing or empty")
    cameras = tuple(_camera(camera_name(intri, n), intri, inner, extri, outer) for n in names)
    return RawRig(cameras, "easymocap", units="m", is_unit_sure=False)


def _camera(name: str, intri: Path, inner: Map, extri: Path, outer: Map) -> RawCamera:
    K = first_numbers(inner, (f"K_{name}",))
    if K is None:
        raise bad(intri, f"node K_{name} is missing", camera=name)
    dist = first_numbers(inner, (f"dist_{name}", f"D_{name}"))
    R = first_numbers(outer, (f"Rot_{name}", f"R_{name}"))
    t = first_numbers(outer, (f"T_{name}",))
    if R is None or t is None:
        missing = f"T_{name}" if t is None else f"R_{name}"
        raise bad(extri, f"node {missing} is missing", camera=name)
    width, height = inner.get(f"W_{name}"), inner.get(f"H_{name}")
    return RawCamera(
        name,
        None if width is None or height is None else picture_size(intri, name, [width, height]),
        numbers(intri, name, f"K_{name}", K, (3, 3)),
        distortion(intri, name, [0.0] * 5 if dist is None else dist, False),
        rotation(extri, name, R),
        numbers(extri, name, f"T_{name}", t, (3,)),
    )


def _names(document: Map) -> list[Any]:
    listed = document.get("names")
    if not isinstance(listed, list):
        return []
    # A list written without quotes holds numbers: 1, not "1".
    return [f"{n:g}" if isinstance(n, float) else n for n in listed]
