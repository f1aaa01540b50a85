"""Motions of one figure: joint rotations over time, with feet that stand still while they bear weight.

Every motion is a function `MOTIONS[name](figure, n_frames, fps, *, ..., rng) -> Pose` in a file of its own; `kit` holds
what they share.
"""

from __future__ import annotations

from collections.abc import Callable

from mocap.synth.motions.box import box
from mocap.synth.motions.capture import capture
from mocap.synth.motions.dance import dance
from mocap.synth.motions.fall import fall
from mocap.synth.motions.gesture import gesture
from mocap.synth.motions.jog import jog
from mocap.synth.motions.jump import jump
from mocap.synth.motions.kit import Path, Pose
from mocap.synth.motions.pick_up import pick_up
from mocap.synth.motions.route import Stop, route
from mocap.synth.motions.sit import sit
from mocap.synth.motions.squat import squat
from mocap.synth.motions.stairs import stairs
from mocap.synth.motions.stand import stand
from mocap.synth.motions.throw import throw
from mocap.synth.motions.walk import walk

MOTIONS: dict[str, Callable[..., Pose]] = {
    "walk": walk,
    "stand": stand,
    "squat": squat,
    "jump": jump,
    "gesture": gesture,
    "box": box,
    "pick_up": pick_up,
    "route": route,
    "jog": jog,
    "throw": throw,
    "dance": dance,
    "sit": sit,
    "stairs": stairs,
    "fall": fall,
    "capture": capture,
}

__all__ = ["MOTIONS", "Path", "Pose", "Stop"]
