"""Coloured meshes as PLY or binary glTF, through trimesh."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from mocap.data import ColouredMesh
from mocap.errors import MissingExtra
from mocap.io.formats._writing import ANIMATION_FROM_WORLD, write_bytes
from mocap.io.formats.gltf import glb_container
from mocap.io.formats.voxels import linear_from_srgb


def write_mesh(path: Path, mesh: ColouredMesh) -> None:
    """Write a mesh as its path's suffix says: .ply in the world (metres, z up), .glb with Y up and linear colours.

    An empty mesh gives an empty PLY, and a GLB without a mesh. Raises MissingExtra without trimesh, MocapError when the
    file cannot be written.
    """
    try:
        import trimesh
    except ImportError as error:
        raise MissingExtra(
            "writing meshes needs the package trimesh, which is not installed", "export", path=path
        ) from error
    is_glb = path.suffix == ".glb"
    rgb = np.round(255.0 * linear_from_srgb(mesh.rgb / 255.0)).astype(np.uint8) if is_glb else mesh.rgb
    vertices = mesh.vertices @ ANIMATION_FROM_WORLD.T if is_glb else mesh.vertices
    solid = trimesh.Trimesh(vertices, mesh.faces, vertex_colors=rgb, process=False)
    if is_glb:
        # trimesh writes no scene without a mesh.
        empty = {"asset": {"version": "2.0"}, "scene": 0, "scenes": [{}]}
        data = (
            trimesh.Scene({"hull": solid}).export(file_type="glb", include_normals=True)
            if len(mesh.faces)
            else glb_container(empty, b"")
        )
    else:
        data = trimesh.exchange.ply.export_ply(solid, encoding="binary", vertex_normal=False)
    write_bytes(path, data)
