"""Clouds of coloured points as PLY."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from mocap.data.mesh import ColouredCloud
from mocap.io.formats._writing import PLY_COLOUR, PLY_POSITION, write_bytes


def write_cloud(path: Path, cloud: ColouredCloud) -> None:
    """Write a binary PLY in the world frame (metres, z up); a cloud without points gives a file without vertices.

    Raises MocapError when the file cannot be written.
    """
    points = np.empty(len(cloud.points), dtype=[("xyz", "<f4", 3), ("rgb", "u1", 3)])
    points["xyz"], points["rgb"] = cloud.points, cloud.rgb
    head = "ply\nformat binary_little_endian 1.0\ncomment mocap points, metres, z up\n"
    head += f"element vertex {len(points)}\n{PLY_POSITION}{PLY_COLOUR}end_header\n"
    write_bytes(path, head.encode("ascii") + points.tobytes())
