"""A session and what can be said about it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from typing import Literal, TypeVar

import numpy as np
from numpy.typing import NDArray

from mocap.data import Camera, CameraRig, Motion, Tracks
from mocap.data.depth import DepthUnits
from mocap.io.calibration import CalibrationFile
from mocap.io.session.settings import Bounds, Polygon
from mocap.io.tables import read_landmarks_csv, read_tracks_csv
from mocap.io.video import ClipInfo

Read = TypeVar("Read")


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
    later_calibrations : frame -> calibration that holds from there on, of frames after the first, ascending; a session
    is opened with what holds at its first frame.
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
    later_calibrations: dict[int, CalibrationFile] = field(default_factory=dict)

    @cached_property
    def true_motions(self) -> list[Motion] | None:
        """What truth/landmarks.csv holds, None without it; read when it is first asked for. Raises MocapError."""
        return self._truth("landmarks.csv", read_landmarks_csv)

    @cached_property
    def true_tracks(self) -> Tracks | None:
        """The same of truth/tracks.csv."""
        return self._truth("tracks.csv", read_tracks_csv)

    def _truth(self, name: str, read: Callable[[Path], Read]) -> Read | None:
        path = None if self.truth_dir is None else self.truth_dir / name
        return read(path) if path is not None and path.exists() else None

    @property
    def stretches(self) -> tuple[range, ...]:
        """The frames, parted where another calibration begins to hold."""
        edges = [self.frames.start, *self.later_calibrations, self.frames.stop]
        return tuple(range(first, stop) for first, stop in pairwise(edges))

    @property
    def has_empty_scene(self) -> bool:
        """Whether masks are of what is not there when nobody is: every camera has an empty clip, or masks are given."""
        return bool(self.mask_sources) or set(self.rig.names) <= self.background_sources.keys()

    def rig_at(self, frame: int) -> CameraRig:
        """The cameras as they stand in a frame, in the sizes of `rig`."""
        holding = [found for first, found in self.later_calibrations.items() if first <= frame]
        if not holding:
            return self.rig
        cameras = []
        for camera in self.rig:
            own = holding[-1].rig[camera.name]
            cameras.append(own if own.size == camera.size else own.reduced(own.size[0] // camera.size[0]))
        return CameraRig(tuple(cameras))

    def is_pushed(self, frame: int) -> NDArray[np.bool_]:
        """Which cameras (C,) stand elsewhere in a frame than `rig` has them."""
        return np.array([not stands_alike(*pair) for pair in zip(self.rig, self.rig_at(frame), strict=True)])


def stands_alike(one: Camera, other: Camera) -> bool:
    """Whether a camera is at the same place and looks the same way in two calibrations."""
    return np.allclose(one.R, other.R) and np.allclose(one.t, other.t)


@dataclass(frozen=True)
class Finding:
    """One line of `mocap check`."""

    severity: Literal["ok", "warning", "error"]
    message: str
    camera: str | None = None
    remedy: str = ""
