"""Names of bones as other rigs have them, so that a motion falls onto a character without a table of names."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal, get_args

import numpy as np

from mocap.data import Skeleton

BoneNames = Literal["mocap", "mixamo", "vrm", "unreal"]
BONE_NAMES: tuple[BoneNames, ...] = get_args(BoneNames)

# Joint -> name in Mixamo's rigs, of the VRM 1.0 humanoid, of Unreal's mannequin.  Our joint moves the bone below it.
_TRUNK = {
    "root": ("mixamorig:Hips", "hips", "pelvis"),
    "waist": ("mixamorig:Spine", "spine", "spine_01"),
    "thorax": ("mixamorig:Spine1", "chest", "spine_02"),
    "neck": ("mixamorig:Neck", "neck", "neck_01"),
}
# The same for one side: of the right, then the left.
_SIDE = {
    "clavicle": ("mixamorig:{Side}Shoulder", "{side}Shoulder", "clavicle_{s}"),
    "shoulder": ("mixamorig:{Side}Arm", "{side}UpperArm", "upperarm_{s}"),
    "elbow": ("mixamorig:{Side}ForeArm", "{side}LowerArm", "lowerarm_{s}"),
    "wrist": ("mixamorig:{Side}Hand", "{side}Hand", "hand_{s}"),
    "hip": ("mixamorig:{Side}UpLeg", "{side}UpperLeg", "thigh_{s}"),
    "knee": ("mixamorig:{Side}Leg", "{side}LowerLeg", "calf_{s}"),
    "ankle": ("mixamorig:{Side}Foot", "{side}Foot", "foot_{s}"),
    "mtp": ("mixamorig:{Side}ToeBase", "{side}Toes", "ball_{s}"),
}


def renamed(skeleton: Skeleton, bones: BoneNames) -> Skeleton:
    """The skeleton with its joints called as in another rig; joints that it has no name for keep theirs.

    Other rigs have no bone that turns a forearm about its length: their hands take the turn.
    """
    if bones == "mocap":
        return skeleton
    rotations = skeleton.rotations.copy()
    for j, name in enumerate(skeleton.names):
        if name in ("left_forearm", "right_forearm"):
            for child in np.flatnonzero(skeleton.parents == j):
                rotations[:, child] = rotations[:, j] @ rotations[:, child]
            rotations[:, j] = np.eye(3)
    column = BONE_NAMES.index(bones) - 1
    names = {joint: own[column] for joint, own in _TRUNK.items()}
    for side in ("right", "left"):
        for joint, own in _SIDE.items():
            words = {"Side": side.title(), "side": side, "s": side[0]}
            names[f"{side}_{joint}"] = own[column].format(**words)
    named = tuple(names.get(name, name) for name in skeleton.names)
    return replace(skeleton, names=named, rotations=rotations)
