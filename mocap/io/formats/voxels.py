"""Coloured voxels of one frame for other tools: point cloud or cubes as PLY, cubes as glTF, everything as NPZ."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mocap.data import Hull
from mocap.io.formats._writing import ANIMATION_FROM_WORLD, PLY_COLOUR, PLY_POSITION, replacing, write_bytes
from mocap.io.formats.gltf import floats, glb_container

Array = NDArray[np.float64]
Colours = NDArray[np.uint8]

UNSEEN_GREY = 150  # colour of surface voxels that no camera sees
_ARRAY_BUFFER, _ELEMENT_BUFFER = 34962, 34963
_FLOAT, _UBYTE, _UINT = 5126, 5121, 5125

# The six sides of a cube: the step to the neighbour, and the corners, anticlockwise seen from outside.
_SIDES = (
    ((-1, 0, 0), ((0, 0, 0), (0, 0, 1), (0, 1, 1), (0, 1, 0))),
    ((1, 0, 0), ((1, 0, 0), (1, 1, 0), (1, 1, 1), (1, 0, 1))),
    ((0, -1, 0), ((0, 0, 0), (1, 0, 0), (1, 0, 1), (0, 0, 1))),
    ((0, 1, 0), ((0, 1, 0), (0, 1, 1), (1, 1, 1), (1, 1, 0))),
    ((0, 0, -1), ((0, 0, 0), (0, 1, 0), (1, 1, 0), (1, 0, 0))),
    ((0, 0, 1), ((0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1))),
)


def hull_colours(hull: Hull) -> Colours:
    """Colour (N, 3) of every voxel; grey where no camera sees it."""
    return np.where((hull.n_views > 0)[:, None], hull.rgb, np.uint8(UNSEEN_GREY))


def hull_quads(hull: Hull) -> tuple[Array, Array, Colours]:
    """The outside of the voxels as squares: corners (Q, 4, 3) m, world, normals (Q, 3), colours (Q, 3).

    Only faces between a voxel of the hull and an empty one; an empty hull gives Q = 0.
    """
    subs = hull.grid.subscripts(hull.voxels).astype(np.int64)
    if len(subs) == 0:
        return np.zeros((0, 4, 3)), np.zeros((0, 3)), np.zeros((0, 3), dtype=np.uint8)
    low = subs.min(axis=0) - 1
    filled = np.zeros(tuple(subs.max(axis=0) - low + 2), dtype=np.bool_)
    filled[tuple((subs - low).T)] = True
    colours = hull_colours(hull)
    corners, normals, rgb = [], [], []
    for step, side in _SIDES:
        is_open = ~filled[tuple((subs - low + step).T)]
        here = subs[is_open]
        corners.append(hull.grid.origin + (here[:, None] + np.array(side)) * hull.grid.voxel_size_m)
        normals.append(np.broadcast_to(np.array(step, dtype=np.float64), (len(here), 3)))
        rgb.append(colours[is_open])
    return np.concatenate(corners), np.concatenate(normals), np.concatenate(rgb)


def write_voxels_ply(path: Path, hull: Hull, *, cubes: bool = False) -> None:
    """Write a binary PLY in the world frame (metres, z up).

    cubes : false = the surface voxels' centres as points, with colour and the number of cameras that see them; true
    = the outer faces of all voxels as coloured squares. An empty hull gives a file without vertices.
    Raises MocapError when the file cannot be written.
    """
    size = hull.grid.voxel_size_m
    comment = f"comment mocap hull, metres, z up, voxels of {size:g} m\n"
    if cubes:
        corners, _, rgb = hull_quads(hull)
        vertices = np.empty(4 * len(corners), dtype=[("xyz", "<f4", 3), ("rgb", "u1", 3)])
        vertices["xyz"] = corners.reshape(-1, 3)
        vertices["rgb"] = np.repeat(rgb, 4, axis=0)
        faces = np.empty(len(corners), dtype=[("n", "u1"), ("corner", "<i4", 4)])
        faces["n"] = 4
        faces["corner"] = np.arange(4 * len(corners)).reshape(-1, 4)
        header = f"element vertex {len(vertices)}\n{PLY_POSITION}{PLY_COLOUR}"
        header += f"element face {len(faces)}\nproperty list uchar int vertex_indices\n"
        body = vertices.tobytes() + faces.tobytes()
    else:
        outer = hull.select(hull.is_surface)
        points = np.empty(len(outer), dtype=[("xyz", "<f4", 3), ("rgb", "u1", 3), ("views", "u1")])
        points["xyz"] = outer.centers
        points["rgb"] = hull_colours(outer)
        points["views"] = outer.n_views
        header = f"element vertex {len(points)}\n{PLY_POSITION}{PLY_COLOUR}property uchar n_views\n"
        body = points.tobytes()
    head = f"ply\nformat binary_little_endian 1.0\n{comment}{header}end_header\n"
    write_bytes(path, head.encode("ascii") + body)


def write_voxels_npz(path: Path, hull: Hull) -> None:
    """Write everything known of a hull: all voxels, also the interior, for numpy.load.

    Arrays: origin_m (3,), shape (3,), voxel_size_m (), voxels (N,) int32 linear indices, xyz_m (N, 3) float32
    centres, rgb (N, 3) uint8, n_views (N,) uint8 (0 = interior), is_surface (N,) bool.
    Raises MocapError when the file cannot be written.
    """
    with replacing(path) as temporary:
        np.savez_compressed(
            temporary,
            origin_m=hull.grid.origin,
            shape=np.array(hull.grid.shape),
            voxel_size_m=np.float64(hull.grid.voxel_size_m),
            voxels=hull.voxels,
            xyz_m=hull.centers.astype(np.float32),
            rgb=hull.rgb,
            n_views=hull.n_views,
            is_surface=hull.is_surface,
        )


def write_voxels_glb(path: Path, hull: Hull) -> None:
    """Write the outer faces of the voxels as binary glTF with vertex colours, metres, Y up.

    An empty hull gives a file with an empty scene. Raises MocapError when the file cannot be written.
    """
    corners, normals, rgb = hull_quads(hull)
    n = 4 * len(corners)
    asset = {
        "version": "2.0",
        "generator": "mocap",
        "extras": {"units": "m", "up_axis": "y", "voxel_size_m": float(hull.grid.voxel_size_m)},
    }
    if n == 0:
        write_bytes(path, glb_container({"asset": asset, "scene": 0, "scenes": [{}]}, b""))
        return
    positions = (corners.reshape(-1, 3) @ ANIMATION_FROM_WORLD.T).astype("<f4")
    directions = (np.repeat(normals, 4, axis=0) @ ANIMATION_FROM_WORLD.T).astype("<f4")
    # glTF wants linear light; the fourth byte keeps every element on a multiple of four.
    linear = np.round(255.0 * linear_from_srgb(rgb / 255.0)).astype(np.uint8)
    colours = np.full((n, 4), 255, dtype=np.uint8)
    colours[:, :3] = np.repeat(linear, 4, axis=0)
    triangles = (np.arange(0, n, 4)[:, None] + np.array([0, 1, 2, 0, 2, 3])).astype("<u4")
    blocks = [positions, directions, colours, triangles]
    offsets = np.cumsum([0, *(b.nbytes for b in blocks)])
    targets = (_ARRAY_BUFFER, _ARRAY_BUFFER, _ARRAY_BUFFER, _ELEMENT_BUFFER)
    bounds = {"min": floats(positions.min(axis=0)), "max": floats(positions.max(axis=0))}
    document: dict[str, Any] = {
        "asset": asset,
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"name": "hull", "mesh": 0}],
        "meshes": [
            {
                "name": "hull",
                "primitives": [
                    {"attributes": {"POSITION": 0, "NORMAL": 1, "COLOR_0": 2}, "indices": 3, "material": 0}
                ],
            }
        ],
        "materials": [
            {"name": "voxels", "pbrMetallicRoughness": {"metallicFactor": 0.0, "roughnessFactor": 1.0}}
        ],
        "accessors": [
            {"bufferView": 0, "componentType": _FLOAT, "count": n, "type": "VEC3", **bounds},
            {"bufferView": 1, "componentType": _FLOAT, "count": n, "type": "VEC3"},
            {"bufferView": 2, "componentType": _UBYTE, "normalized": True, "count": n, "type": "VEC4"},
            {"bufferView": 3, "componentType": _UINT, "count": triangles.size, "type": "SCALAR"},
        ],
        "bufferViews": [
            {"buffer": 0, "byteOffset": int(offset), "byteLength": block.nbytes, "target": target}
            for offset, block, target in zip(offsets, blocks, targets, strict=False)
        ],
        "buffers": [{"byteLength": int(offsets[-1])}],
    }
    write_bytes(path, glb_container(document, b"".join(b.tobytes() for b in blocks)))


def linear_from_srgb(values: Array) -> Array:
    """sRGB in [0, 1] -> linear light in [0, 1]."""
    return np.where(values <= 0.04045, values / 12.92, ((values + 0.055) / 1.055) ** 2.4)
