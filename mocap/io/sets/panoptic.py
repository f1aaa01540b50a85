"""CMU Panoptic: HD videos or pictures, calibration_SEQUENCE.json and the bodies of every HD frame."""

from __future__ import annotations

import re
from pathlib import Path

from mocap.errors import MocapError
from mocap.files import load_json
from mocap.io.calibration.panoptic import read_panoptic as read_cameras
from mocap.io.formats.panoptic import HD_FPS, panoptic_folder, read_panoptic
from mocap.io.sets.recording import Recording, clips_named, files_below

_CAMERA = re.compile(r"^hd_(\d\d_\d\d)\.\w+$")


def takes(root: Path) -> dict[str, Path]:
    """SEQUENCE -> its calibration."""
    return {p.stem.removeprefix("calibration_"): p for p in files_below(root, "calibration_*.json")}


def read(root: Path, calibration: Path) -> Recording:
    """The HD cameras of hdVideos/hd_00_NN.mp4, or of hdImgs/00_NN/; those of VGA run on another clock."""
    sequence = calibration.parent
    if panoptic_folder(sequence) is None:
        raise MocapError(
            "the sequence holds no bodies: no hdPose3d_stage1_coco19/body3DScene_*.json",
            path=sequence,
            remedy="unpack hdPose3d_stage1_coco19.tar",
        )
    clips = clips_named(files_below(sequence, "hdvideos/*"), _CAMERA)
    pictures = sequence / "hdImgs"
    if not clips and pictures.is_dir():
        clips = {folder.name: folder for folder in sorted(pictures.iterdir()) if folder.is_dir()}
    document = load_json(calibration, "the calibration", remedy="unpack the sequence again")
    if not isinstance(document, dict) or not isinstance(document.get("cameras"), list):
        raise MocapError("the calibration has no list `cameras`", path=calibration, remedy="unpack it again")
    return Recording(
        rig=read_cameras(calibration, document),
        rig_path=calibration,
        clips=clips,
        truth=read_panoptic(sequence),
        fps=HD_FPS,
        notes=(
            "joints are a network's, triangulated from all cameras, not markers; coco19 has no top of the head",
        ),
    )
