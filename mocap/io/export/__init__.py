"""Motion in the formats of other tools; every file is written whole or not at all, same input same bytes."""

from mocap.io.export.bvh import write_bvh
from mocap.io.export.c3d import write_c3d
from mocap.io.export.gltf import write_glb
from mocap.io.export.trc import write_trc

# What a reader must know of each format and what TRC, BVH and C3D have no agreed field for.
EXPORT_CONVENTIONS: dict[str, dict[str, str]] = {
    ".trc": {"units": "m", "up_axis": "y", "scene_xyz_is": "z, x, y of the file"},
    ".c3d": {"units": "mm", "up_axis": "z", "scene_xyz_is": "x, y, z of the file"},
    ".bvh": {"units": "cm", "up_axis": "y", "scene_xyz_is": "z, x, y of the file"},
    ".glb": {"units": "m", "up_axis": "y", "scene_xyz_is": "z, x, y of the file"},
}

__all__ = ["EXPORT_CONVENTIONS", "write_bvh", "write_c3d", "write_glb", "write_trc"]
