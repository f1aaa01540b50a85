"""Joints of public sets in the order of their files, and which of them are our landmarks where their names do not tell.

Human3.6M and TotalCapture are called as in their skeletons, which `mocap.io.poses` knows (CMU BVH, Mixamo).
"""

from __future__ import annotations

# Of the 32, those that repeat another or never move have numbers for names.
HUMAN36M = (
    "Hips", "RightUpLeg", "RightLeg", "RightFoot", "RightToeBase", "5",
    "LeftUpLeg", "LeftLeg", "LeftFoot", "LeftToeBase", "10",
    "Spine", "Spine1", "Neck", "Head", "HeadTopEnd",
    "LeftShoulder", "LeftArm", "LeftForeArm", "LeftHand", "20", "21", "22", "23",
    "RightShoulder", "RightArm", "RightForeArm", "RightHand", "28", "29", "30", "31",
)  # fmt: skip

MPI_INF_3DHP = (
    "spine3", "spine4", "spine2", "spine", "pelvis", "neck", "head", "head_top",
    "left_clavicle", "left_shoulder", "left_elbow", "left_wrist", "left_hand",
    "right_clavicle", "right_shoulder", "right_elbow", "right_wrist", "right_hand",
    "left_hip", "left_knee", "left_ankle", "left_foot", "left_toe",
    "right_hip", "right_knee", "right_ankle", "right_foot", "right_toe",
)  # fmt: skip

_LIMBS = ("shoulder", "elbow", "wrist", "hip", "knee", "ankle")
# The joint `head` is the base of the skull; the pelvis is ours, between the hips.
MPI_INF_3DHP_LANDMARKS: dict[str, tuple[str, ...]] = {
    "pelvis": ("left_hip", "right_hip"),
    "neck": ("neck",),
    "head": ("head_top",),
    **{f"{side}_{limb}": (f"{side}_{limb}",) for side in ("left", "right") for limb in _LIMBS},
}
