"""TotalCapture: eight videos at 60 frames/s, calibration.cal, and Vicon's skeleton in inches."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from mocap.errors import MocapError
from mocap.files import read_text
from mocap.io.calibration.public_sets import read_totalcapture
from mocap.io.formats.table import PoseFile, PoseTable, bad_line, check_places, number
from mocap.io.sets.recording import Recording, clips_named, files_below, subject_of, the_file

FPS = 60.0
INCH_M = 0.0254
_POSITIONS = "gt_skel_gbl_pos.txt"
_CAMERA = re.compile(r"_(cam\d+)\.\w+$", re.I)


def takes(root: Path) -> dict[str, Path]:
    """SUBJECT/ACTION -> its positions."""
    return {f"{subject_of(p)[0]}/{p.parent.name}": p for p in files_below(root, _POSITIONS)}


def read(root: Path, positions: Path) -> Recording:
    """TC_S1_acting1_cam1.mp4 ... and calibration.cal, anywhere below the folder."""
    calibration = the_file(root, "calibration.cal", "calibration")
    subject, action = subject_of(positions)[0], positions.parent.name
    clips = clips_named(files_below(root, f"tc_{subject}_{action}_cam*"), _CAMERA)
    return Recording(
        rig=read_totalcapture(calibration),
        rig_path=calibration,
        clips={camera.lower(): clip for camera, clip in clips.items()},
        truth=read_positions(positions),
        fps=FPS,
        notes=("the joint `Head` is not the top of the head, which is left out",),
    )


def read_positions(path: Path) -> PoseFile:
    """Joints of a file of positions: a line of names, then of every frame three numbers for each, inches, y up."""
    lines = read_text(path).splitlines()
    names = tuple(lines[0].split()) if lines else ()
    rows = []
    for k, line in enumerate(lines[1:], start=2):
        cells = line.split()
        if not cells:
            continue
        if len(cells) != 3 * len(names):
            raise bad_line(path, k, f"{len(cells)} numbers, expected 3 for each of {len(names)} joints")
        rows.append([number(path, k, cell, "a place") for cell in cells])
    if not rows:
        raise MocapError("the file holds no frames", path=path, remedy="unpack the archive again")
    xyz = INCH_M * np.reshape(rows, (len(rows), len(names), 3))
    check_places(path, xyz)
    frames = np.arange(len(rows))
    table = PoseTable(1, names, frames, frames / FPS, xyz)
    return PoseFile(path, "TotalCapture", (table,), FPS, "m", "y")
