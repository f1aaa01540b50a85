"""Lenses: which terms of distortion are solved for, and the projection of points with its derivatives."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from mocap.arrays import Array
from mocap.data import Camera, CameraRig

LensModel = Literal["radial", "tangential", "fisheye"]
# Distortion coefficients in OpenCV's order, and which of them each model frees.  A third radial term takes up noise on
# boards that fill part of the picture.
_FREE: dict[LensModel, tuple[int, ...]] = {
    "radial": (0, 1),
    "tangential": (0, 1, 2, 3),
    "fisheye": (0, 1, 2, 3),
}
MODELS: tuple[LensModel, ...] = tuple(_FREE)
_N_DIST = 5


@dataclass(frozen=True, eq=False)
class Lens:
    """K : (3, 3) px.  dist : (n,) in the order of OpenCV, of its fisheye model where `is_fisheye`.  size : px."""

    size: tuple[int, int]
    K: Array
    dist: Array
    is_fisheye: bool = False

    @classmethod
    def of(cls, camera: Camera) -> Lens:
        """The lens of a calibrated camera."""
        n = max(4 if camera.is_fisheye else _N_DIST, len(camera.dist))
        return cls(
            camera.size, camera.K.copy(), np.pad(camera.dist, (0, n - len(camera.dist))), camera.is_fisheye
        )

    def moved(self, step: Array, model: LensModel) -> Lens:
        """With fx, fy, cx, cy and the free coefficients changed by a step (4 + n_free,)."""
        K, dist = self.K.copy(), self.dist.copy()
        K[[0, 1, 0, 1], [0, 1, 2, 2]] += step[:4]
        dist[list(_FREE[model])] += step[4:]
        return Lens(self.size, K, dist, self.is_fisheye)


def rig_of_lenses(lenses: Mapping[str, Lens]) -> CameraRig:
    """Cameras that stand in a row, a metre apart, which means nothing: for what only asks for lenses."""
    return CameraRig(
        tuple(
            Camera(name, lens.size, lens.K, lens.dist, np.eye(3), np.array([float(k), 0, 0]), lens.is_fisheye)
            for k, (name, lens) in enumerate(lenses.items())
        )
    )


def n_free(model: LensModel) -> int:
    """Numbers of a lens that are solved for: two focal lengths, the centre, distortion."""
    return 4 + len(_FREE[model])


def project(
    points: Array, pose: tuple[Array, Array], lens: Lens, model: LensModel
) -> tuple[Array, Array, Array]:
    """Pixels of points (N, 3) m and their derivatives by the pose and by the lens.

    pose : rotation vector and translation (3,) m to the camera.
    Returns uv (N, 2) px, by the pose (2N, 6), by the lens's free numbers (2N, n_free).
    """
    rotation, translation = pose
    if lens.is_fisheye:
        uv, J = cv2.fisheye.projectPoints(points[None], rotation, translation, lens.K, lens.dist[:4])
        by_pose, by_lens = J[:, 8:14], J[:, :8]
    else:
        uv, J = cv2.projectPoints(points, rotation, translation, lens.K, lens.dist)
        by_pose, by_lens = J[:, :6], J[:, 6:]
    free = [0, 1, 2, 3, *(4 + k for k in _FREE[model])]
    return uv.reshape(-1, 2), by_pose, by_lens[:, free]


def lens_from_views(
    size: tuple[int, int], points: Sequence[Array], pixels: Sequence[Array], model: LensModel
) -> Lens:
    """The lens of one camera alone from its views of a flat board.

    points : (N, 3) m and pixels : (N, 2) px of each view.  Raises cv2.error where there is no solution.
    """
    board = [p.astype(np.float32)[:, None] for p in points]
    seen = [uv.astype(np.float32)[:, None] for uv in pixels]
    if model == "fisheye":
        board, seen = [p.reshape(1, -1, 3) for p in board], [uv.reshape(1, -1, 2) for uv in seen]
        K, dist = _first_fisheye(size), np.zeros((4, 1))
        flags = cv2.CALIB_RECOMPUTE_EXTRINSIC | cv2.CALIB_FIX_SKEW | cv2.CALIB_USE_INTRINSIC_GUESS
        _, K, dist, *_ = cv2.fisheye.calibrate(board, seen, size, K, dist, flags=flags)
        return Lens(size, np.array(K), np.ravel(dist).astype(np.float64), is_fisheye=True)
    flags = cv2.CALIB_FIX_K3 | (0 if model == "tangential" else cv2.CALIB_ZERO_TANGENT_DIST)
    _, K, dist, *_ = cv2.calibrateCamera(board, seen, size, None, None, flags=flags)
    return Lens(size, np.array(K, dtype=np.float64), np.ravel(dist).astype(np.float64)[:_N_DIST])


def _first_fisheye(size: tuple[int, int]) -> Array:
    """A lens that sees 120 degrees across, from which the search starts."""
    focal = size[0] / np.deg2rad(120.0)
    return np.array([[focal, 0, size[0] / 2], [0, focal, size[1] / 2], [0, 0, 1]], dtype=np.float64)


def undistorted(lens: Lens, uv: Array) -> NDArray[np.float64]:
    """Pixels (N, 2) as a camera of the same K without distortion would see them."""
    flat = uv.reshape(-1, 1, 2)
    undo = cv2.fisheye.undistortPoints if lens.is_fisheye else cv2.undistortPoints
    dist = lens.dist[:4] if lens.is_fisheye else lens.dist
    return np.asarray(undo(flat, lens.K, dist, P=lens.K), dtype=np.float64).reshape(-1, 2)
