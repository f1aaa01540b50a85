"""Keypoints of a rig: every camera's file or folder read by its kind, and checked against its picture."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from mocap.data.camera import Camera, CameraRig
from mocap.data.keypoints import Figures, joined
from mocap.errors import MocapError
from mocap.io.clip_frames import ClipFrames, shown_rows
from mocap.io.keypoints.clip import CameraKeypoints
from mocap.io.keypoints.json_files import frames_of, json_pictures, read_coco_results, read_openpose_folder
from mocap.io.keypoints.table import read_table

# Networks put hidden joints beyond the picture's edge; a file in which more than this share of the points lies outside
# is of another resolution.
_MOST_OUTSIDE = 0.3


def read_camera(path: Path) -> CameraKeypoints:
    """The keypoints of one camera: a folder of JSON files, a list of COCO results, or a CSV table.

    Raises MocapError for what cannot be read.
    """
    if path.is_dir():
        return read_openpose_folder(path)
    return read_coco_results(path) if path.suffix.lower() == ".json" else read_table(path)


def count_frames(path: Path) -> int:
    """Frames up to the last one that the keypoints of one camera tell of."""
    if path.is_dir():
        return max(frames_of(json_pictures(path)), default=-1) + 1
    return read_camera(path).n_frames


def read_keypoints(
    sources: Mapping[str, Path], rig: CameraRig, frames: range, clip_frames: ClipFrames | None = None
) -> dict[int, Figures]:
    """Figures of all cameras by frame, for every frame that was asked for; a camera without a source has none.

    clip_frames : camera name -> the picture of its clip that shows each frame of the session; None = picture k shows
    frame k.
    Raises MocapError for an unreadable file, and for keypoints that do not fit the camera's picture.
    """
    found: dict[int, list[Figures]] = {frame: [] for frame in frames}
    for c, camera in enumerate(rig):
        if camera.name not in sources:
            continue
        clip = read_camera(sources[camera.name])
        _check_inside(clip, camera)
        pictures = np.array(sorted(clip.of_frame), dtype=np.int64)
        for frame, row in zip(
            *shown_rows(pictures, frames, (clip_frames or {}).get(camera.name)), strict=True
        ):
            if figures := clip.of_frame[int(pictures[row])]:
                points = np.stack(figures)
                uv, confidence = points[..., :2].copy(), np.nan_to_num(points[..., 2])
                found[int(frame)].append(Figures(uv, confidence, np.full(len(points), c, dtype=np.int64)))
    return {frame: joined(figures) for frame, figures in found.items()}


def _check_inside(clip: CameraKeypoints, camera: Camera) -> None:
    figures = [f for frame in clip.of_frame.values() for f in frame]
    if not figures:
        return
    uv = np.stack(figures)[..., :2]
    uv = uv[np.isfinite(uv).all(axis=-1)]
    if len(uv) and (np.abs(uv - 0.5) <= 1.0).mean() > 1.0 - _MOST_OUTSIDE:
        raise MocapError(
            "the keypoints are fractions of the picture, or all in its corner",
            path=clip.path,
            camera=camera.name,
            remedy=f"multiply them by its size, {camera.size[0]} x {camera.size[1]} pixels",
        )
    if len(uv) and (~camera.contains(uv)).mean() > _MOST_OUTSIDE:
        w, h = camera.size
        raise MocapError(
            f"{100 * (~camera.contains(uv)).mean():.0f} % of the keypoints lie outside the picture of {w} x {h} pixels",
            path=clip.path,
            camera=camera.name,
            remedy="check that keypoints and calibration are of the same resolution, in pixels from the upper left "
            "corner (not in fractions of the picture)",
        )
