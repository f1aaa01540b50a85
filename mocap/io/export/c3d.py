"""C3D, the binary marker file of biomechanics laboratories, written through ezc3d."""

from __future__ import annotations

import errno
import os
import struct
from pathlib import Path

import numpy as np

from mocap.data import LANDMARKS, Motion
from mocap.errors import MissingExtra, MocapError
from mocap.io.export._common import check_fps, gap_free, replacing

_BLOCK_BYTES = 512  # C3D files are made of blocks


def write_c3d(path: Path, motion: Motion, fps: float) -> None:
    """Write the landmarks of one person as a C3D file in millimetres, Z up, axes as in the scene.

    Millimetres are what readers of C3D assume; the file says so in POINT:UNITS. One frame for every frame
    from the motion's first to its last; an unknown landmark has the residual -1 (C3D's mark of an invalid
    point). Needs the extra `export`; without it, for a motion without frames, or when the file cannot be
    written, MocapError. Raises ValueError for fps <= 0.
    """
    check_fps(fps)
    path = Path(path)
    try:
        import ezc3d
    except ImportError as error:
        raise MissingExtra(
            "writing C3D needs the package ezc3d, which is not installed", "export", path=path
        ) from error
    if len(motion) == 0:
        raise MocapError(
            f"person {motion.person} has no frames; a C3D file cannot be empty",
            remedy="export another person or a frame range in which this one is present",
            path=path,
        )
    motion = gap_free(motion, fps)
    known = np.all(np.isfinite(motion.landmarks), axis=2)
    points = np.ones((4, len(LANDMARKS), len(motion)))
    points[:3] = np.where(known[:, :, None], 1000.0 * motion.landmarks, np.nan).transpose(2, 1, 0)

    c3d = ezc3d.c3d()
    point = c3d["parameters"]["POINT"]
    point["RATE"]["value"] = [float(fps)]
    point["LABELS"]["value"] = list(LANDMARKS)
    point["DESCRIPTIONS"]["value"] = [name.replace("_", " ") for name in LANDMARKS]
    point["UNITS"]["value"] = ["mm"]
    c3d.add_parameter("POINT", "X_SCREEN", ["+X"])
    c3d.add_parameter("POINT", "Y_SCREEN", ["+Z"])
    c3d["header"]["points"]["first_frame"] = int(motion.frames[0])
    c3d["data"]["points"] = points
    c3d["data"]["meta_points"]["residuals"] = np.where(known.T, 0.0, -1.0)[None]
    with replacing(path) as temporary:
        try:
            c3d.write(str(temporary))
        except (RuntimeError, ValueError) as error:
            raise MocapError(
                f"ezc3d could not write the file: {error}",
                remedy="check that the folder is writable and has space left",
                path=path,
            ) from error
        if not _is_whole(temporary, points.shape[1] * points.shape[2]):
            # ezc3d says nothing when the disk is full.
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def _is_whole(path: Path, n_points: int) -> bool:
    """Whether a file of so many points (x, y, z, residual as float32) was written to its end.

    ezc3d puts the block where the data begin into the header at the very end; until then it says 1.
    """
    with path.open("rb") as file:
        header = file.read(_BLOCK_BYTES)
    if len(header) < _BLOCK_BYTES:
        return False
    (first_block,) = struct.unpack_from("<H", header, 16)
    return first_block > 1 and path.stat().st_size >= (first_block - 1) * _BLOCK_BYTES + 16 * n_points
