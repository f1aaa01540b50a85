"""netCDF in the layout of `movement`, the toolbox of neuroscience for motion tracks: a dataset of poses."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mocap.data import Motion
from mocap.errors import MocapError
from mocap.io.formats._together import Together, together
from mocap.io.formats._writing import check_fps, replacing


def write_movement(path: Path, motions: Sequence[Motion], fps: float) -> None:
    """Write the landmarks of all persons as a poses dataset of `movement`: netCDF-3, metres, z up.

    Variables over (time, space, keypoints, individuals): `position`, `std` (standard deviation along the world axes,
    m); over (time, keypoints, individuals): `confidence`, 1 = observed, 0 = not. NaN where a person was not followed.
    `time` is in seconds from the recording's beginning, a row for every frame; individuals are `person_1` and so on.
    netCDF-3 is what scipy writes; xarray, R and MATLAB read it.
    Raises ValueError for fps <= 0, MocapError without persons or when the file cannot be written.
    """
    check_fps(fps)
    motions = [m for m in motions if len(m)]
    if not motions:
        raise MocapError("no person has frames to write", remedy="export another frame range", path=path)
    recording = together(motions, fps)
    labels = {
        "space": ("x", "y", "z"),
        "keypoints": recording.names,
        "individuals": tuple(f"person_{m.person}" for m in motions),
    }
    with replacing(path) as temporary:
        _write_netcdf(temporary, recording, labels, fps)


def _write_netcdf(path: Path, recording: Together, labels: dict[str, tuple[str, ...]], fps: float) -> None:
    from scipy.io import netcdf_file

    # 64-bit offsets: hours of many persons are more than 2 GB.
    with netcdf_file(path, "w", version=2) as file:
        file.createDimension("time", len(recording.frames))
        # Without `units`: readers would take seconds since nothing for a date.
        file.createVariable("time", "f8", ("time",))[:] = recording.time_s
        for name, words in labels.items():
            characters = _characters(words)
            file.createDimension(name, len(words))
            file.createDimension(f"{name}_length", characters.shape[1])
            variable = file.createVariable(name, "c", (name, f"{name}_length"))
            variable[:] = characters
            variable._Encoding = b"utf-8"
        points = ("time", "keypoints", "individuals")
        coordinates = ("time", "space", "keypoints", "individuals")
        for name, over, values, unit in (
            ("position", coordinates, recording.places.transpose(1, 3, 2, 0), b"m"),
            ("std", coordinates, recording.std.transpose(1, 3, 2, 0), b"m"),
            ("confidence", points, recording.observed.transpose(1, 2, 0), b"1"),
        ):
            variable = file.createVariable(name, "f8", over)
            variable[:] = values
            variable.units = unit
            variable._FillValue = np.nan
        file.source_software = b"mocap"
        file.ds_type = b"poses"
        file.time_unit = b"seconds"
        file.fps = float(fps)
        file.first_frame = int(recording.frames[0])


def _characters(words: Sequence[str]) -> NDArray[np.bytes_]:
    """Words as rows of single bytes, (N, L), padded with NUL."""
    encoded = [word.encode("utf-8") for word in words]
    length = max(map(len, encoded))
    return np.array([[bytes([b]) for b in word.ljust(length, b"\0")] for word in encoded], dtype="S1")
