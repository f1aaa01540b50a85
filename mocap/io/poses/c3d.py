"""C3D, the marker file of biomechanics laboratories (HumanEva among them), read through ezc3d."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from mocap.errors import MissingExtra, MocapError
from mocap.io.poses.table import PoseFile, PoseTable, without_zeros, zero_note
from mocap.io.poses.trc import person_in_name

_UNITS = {"m": "m", "cm": "cm", "mm": "mm"}
_C3D_KEY = 0x50  # second byte of every C3D file


def read_c3d(path: Path) -> PoseFile:
    """Read the points of a C3D file: one person, points with a negative residual are unknown.

    Up is what POINT:Y_SCREEN says points up on a screen, else z. A prefix `Name:` of the labels is left out.
    Needs the extra `export`. Raises MocapError for what is no C3D file or holds no points.
    """
    path = Path(path)
    try:
        with path.open("rb") as file:
            head = file.read(2)
    except OSError as error:
        raise MocapError(
            f"the file cannot be read: {error.strerror}", path=path, remedy="check the path"
        ) from error
    if len(head) < 2 or head[1] != _C3D_KEY:
        raise MocapError("not a C3D file", path=path, remedy="export the file again")
    try:
        import ezc3d
    except ImportError as error:
        raise MissingExtra(
            "reading C3D needs the package ezc3d, which is not installed", "export", path=path
        ) from error
    try:
        c3d = ezc3d.c3d(str(path))
        point = c3d["parameters"]["POINT"]
        xyz = np.asarray(c3d["data"]["points"], dtype=np.float64)[:3].transpose(2, 1, 0)
        residual = np.asarray(c3d["data"]["meta_points"]["residuals"], dtype=np.float64)
        first = int(c3d["header"]["points"]["first_frame"])
    except (OSError, RuntimeError, ValueError, KeyError, IndexError) as error:
        raise MocapError(
            f"the C3D file cannot be read: {error}", path=path, remedy="export the file again"
        ) from error
    labels: list[str] = []
    for key in ["LABELS", *(f"LABELS{i}" for i in range(2, 20))]:
        labels += list(point[key]["value"]) if key in point else []
    K = min(len(labels), xyz.shape[1])
    if K == 0:
        raise MocapError("the C3D file holds no named points", path=path, remedy="export points with labels")
    names = tuple(str(label).rpartition(":")[2].strip() for label in labels[:K])
    xyz = xyz[:, :K]
    if residual.size == residual.shape[-1] * residual.shape[-2]:
        lost = residual.reshape(residual.shape[-2], residual.shape[-1]).T[:, :K] < 0
        xyz = np.where(lost[:, :, None], np.nan, xyz)
    xyz, n_zero = without_zeros(xyz)
    rate = float(np.ravel(point["RATE"]["value"])[0]) if "RATE" in point else 0.0
    screen = str(np.ravel(point["Y_SCREEN"]["value"])[0]) if "Y_SCREEN" in point else "+Z"
    units = str(np.ravel(point["UNITS"]["value"])[0]).strip().lower() if "UNITS" in point else ""
    frames = first + np.arange(len(xyz), dtype=np.int64)
    fps = rate if rate > 0 else None
    time_s = np.asarray(frames / rate if rate > 0 else frames, dtype=np.float64)
    return PoseFile(
        path=path,
        format="C3D",
        people=(PoseTable(person_in_name(path), names, frames, time_s, xyz),),
        fps=fps,
        unit=_UNITS.get(units),
        up=screen.strip().lower().removeprefix("+") if screen.strip()[-1:].lower() in "xyz" else "z",
        notes=zero_note(n_zero),
    )
