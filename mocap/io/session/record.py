"""A session and what can be said about it."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from mocap.data import CameraRig
from mocap.data.depth import DepthUnits
from mocap.io.calibration import CalibrationFile
from mocap.io.session.settings import Bounds, Polygon
from mocap.io.video import ClipInfo


@dataclass(frozen=True, eq=False)
class Session:
    """A checked session folder.

    rig : the cameras with a source, in the order of the calibration.  frames : the frames to work on.
    image_sources, mask_sources : camera name -> path; each is either empty or covers the whole rig.
    background_sources, detection_sources, keypoint_sources, depth_sources : camera name -> path; may cover the rig in
    part.  depth : how depth maps are stored.
    clip_frames : camera name -> (frames.stop,) the picture of its clip that shows each frame; empty = picture k of
    every clip shows frame k. Detections, keypoints and depth maps count the pictures of their clip too.
    clips : camera name -> what was counted and measured of its pictures (else masks).
    room_bounds_m : (lower, upper) corners, m, world.  checkerboard : inner corners (columns, rows).
    roi_sources, roi_px : camera name -> picture that is not 0, or polygon of (u, v), where persons can be; cameras with
    neither look everywhere.
    notes : conversions of the calibration reader.  warnings : what the user should know before trusting a run.
    """

    root: Path
    name: str
    rig: CameraRig
    fps: float
    frames: range
    image_sources: dict[str, Path]
    background_sources: dict[str, Path]
    mask_sources: dict[str, Path]
    detection_sources: dict[str, Path]
    room_bounds_m: Bounds | None
    person_height_m: float | None
    warnings: tuple[str, ...]
    truth_dir: Path | None
    calibration_path: Path
    calibration: CalibrationFile
    clips: dict[str, ClipInfo]
    notes: tuple[str, ...] = ()
    marker_colour: tuple[int, int, int] | None = None
    checkerboard: tuple[int, int] | None = None
    checkerboard_square_m: float | None = None
    keypoint_sources: dict[str, Path] = field(default_factory=dict)
    depth_sources: dict[str, Path] = field(default_factory=dict)
    depth: DepthUnits = field(default_factory=DepthUnits)
    roi_sources: dict[str, Path] = field(default_factory=dict)
    roi_px: dict[str, Polygon] = field(default_factory=dict)
    clip_frames: dict[str, NDArray[np.int64]] = field(default_factory=dict)


@dataclass(frozen=True)
class Finding:
    """One line of `mocap check`."""

    severity: Literal["ok", "warning", "error"]
    message: str
    camera: str | None = None
    remedy: str = ""
