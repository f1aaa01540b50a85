"""MPI-INF-3DHP: fourteen videos, camera.calibration, and annot.mat with the joints as every camera sees them."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mocap.arrays import Array
from mocap.errors import MocapError
from mocap.io._child import read_in_child
from mocap.io.calibration.public_sets import read_skeletool
from mocap.io.calibration.record import RawRig
from mocap.io.formats.table import PoseFile, PoseTable, check_places
from mocap.io.sets.names import MPI_INF_3DHP, MPI_INF_3DHP_LANDMARKS
from mocap.io.sets.recording import Recording, clips_named, files_below

# Joints that two cameras place further apart are not of this calibration; printed digits leave 0.1 mm.
_APART_MM = 20.0
_CAMERA = re.compile(r"^video_(\d+)\.\w+$")
_REMEDY = "unpack the sequence again; camera.calibration and annot.mat must be of the same one"


def takes(root: Path) -> dict[str, Path]:
    """SUBJECT/SEQUENCE -> its annotations."""
    return {f"{p.parents[1].name}/{p.parent.name}": p for p in files_below(root, "annot.mat")}


def read(root: Path, annotations: Path) -> Recording:
    """camera.calibration and imageSequence/video_K.avi beside annot.mat; K is the camera's name."""
    sequence = annotations.parent
    calibration = sequence / "camera.calibration"
    if not calibration.is_file():
        raise MocapError("the sequence has no camera.calibration", path=sequence, remedy=_REMEDY)
    rig = read_skeletool(calibration)
    return Recording(
        rig=rig,
        rig_path=calibration,
        clips=clips_named(files_below(sequence, "imagesequence/*"), _CAMERA),
        truth=read_annotations(annotations, rig),
        landmarks=MPI_INF_3DHP_LANDMARKS,
        notes=("joints come from a markerless system of as many cameras, not from markers",),
    )


def read_annotations(path: Path, rig: RawRig) -> PoseFile:
    """Joints of annot.mat in the world of the cameras, mm, y up: the mean over cameras of `annot3`.

    Raises MocapError where cameras do not agree on it.
    """
    _, arrays = read_in_child("mat", path, "the annotations", remedy=_REMEDY)
    n_joints = len(MPI_INF_3DHP)
    seen: list[Array] = []
    for k, camera in enumerate(rig.cameras):
        own: NDArray[np.float64] | None = arrays.get(f"annot3/{k}")
        if own is None:
            continue
        if own.ndim != 2 or own.shape[1] != 3 * n_joints or (seen and len(own) != len(seen[0])):
            raise MocapError(
                f"annot3 is {' x '.join(map(str, own.shape))}, expected a row of {3 * n_joints} for every frame",
                path=path,
                camera=camera.name,
                remedy=_REMEDY,
            )
        check_places(path, own)
        # x_camera = R x + t, rows of points.
        seen.append((own.reshape(-1, n_joints, 3).astype(np.float64) - camera.t) @ camera.R)
    if not seen or not len(seen[0]):
        raise MocapError("the annotations hold no annot3 of a calibrated camera", path=path, remedy=_REMEDY)
    all_seen = np.stack(seen)
    xyz = all_seen.mean(axis=0)
    apart = float(np.median(np.linalg.norm(all_seen - xyz, axis=-1).max(axis=0)))
    if apart > _APART_MM:
        raise MocapError(
            f"cameras place the joints {apart:.0f} mm apart: annotations and calibration are not of one recording",
            path=path,
            remedy=_REMEDY,
        )
    frames = np.arange(len(xyz))
    table = PoseTable(1, MPI_INF_3DHP, frames, np.full(len(frames), np.nan), xyz)
    return PoseFile(path, "MPI-INF-3DHP", (table,), None, "mm", "y")
