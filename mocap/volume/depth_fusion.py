"""One surface from what several depth cameras measure of a room (Open3D's truncated signed distances)."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from mocap.data.mesh import ColouredMesh
from mocap.volume._open3d import require_open3d
from mocap.volume.measured_room import RoomView

# A reading speaks about so many voxels before and behind it: three deviations of one look 4 m away.
_TRUNCATION_VOXELS = 4.0
_FARTHEST_M = 20.0
_BLOCK_VOXELS, _N_BLOCKS = 8, 10_000  # 100 MB to begin with; it grows
_LEAST_WEIGHT = 0.5  # what one view has measured is there


def fused_surface(views: Sequence[RoomView], *, voxel_m: float = 0.02) -> ColouredMesh:
    """The surface that the views (of one moment, or of a room that stands still) have measured together.

    What no view has measured is a hole. Views without readings give an empty mesh.
    Source: Curless and Levoy, "A volumetric method for building complex models from range images" (1996).
    Raises MissingExtra without Open3D.
    """
    o3d = require_open3d("fusing depth maps")
    number = o3d.core.float32
    volume = o3d.t.geometry.VoxelBlockGrid(
        attr_names=("tsdf", "weight", "color"),
        attr_dtypes=(number, number, number),
        attr_channels=(1, 1, 3),
        voxel_size=voxel_m,
        block_resolution=_BLOCK_VOXELS,
        block_count=_N_BLOCKS,
    )
    for view in views:
        straight = _without_distortion(view)
        if not straight.depth_m.any():
            continue
        depth = o3d.t.geometry.Image(o3d.core.Tensor(np.ascontiguousarray(straight.depth_m)))
        rgb = o3d.t.geometry.Image(o3d.core.Tensor((straight.rgb / 255.0).astype(np.float32)))
        T_cam_world = np.eye(4)
        T_cam_world[:3, :3], T_cam_world[:3, 3] = view.camera.R, view.camera.t
        K_corner = view.camera.K.copy()
        K_corner[:2, 2] += 0.5  # Open3D cuts pixels off where we round them
        K, T = o3d.core.Tensor(K_corner), o3d.core.Tensor(T_cam_world)
        reach = 1.0, _FARTHEST_M, _TRUNCATION_VOXELS
        blocks = volume.compute_unique_block_coordinates(depth, K, T, *reach)
        volume.integrate(blocks, depth, rgb, K, K, T, *reach)
    if not len(volume.hashmap().active_buf_indices()):
        return ColouredMesh(
            np.zeros((0, 3)), np.zeros((0, 3), dtype=np.int64), np.zeros((0, 3), dtype=np.uint8)
        )
    mesh = volume.extract_triangle_mesh(_LEAST_WEIGHT).to_legacy()
    rgb_srgb = np.rint(255.0 * np.asarray(mesh.vertex_colors)).astype(np.uint8).reshape(-1, 3)
    vertices = np.asarray(mesh.vertices, dtype=np.float64).reshape(-1, 3)
    return ColouredMesh(vertices, np.asarray(mesh.triangles, dtype=np.int64).reshape(-1, 3), rgb_srgb)


def _without_distortion(view: RoomView) -> RoomView:
    """The view as a pinhole camera of the same K would have it; depth along the optical axis stays as it is."""
    camera = view.camera
    maker = cv2.fisheye.initUndistortRectifyMap if camera.is_fisheye else cv2.initUndistortRectifyMap
    u, v = maker(camera.K, camera.dist, np.eye(3), camera.K, camera.size, cv2.CV_32FC1)
    depth = cv2.remap(view.depth_m, u, v, cv2.INTER_NEAREST, borderValue=0)
    return RoomView(camera, depth, cv2.remap(view.rgb, u, v, cv2.INTER_LINEAR))
