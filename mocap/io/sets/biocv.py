"""bioCV: nine videos, a .calib of each camera, and markers.c3d beside the videos."""

from __future__ import annotations

import re
from pathlib import Path

from mocap.errors import MocapError
from mocap.io.calibration.laboratory import joined, read_biocv
from mocap.io.formats.c3d import read_c3d
from mocap.io.sets.recording import Recording, clips_named, files_below, from_zero

_CAMERA = re.compile(r"^([^.]+)\.\w+$")


def takes(root: Path) -> dict[str, Path]:
    """PARTICIPANT/TRIAL -> its markers.c3d."""
    return {f"{p.parents[1].name}/{p.parent.name}": p for p in files_below(root, "markers.c3d")}


def read(root: Path, markers: Path) -> Recording:
    """Videos called as the calibrations (00.mp4, 00.mp4.calib), which lie in the participant's folder or below it."""
    participant = markers.parents[1]
    files = [p for p in files_below(participant, "*.calib") if p.is_relative_to(participant)]
    if not files:
        raise MocapError("the participant has no .calib", path=participant, remedy="unpack the whole archive")
    truth = read_c3d(markers)
    return Recording(
        rig=joined([read_biocv(file) for file in files]),
        rig_path=files[0].parent,
        clips=clips_named(sorted(markers.parent.iterdir()), _CAMERA),
        truth=from_zero(truth),
        fps=truth.fps,
        notes=("the k-th row of markers.c3d is taken for the k-th picture of every camera",),
    )
