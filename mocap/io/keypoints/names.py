"""Names of keypoints: what tools call the points of a body, in one table, and the orders in which they list them."""

from __future__ import annotations

import re
from collections.abc import Sequence

from mocap.data.keypoints import KEYPOINTS

# Keypoint without its side -> what tools call it: COCO, OpenPose, Halpe, MediaPipe, DeepLabCut and SLEAP projects.
_CALLED: dict[str, tuple[str, ...]] = {
    "nose": ("nose",),
    "head": ("head", "head top", "top of head"),
    "neck": ("neck", "mid shoulder", "c7"),
    "pelvis": ("pelvis", "mid hip", "hip", "hip center", "root"),
    "eye": ("eye",),
    "ear": ("ear",),
    "shoulder": ("shoulder",),
    "elbow": ("elbow",),
    "wrist": ("wrist",),
    "hand": ("hand", "index", "index1", "hand index", "knuckle"),
    "hip": ("hip",),
    "knee": ("knee",),
    "ankle": ("ankle",),
    "heel": ("heel",),
    "toe": ("toe", "big toe", "foot index", "toes"),
}
_SIDES = {"left": ("left", "l"), "right": ("right", "r")}


def _plain(name: str) -> str:
    return re.sub(r"[^a-z0-9]", "", name.lower())


def _known() -> dict[str, int]:
    """Plain name -> row of KEYPOINTS."""
    found: dict[str, int] = {}
    for row, keypoint in enumerate(KEYPOINTS):
        side, _, rest = keypoint.rpartition("_")
        for word in _CALLED[rest]:
            for s in _SIDES.get(side, ("",)):
                found[_plain(s + word)] = row
                found[_plain(word + s)] = row
    return found


_ROWS = _known()

_COCO = (
    *("nose", "left_eye", "right_eye", "left_ear", "right_ear", "left_shoulder", "right_shoulder"),
    *("left_elbow", "right_elbow", "left_wrist", "right_wrist", "left_hip", "right_hip"),
    *("left_knee", "right_knee", "left_ankle", "right_ankle"),
)
_OPENPOSE_HEAD = (
    *("nose", "neck", "right_shoulder", "right_elbow", "right_wrist"),
    *("left_shoulder", "left_elbow", "left_wrist"),
)
_OPENPOSE_LEGS = ("right_hip", "right_knee", "right_ankle", "left_hip", "left_knee", "left_ankle")
_OPENPOSE_FACE = ("right_eye", "left_eye", "right_ear", "left_ear")
_HALPE = (
    *_COCO,
    *("head", "neck", "pelvis", "left_toe", "right_toe", "", "", "left_heel", "right_heel"),
)
_MEDIAPIPE = (
    *("nose", "", "left_eye", "", "", "right_eye", "", "left_ear", "right_ear", "", ""),
    *("left_shoulder", "right_shoulder", "left_elbow", "right_elbow", "left_wrist", "right_wrist"),
    *("", "", "left_hand", "right_hand", "", "", "left_hip", "right_hip", "left_knee", "right_knee"),
    *("left_ankle", "right_ankle", "left_heel", "right_heel", "left_toe", "right_toe"),
)
# Number of points of one person -> name of the order, and its names; "" = a point without a place on the body here.
ORDERS: dict[int, tuple[str, tuple[str, ...]]] = {
    17: ("COCO", _COCO),
    18: ("COCO of OpenPose", (*_OPENPOSE_HEAD, *_OPENPOSE_LEGS, *_OPENPOSE_FACE)),
    25: (
        "BODY_25",
        (
            *_OPENPOSE_HEAD,
            "pelvis",
            *_OPENPOSE_LEGS,
            *_OPENPOSE_FACE,
            *("left_toe", "", "left_heel", "right_toe", "", "right_heel"),
        ),
    ),
    26: ("Halpe26", _HALPE),
    33: ("MediaPipe", _MEDIAPIPE),
    # The body and the feet; face and hands come after them.
    133: ("COCO-WholeBody", (*_COCO, "left_toe", "", "left_heel", "right_toe", "", "right_heel")),
    136: ("Halpe136", _HALPE),
}


def keypoint_row(name: str) -> int | None:
    """Row of KEYPOINTS of what a tool calls `name`; None for a point that has no place there."""
    return _ROWS.get(_plain(name))


def rows_of_order(n_points: int) -> list[int | None] | None:
    """Row of KEYPOINTS of each point in the order with so many of them; None when there is no such order."""
    if n_points not in ORDERS:
        return None
    _, names = ORDERS[n_points]
    return [keypoint_row(name) if name else None for name in names]


def known_of(names: Sequence[str]) -> list[int | None]:
    """Rows of KEYPOINTS of some names, each taken once: a second name of the same point is left out."""
    rows: list[int | None] = []
    for name in names:
        row = keypoint_row(name)
        rows.append(None if row in rows else row)
    return rows
