"""Marker detections and marker labels of a session, read and written."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mocap.data.camera import CameraRig
from mocap.data.detections import Detections
from mocap.errors import MocapError
from mocap.io.clip_frames import ClipFrames, shown_rows
from mocap.io.tables import read_detections_csv, read_marker_labels_csv, write_detections_csv

Array = NDArray[np.float64]

LABELS_FILE = "marker_labels.csv"


def read_detections(
    sources: dict[str, Path], rig: CameraRig, frames: range, clip_frames: ClipFrames | None = None
) -> Detections:
    """The detections of a rig in some frames; a camera without a file has none.

    sources : camera name -> CSV file with the columns frame, u_px, v_px.  clip_frames : camera name -> the picture of
    its clip that shows each frame of the session; None = picture k shows frame k.
    Raises MocapError for an unreadable table and for a detection outside its picture.
    """
    frame, uv = [], []
    for camera in rig:
        if camera.name not in sources:
            frame.append(np.zeros(0, dtype=np.int64))
            uv.append(np.zeros((0, 2)))
            continue
        path = sources[camera.name]
        f, pixels = read_detections_csv(path)
        is_outside = ~camera.contains(pixels)
        if is_outside.any():
            row = int(np.flatnonzero(is_outside)[0])
            u, v = pixels[row]
            raise MocapError(
                f"a detection lies outside the picture of {camera.size[0]} x {camera.size[1]} pixels: "
                f"({u:.1f}, {v:.1f})",
                path=path,
                camera=camera.name,
                frame=int(f[row]),
                remedy="check that detections and calibration are of the same resolution, in pixels from the upper "
                "left corner",
            )
        shown, rows = shown_rows(f, frames, (clip_frames or {}).get(camera.name))
        frame.append(shown)
        uv.append(pixels[rows])
    return Detections(rig.names, tuple(frame), tuple(uv))


def write_detections(folder: Path, detections: Detections) -> None:
    """One CAM.csv per camera into a folder, as sessions have them in detections/."""
    for name, frame, uv in zip(detections.names, detections.frame, detections.uv, strict=True):
        write_detections_csv(folder / f"{name}.csv", frame, uv)


def read_marker_labels(path: Path, rig: CameraRig) -> dict[str, tuple[NDArray[np.int64], Array]]:
    """Hand-labelled markers: camera name -> frame (n,) and uv (n, 2) px.

    path : CSV with the columns frame, camera, u_px, v_px.
    Raises MocapError for a camera that the rig does not have, a label outside its picture, or no label at all.
    """
    frame, cameras, uv = read_marker_labels_csv(path)
    if not len(frame):
        raise MocapError(
            "there are no labels in the file", path=path, remedy="label the markers of one frame"
        )
    out = {}
    for name in dict.fromkeys(cameras):
        if name not in rig.names:
            raise MocapError(
                f"the labels name camera {name!r}, which the session does not have",
                path=path,
                camera=name,
                remedy=f"use one of {', '.join(rig.names)}",
            )
        rows = np.array([c == name for c in cameras])
        if not rig[name].contains(uv[rows]).all():
            raise MocapError(
                "a label lies outside the picture",
                path=path,
                camera=name,
                remedy="give pixels of the videos, counted from the upper left corner",
            )
        out[name] = (frame[rows], uv[rows])
    return out
