"""Human3.6M: four videos at 50 frames/s, metadata.xml with the cameras, and D3_Positions in CDF files."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from mocap.errors import MocapError
from mocap.io._child import read_in_child
from mocap.io.calibration.public_sets import HUMAN36M_SUBJECTS, read_human36m
from mocap.io.formats.table import PoseFile, PoseTable, check_places
from mocap.io.sets.names import HUMAN36M
from mocap.io.sets.recording import Recording, clips_named, files_below, subject_of, the_file

FPS = 50.0
_CAMERA = re.compile(r"\.(\d{8})\.\w+$")


def takes(root: Path) -> dict[str, Path]:
    """SUBJECT/ACTION -> its positions."""
    return {f"{subject_of(p)[0]}/{p.stem}": p for p in files_below(root, "d3_positions/*.cdf")}


def read(root: Path, positions: Path) -> Recording:
    """SUBJECT/Videos/ACTION.CAMERA.mp4 and metadata.xml anywhere below the folder."""
    metadata = the_file(root, "metadata.xml", "cameras")
    subject, folder = subject_of(positions)
    number = int(subject[1:])
    if not 1 <= number <= HUMAN36M_SUBJECTS:
        raise MocapError(
            f"the set has subjects S1 to S{HUMAN36M_SUBJECTS}, not {subject}",
            path=positions,
            remedy="keep the folders of the set as they are",
        )
    videos = [p for p in files_below(folder, "videos/*") if p.name.startswith(f"{positions.stem}.")]
    return Recording(
        rig=read_human36m(metadata, number),
        rig_path=metadata,
        clips=clips_named(videos, _CAMERA),
        truth=read_positions(positions),
        fps=FPS,
    )


def read_positions(path: Path) -> PoseFile:
    """Joints of a CDF file of D3_Positions: the variable `Pose`, (1, T, 96), mm, z up. Needs the extra `sets`."""
    remedy = "unpack the archive again; D3_Positions, not D3_Positions_mono, are in the world of the cameras"
    _, arrays = read_in_child("cdf", path, "the poses", remedy=remedy)
    pose = np.squeeze(arrays.get("Pose", np.zeros(0)))
    if pose.ndim != 2 or pose.shape[1] != 3 * len(HUMAN36M):
        raise MocapError(
            f"the poses have no variable `Pose` of {3 * len(HUMAN36M)} columns", path=path, remedy=remedy
        )
    xyz = pose.reshape(len(pose), len(HUMAN36M), 3).astype(np.float64)
    check_places(path, xyz)
    frames = np.arange(len(xyz))
    return PoseFile(path, "Human3.6M", (PoseTable(1, HUMAN36M, frames, frames / FPS, xyz),), FPS, "mm", "z")
