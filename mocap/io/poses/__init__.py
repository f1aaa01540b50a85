"""Motion that other tools wrote: TRC, C3D, BVH, CSV and CMU Panoptic JSON, as named points and as our landmarks."""

from mocap.io.poses.maps import AXES, UNITS, SideMap, read_map, skeletons_known
from mocap.io.poses.motions import Reading, read_motions
from mocap.io.poses.readers import read_poses
from mocap.io.poses.table import PoseFile, PoseTable

__all__ = [
    "AXES",
    "UNITS",
    "PoseFile",
    "PoseTable",
    "Reading",
    "SideMap",
    "read_map",
    "read_motions",
    "read_poses",
    "skeletons_known",
]
