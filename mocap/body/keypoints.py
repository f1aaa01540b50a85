"""Keypoints on a body: where the points that pose networks name sit, beside its landmarks."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mocap.body.markers import Markers
from mocap.body.model import Body
from mocap.data.keypoints import KEYPOINTS
from mocap.data.motion import LANDMARKS


class Place(NamedTuple):
    """landmark : that the keypoint lies beside.  offset : from it, in the frame of its carrier at rest (x forward, y to
    the left side, z up), fractions of the standing height; of the left one of a pair.  is_on_parent : it moves with
    the segment before the landmark's: a shoulder moves with the collar bone, not with the arm.  slack_m : how far it
    moves against its segment, at joints that the body does not have."""

    landmark: str
    offset: tuple[float, float, float]
    is_on_parent: bool = False
    slack_m: float = 0.0


# Where MediaPipe's points lie on people whose joints are known: means over two development sessions of which no result
# is reported, printed by `python -m eval.keypoint_places`. Other tools differ by a centimetre or two, which is learnt
# from every clip anew; the head's top and the neck are those of the body.
PLACES: dict[str, Place] = {
    "nose": Place("head", (0.058, 0.0, -0.088)),
    "head": Place("head", (0.0, 0.0, 0.0)),
    "neck": Place("neck", (0.0, 0.0, 0.0), is_on_parent=True),
    "pelvis": Place("pelvis", (0.0, 0.0, 0.0)),
    "eye": Place("head", (0.044, 0.015, -0.071)),
    "ear": Place("head", (0.018, 0.029, -0.082)),
    "shoulder": Place("shoulder", (0.0, -0.004, 0.012), is_on_parent=True),
    "elbow": Place("elbow", (0.010, -0.006, -0.006)),
    "wrist": Place("wrist", (0.0, -0.003, -0.005)),
    "hand": Place("wrist", (0.0, 0.038, -0.004), slack_m=0.05),
    "hip": Place("hip", (0.015, -0.010, -0.012), is_on_parent=True),
    "knee": Place("knee", (-0.004, -0.002, -0.001)),
    "ankle": Place("ankle", (0.003, 0.001, 0.015)),
    "heel": Place("ankle", (-0.012, 0.0, -0.027), slack_m=0.03),
    "toe": Place("ankle", (0.102, -0.010, -0.009), slack_m=0.05),
}


def place_keypoints(body: Body) -> Markers:
    """The keypoints on a body, in the order of KEYPOINTS: offsets grow with the standing height."""
    joint, offset, slack = [], [], []
    for name in KEYPOINTS:
        side, _, kind = name.rpartition("_")
        place = PLACES[kind]
        paired = f"{side}_{place.landmark}"
        landmark = LANDMARKS.index(paired if paired in LANDMARKS else place.landmark)
        own = int(body.landmark_joint[landmark])
        at = body.landmark_offset[landmark]
        parent = int(body.parent[own])
        if place.is_on_parent and parent >= 0:
            own, at = parent, at + body.offset[own]
        mirror = np.array([1.0, -1.0 if side == "right" else 1.0, 1.0])
        joint.append(own)
        offset.append(at + mirror * place.offset * body.height_m)
        slack.append(place.slack_m)
    carriers = np.array(joint, dtype=np.int64)
    return Markers(KEYPOINTS, carriers, body.part_of_joint[carriers], np.array(offset), np.array(slack))
