"""Frozen containers that every stage speaks."""

from mocap.data.angles import AngleSeries
from mocap.data.camera import Camera, CameraRig
from mocap.data.hierarchy import Hierarchy, Level, Limb
from mocap.data.mesh import ColouredMesh
from mocap.data.motion import (
    ALL_LANDMARKS,
    BONES,
    FURTHER_LANDMARKS,
    LANDMARKS,
    Motion,
    Tracks,
    bones_between,
    landmark_names,
)
from mocap.data.occluders import Occluders, n_judges
from mocap.data.problem import ArticulatedProblem, ResidualProblem, StateLayout
from mocap.data.skeleton import Skeleton
from mocap.data.skin import Skin
from mocap.data.voxels import Hull, VoxelGrid

__all__ = [
    "ALL_LANDMARKS",
    "BONES",
    "FURTHER_LANDMARKS",
    "LANDMARKS",
    "AngleSeries",
    "ArticulatedProblem",
    "Camera",
    "CameraRig",
    "ColouredMesh",
    "Hierarchy",
    "Hull",
    "Level",
    "Limb",
    "Motion",
    "Occluders",
    "ResidualProblem",
    "Skeleton",
    "Skin",
    "StateLayout",
    "Tracks",
    "VoxelGrid",
    "bones_between",
    "landmark_names",
    "n_judges",
]
