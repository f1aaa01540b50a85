"""Captured motion from a file."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from mocap.errors import MocapError
from mocap.synth.figure import Figure
from mocap.synth.motions.kit import Pose


def capture(
    figure: Figure,
    n_frames: int,
    fps: float,
    *,
    file: Path | str,
    joint_map: Path | str | None = None,
    from_s: float = 0.0,
    position: tuple[float, float] | None = None,
    heading_rad: float | None = None,
    rng: np.random.Generator,
) -> Pose:
    """A captured motion, performed by our figure.

    from_s : where in the file to begin; after its end the person stands still.
    position, heading_rad : of the pelvis in the first frame; not given: the room's middle, along +x.
    rng : not used; captured motion has its own variation.
    Raises MocapError for a bad file or map, ValueError when from_s lies outside the recording.
    """
    from mocap.synth.capture import read_capture, retarget  # which uses the kit of this package

    recording, chosen = read_capture(file, joint_map)
    rate = recording.fps or chosen.fps
    if rate is None:
        raise MocapError(
            "neither the capture nor its map gives fps", path=file, remedy="add fps to the joint map"
        )
    first = 1 if chosen.reference == "first_frame" else 0
    length_s = (recording.n_frames - 1 - first) / rate
    if not 0 <= from_s <= length_s:
        raise ValueError(f"start_s must lie in 0 .. {length_s:.2f}, the length of the capture, got {from_s}")
    reference = recording.sampled(np.zeros(1)) if first else recording.at_rest()
    clip = recording.sampled(first + (from_s + np.arange(n_frames) / fps) * rate)
    return retarget(clip, reference, chosen, figure, fps, position=position, heading_rad=heading_rad)
