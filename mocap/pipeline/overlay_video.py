"""Videos of a finished run: what every camera filmed, with bodies and landmarks drawn in."""

from __future__ import annotations

import os
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from mocap.errors import MocapError
from mocap.io.session.reading import pictures_of
from mocap.pipeline.record import Found
from mocap.pipeline.scene_frames import body_parts, rows_at
from mocap.portable import utf8_name
from mocap.progress import Progress, no_progress
from mocap.view import draw_body, draw_label, draw_skeleton

Image = NDArray[np.uint8]

# MPEG-4 part 2: the codec that every OpenCV writes; players know it, browsers do not.
_CODEC = "mp4v"


def overlay_videos(
    found: Found, folder: Path, *, cameras: Sequence[str] | None = None, progress: Progress = no_progress
) -> list[Path]:
    """Write overlay_CAMERA.mp4 for every camera, or those named, into `folder`; gives the files.

    All frames of the run, as large as they were filmed. A file appears when it is whole.
    Raises MocapError for a session without pictures, and when a video cannot be written.
    """
    session = found.session
    names = tuple(n for n in session.rig.names if cameras is None or n in cameras)
    if not session.image_sources:
        raise MocapError(
            "the session has no pictures, only masks",
            path=session.root,
            remedy="an overlay needs the clips: put them into videos/",
        )
    rig = session.rig.subset(names)
    targets = [folder / f"overlay_{name}.mp4" for name in names]
    parts = [target.with_name(f".{target.stem}.part.mp4") for target in targets]
    try:
        with ExitStack() as stack:
            writers = [
                _opened(stack, part, session.fps, camera.size)
                for part, camera in zip(parts, rig, strict=True)
            ]
            reader = stack.enter_context(pictures_of(session, cameras=names))
            for i, (frame, images) in enumerate(reader):
                rows = rows_at(found.poses, frame)
                bodies = [
                    (p.person, p.landmarks[k], p.observed[k], body_parts(p.body, p.states[k]))
                    for p, k in rows
                ]
                for writer, name, image in zip(writers, names, images, strict=True):
                    camera = session.rig_at(frame)[name]
                    picture = image
                    for person, landmarks, observed, flesh in bodies:
                        picture = draw_body(picture, camera, flesh)
                        picture = draw_skeleton(
                            picture, camera, landmarks, observed, label=f"person {person}"
                        )
                    words = f"{camera.name}  frame {frame}  {frame / session.fps:.2f} s"
                    writer.write(draw_label(picture, words, (6.0, 0.0))[..., ::-1])
                progress("video", i + 1, len(session.frames))
        for part, target in zip(parts, targets, strict=True):
            os.replace(part, target)
    finally:
        for part in parts:
            part.unlink(missing_ok=True)
    return targets


def _opened(stack: ExitStack, path: Path, fps: float, size: tuple[int, int]) -> Any:
    """A video to write into, released with the stack."""
    with utf8_name(path) as name:
        writer = cv2.VideoWriter(name, cv2.VideoWriter.fourcc(*_CODEC), fps, size)
    stack.callback(writer.release)
    if not writer.isOpened():
        raise MocapError(
            "the video cannot be written",
            path=path,
            remedy="check that the folder is writable; `mocap doctor` tells which codecs there are",
        )
    return writer
