"""The right reader for a file of poses."""

from __future__ import annotations

from pathlib import Path

from mocap.errors import MocapError
from mocap.io.formats.bvh import read_bvh
from mocap.io.formats.c3d import read_c3d
from mocap.io.formats.csv import read_csv
from mocap.io.formats.panoptic import panoptic_folder, read_panoptic
from mocap.io.formats.table import PoseFile
from mocap.io.formats.trc import read_trc

_READERS = {
    ".trc": read_trc,
    ".c3d": read_c3d,
    ".bvh": read_bvh,
    ".csv": read_csv,
    ".tsv": read_csv,
    ".txt": read_csv,
    ".json": read_panoptic,
}


def read_poses(path: Path | str) -> PoseFile:
    """Read poses of any known format; the ending of the name tells which. A Panoptic folder is read as one.

    Raises MocapError for an unknown format, a file that is not there, or one that holds no frames.
    """
    path = Path(path)
    if not path.exists():
        raise MocapError("no such file or folder", path=path, remedy="check the path")
    if path.is_dir():
        if panoptic_folder(path) is None:
            raise MocapError(
                "the folder holds no poses: no landmarks.csv, no truth/landmarks.csv, no body3DScene_*.json",
                path=path,
                remedy="give a file, the output folder of `mocap run`, a session with truth, or a Panoptic sequence",
            )
        poses = read_panoptic(path)
    else:
        reader = _READERS.get(path.suffix.lower())
        if reader is None:
            words = (
                "MAT files of HumanEva hold a toolbox's objects; " if path.suffix.lower() == ".mat" else ""
            )
            raise MocapError(
                f"the format {path.suffix or 'without an ending'} is not read",
                path=path,
                remedy=f"{words}give TRC, C3D, BVH, CSV or Panoptic JSON",
            )
        poses = reader(path)
    if not any(len(table.frames) for table in poses.people):
        raise MocapError("the file holds no frames", path=path, remedy="export the file again")
    return poses
