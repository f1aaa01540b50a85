"""Names of markers as other tools have them, so that their models and set-up files know ours."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal, get_args

MarkerNames = Literal["mocap", "opencap", "halpe26", "body25b"]
MARKER_NAMES: tuple[MarkerNames, ...] = get_args(MarkerNames)

# Landmark -> name in OpenCap's videos, in Halpe26 and in BODY_25B of Pose2Sim; empty = the set has no such point.
_MIDDLE = {
    "pelvis": ("midHip", "Hip", ""),
    "neck": ("Neck", "Neck", "Neck"),
    "head": ("", "Head", "Head"),
}
# Of both sides; the names are those of Pose2Sim and OpenCap alike.
_PAIRED = {
    "shoulder": "Shoulder",
    "elbow": "Elbow",
    "wrist": "Wrist",
    "hip": "Hip",
    "knee": "Knee",
    "ankle": "Ankle",
    "heel": "Heel",
    "toe": "BigToe",
}


def marker_names(landmarks: Sequence[str], markers: MarkerNames) -> dict[str, str]:
    """Landmark -> name of its marker, in their order; those that the set has no name for are left out."""
    if markers == "mocap":
        return {name: name for name in landmarks}
    column = MARKER_NAMES.index(markers) - 1
    found = {}
    for landmark in landmarks:
        side, _, kind = landmark.partition("_")
        if landmark in _MIDDLE:
            name = _MIDDLE[landmark][column]
        else:
            name = f"{side[0].upper()}{_PAIRED[kind]}" if kind in _PAIRED else ""
        if name:
            found[landmark] = name
    return found
