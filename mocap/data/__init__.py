"""Frozen containers that every stage speaks."""

from mocap.data.camera import Camera, CameraRig
from mocap.data.motion import BONES, LANDMARKS, Motion, Tracks
from mocap.data.problem import ArticulatedProblem, ResidualProblem, StateLayout
from mocap.data.skeleton import Skeleton
from mocap.data.voxels import Hull, VoxelGrid

__all__ = [
    "BONES",
    "LANDMARKS",
    "ArticulatedProblem",
    "Camera",
    "CameraRig",
    "Hull",
    "Motion",
    "ResidualProblem",
    "Skeleton",
    "StateLayout",
    "Tracks",
    "VoxelGrid",
]
