"""A calibrated camera and a rig of them, found by name."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from mocap.arrays import Array
from mocap.geometry.epipolar import fundamental_matrix
from mocap.geometry.projection import project_points, rays_from_pixels


@dataclass(frozen=True, eq=False)
class Camera:
    """Pinhole or fisheye camera; R, t map world to camera (T_cam_world).

    size : (width, height) px.  K : (3, 3) px.  dist : (n,) OpenCV order k1, k2, p1, p2[, k3 ...], or k1..k4
    of the fisheye model.  R : (3, 3).  t : (3,) m.  filmed_size : (width, height) px of its pictures in files, of which
    squares of whole pixels become one; None = `size`.
    Raises ValueError for wrong shapes, non-finite numbers, a singular K or an R that is no rotation.
    """

    name: str
    size: tuple[int, int]
    K: Array
    dist: Array
    R: Array
    t: Array
    is_fisheye: bool = False
    filmed_size: tuple[int, int] | None = None

    def __post_init__(self) -> None:
        for attr, shape in (("K", (3, 3)), ("R", (3, 3)), ("t", (3,))):
            value = np.array(getattr(self, attr), dtype=np.float64)
            if value.shape != shape:
                raise ValueError(f"camera {self.name}: {attr} has shape {value.shape}, expected {shape}")
            object.__setattr__(self, attr, value)
        object.__setattr__(self, "dist", np.array(self.dist, dtype=np.float64).ravel())
        object.__setattr__(self, "size", (int(self.size[0]), int(self.size[1])))
        for attr in ("K", "dist", "R", "t"):
            value = getattr(self, attr)
            if not np.all(np.isfinite(value)):
                raise ValueError(f"camera {self.name}: {attr} holds a number that is not finite")
            value.flags.writeable = False
        if min(self.size) <= 0:
            raise ValueError(f"camera {self.name}: size {self.size} is not positive")
        if abs(np.linalg.det(self.K)) < 1e-9 or min(self.K[0, 0], self.K[1, 1]) <= 0:
            raise ValueError(f"camera {self.name}: matrix is singular or has a focal length <= 0")
        if np.abs(self.R @ self.R.T - np.eye(3)).max() > 1e-3 or np.linalg.det(self.R) < 0:
            raise ValueError(f"camera {self.name}: R is not a rotation (det {np.linalg.det(self.R):.3f})")

    @cached_property
    def center(self) -> Array:
        """Optical centre in the world frame, (3,) m."""
        return -self.R.T @ self.t

    def reduced(self, factor: int) -> Camera:
        """The camera of a picture of which each square of factor x factor pixels became one."""
        K = self.K.copy()
        K[:2] /= factor
        K[:2, 2] += 0.5 / factor - 0.5
        size = self.size[0] // factor, self.size[1] // factor
        return replace(self, K=K, size=size, filmed_size=self.filmed_size or self.size)

    def project(self, points_world: Array) -> tuple[Array, Array]:
        """uv (..., 2) px and depth (...,) m of points_world (..., 3) m; NaN where not visible by geometry."""
        return project_points(points_world, self.K, self.dist, self.R, self.t, is_fisheye=self.is_fisheye)

    def rays(self, uv: Array) -> Array:
        """Unit directions (..., 3), world, through pixels uv (..., 2)."""
        return rays_from_pixels(uv, self.K, self.dist, self.R, is_fisheye=self.is_fisheye)

    def unproject(self, uv: Array, depth: Array) -> Array:
        """World points (..., 3) m at pixels uv (..., 2) and depths (...,) m along the optical axis."""
        directions = self.rays(uv)
        along_axis = directions @ self.R[2]
        return self.center + directions * (np.asarray(depth) / along_axis)[..., None]

    def contains(self, uv: Array) -> NDArray[np.bool_]:
        """Whether pixels uv (..., 2) fall inside the picture; NaN gives False."""
        w, h = self.size
        with np.errstate(invalid="ignore"):
            u, v = uv[..., 0], uv[..., 1]
            return (u >= -0.5) & (u < w - 0.5) & (v >= -0.5) & (v < h - 0.5)


@dataclass(frozen=True, eq=False)
class CameraRig:
    """Cameras in a fixed order, found by name: rig["cam_3"], rig[3], len(rig), for camera in rig."""

    cameras: tuple[Camera, ...]
    _index: dict[str, int] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "cameras", tuple(self.cameras))
        names = [c.name for c in self.cameras]
        if not names:
            raise ValueError("a rig needs at least one camera")
        doubled = sorted({n for n in names if names.count(n) > 1})
        if doubled:
            raise ValueError(f"camera names are not unique: {', '.join(doubled)}")
        object.__setattr__(self, "_index", {n: i for i, n in enumerate(names)})

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(c.name for c in self.cameras)

    def __len__(self) -> int:
        return len(self.cameras)

    def __iter__(self) -> Iterator[Camera]:
        return iter(self.cameras)

    def __getitem__(self, key: str | int) -> Camera:
        if isinstance(key, str):
            if key not in self._index:
                raise KeyError(f"no camera named {key!r}; the rig has {', '.join(self.names)}")
            return self.cameras[self._index[key]]
        return self.cameras[key]

    def subset(self, names: Sequence[str]) -> CameraRig:
        """A rig of the named cameras in the given order."""
        return CameraRig(tuple(self[n] for n in names))

    def fundamental(self, a: str, b: str) -> Array:
        """F (3, 3) with x_b^T F x_a = 0 for undistorted pixels of cameras a and b."""
        ca, cb = self[a], self[b]
        return fundamental_matrix(ca.K, ca.R, ca.t, cb.K, cb.R, cb.t)
