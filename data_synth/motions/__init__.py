"""Motions of one figure: joint rotations over time, with feet that stand still while they bear weight.

Every motion is a function `MOTIONS[name](figure, n_frames, fps, *, ..., rng) -> Pose` in a file of its own; `kit` holds
what they share.
"""

from __future__ import annotations

from collections.abc import Callable

from data_synth.motions.box import box
from data_synth.motions.capture import capture
from data_synth.motions.dance import dance
from data_synth.motions.fall import fall
from data_synth.motions.gesture import gesture
from data_synth.motions.jog import jog
from data_synth.motions.kit import Path, Pose
from data_synth.motions.pick_up import pick_up
from data_synth.motions.route import Stop, route
from data_synth.motions.sit import sit
from data_synth.motions.stand import stand
from data_synth.motions.throw import throw
from data_synth.motions.walk import walk

MOTIONS: dict[str, Callable[..., Pose]] = {
    "walk": walk,
    "stand": stand,
    "gesture": gesture,
    "box": box,
    "pick_up": pick_up,
    "route": route,
    "jog": jog,
    "throw": throw,
    "dance": dance,
    "sit": sit,
    "fall": fall,
    "capture": capture,
}

__all__ = ["MOTIONS", "Path", "Pose", "Stop"]
