"""Motion in the formats of other tools, one module each that reads and writes.

Every file is written whole or not at all, and the same input gives the same bytes.
"""

from mocap.io.formats.bids import write_bids_motion
from mocap.io.formats.bone_names import BONE_NAMES, BoneNames, renamed
from mocap.io.formats.bvh import write_bvh
from mocap.io.formats.c3d import Event, write_c3d
from mocap.io.formats.cloud import write_cloud
from mocap.io.formats.gltf import write_glb
from mocap.io.formats.marker_names import MARKER_NAMES, MarkerNames, marker_names
from mocap.io.formats.mesh import write_mesh
from mocap.io.formats.mot import write_mot
from mocap.io.formats.movement import write_movement
from mocap.io.formats.readers import read_poses
from mocap.io.formats.table import PoseFile, PoseTable
from mocap.io.formats.trc import write_trc
from mocap.io.formats.usd import write_usd

# What a reader must know of each format and what TRC, BVH and C3D have no agreed field for.
EXPORT_CONVENTIONS: dict[str, dict[str, str]] = {
    ".trc": {"units": "m", "up_axis": "y", "scene_xyz_is": "z, x, y of the file"},
    ".c3d": {"units": "mm", "up_axis": "z", "scene_xyz_is": "x, y, z of the file"},
    ".bvh": {"units": "cm", "up_axis": "y", "scene_xyz_is": "x, -z, y of the file"},
    ".glb": {"units": "m", "up_axis": "y", "scene_xyz_is": "x, -z, y of the file"},
}

__all__ = [
    "BONE_NAMES",
    "EXPORT_CONVENTIONS",
    "MARKER_NAMES",
    "BoneNames",
    "Event",
    "MarkerNames",
    "PoseFile",
    "PoseTable",
    "marker_names",
    "read_poses",
    "renamed",
    "write_bids_motion",
    "write_bvh",
    "write_c3d",
    "write_cloud",
    "write_glb",
    "write_mesh",
    "write_mot",
    "write_movement",
    "write_trc",
    "write_usd",
]
