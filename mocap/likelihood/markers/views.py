"""Views of markers: cameras as ideal pinholes, and the detections of one frame in them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mocap.arrays import Array, Indices
from mocap.data.camera import Camera, CameraRig
from mocap.geometry.epipolar import fundamental_matrix

_SMALLEST_BOX_PX = 30.0
_BORDER_SAMPLES = 9  # points per side of a picture that tell how far it reaches without distortion


class Projections(NamedTuple):
    """Views as kernels take them.  P : (C, 3, 4), world (m) to undistorted px.  lower, upper : (C, 2) px."""

    P: Array
    lower: Array
    upper: Array


class Detections(NamedTuple):
    """Detections as kernels take them.  uv : (Q, 2) undistorted px, view by view.  first : (C + 1,) where a view
    starts."""

    uv: Array
    first: Indices


@dataclass(frozen=True, eq=False)
class MarkerViews:
    """What the likelihood needs of the cameras: ideal pinholes, without distortion.

    P : (C, 3, 4), world (m) to undistorted px.  lower, upper : (C, 2) px, bounds of the undistorted picture.
    F : (C, C, 3, 3), a point of view i times F[i, j] is its epipolar line in view j.  is_pair : (C, C) bool, whether
    two views have epipolar geometry (two cameras in one place have none).
    """

    rig: CameraRig
    P: Array
    lower: Array
    upper: Array
    F: Array
    is_pair: NDArray[np.bool_]

    @property
    def n_views(self) -> int:
        return len(self.P)

    @property
    def projections(self) -> Projections:
        """The views as kernels take them."""
        return Projections(self.P, self.lower, self.upper)

    @cached_property
    def focal(self) -> Array:
        """Mean focal length of each view, (C,) px."""
        return np.array([0.5 * (c.K[0, 0] + c.K[1, 1]) for c in self.rig])


def marker_views(rig: CameraRig) -> MarkerViews:
    """Projection and epipolar geometry of a rig for undistorted pixels."""
    C = len(rig)
    P, lower, upper = np.zeros((C, 3, 4)), np.zeros((C, 2)), np.zeros((C, 2))
    F, is_pair = np.zeros((C, C, 3, 3)), np.zeros((C, C), dtype=np.bool_)
    for c, camera in enumerate(rig):
        P[c] = camera.K @ np.column_stack([camera.R, camera.t])
        border = undistort(camera, _border(camera))
        lower[c], upper[c] = np.nanmin(border, axis=0), np.nanmax(border, axis=0)
    for i, a in enumerate(rig):
        for j, b in enumerate(rig):
            if i != j and np.linalg.norm(a.center - b.center) > 1e-9:
                F[i, j] = fundamental_matrix(a.K, a.R, a.t, b.K, b.R, b.t)
                is_pair[i, j] = True
    return MarkerViews(rig, P, lower, upper, F, is_pair)


def undistort(camera: Camera, uv: Array) -> Array:
    """Pixels uv (N, 2) as an ideal pinhole camera of the same K would see them, (N, 2); NaN beyond 90 degrees."""
    direction = camera.rays(uv) @ camera.R.T
    with np.errstate(divide="ignore", invalid="ignore"):
        normalised = np.where(direction[:, 2:] > 1e-6, direction[:, :2] / direction[:, 2:], np.nan)
    return normalised @ camera.K[:2, :2].T + camera.K[:2, 2]


def _border(camera: Camera) -> Array:
    """Points along the border of a picture, (N, 2) px."""
    w, h = camera.size
    u, v = np.linspace(-0.5, w - 0.5, _BORDER_SAMPLES), np.linspace(-0.5, h - 0.5, _BORDER_SAMPLES)
    sides = [(u, np.full_like(u, y)) for y in (-0.5, h - 0.5)] + [
        (np.full_like(v, x), v) for x in (-0.5, w - 0.5)
    ]
    return np.concatenate([np.column_stack(side) for side in sides])


@dataclass(frozen=True, eq=False)
class MarkerObservation:
    """The detections of one frame.  uv : (Q, 2) undistorted px, view by view.  first : (C + 1,) where a view starts."""

    views: MarkerViews
    uv: Array
    first: Indices

    @property
    def detections(self) -> Detections:
        """The detections as kernels take them."""
        return Detections(self.uv, self.first)

    def of_view(self, c: int) -> Array:
        """Detections of one view, (n, 2) undistorted px."""
        return self.uv[self.first[c] : self.first[c + 1]]

    @cached_property
    def density(self) -> Array:
        """Detections per square pixel of the box that holds them, in each view, (C,)."""
        out = np.empty(self.views.n_views)
        for c in range(len(out)):
            uv = self.of_view(c)
            extent = np.maximum(np.ptp(uv, axis=0), _SMALLEST_BOX_PX) if len(uv) else np.ones(2)
            out[c] = max(len(uv), 1) / float(extent.prod())
        return out

    def worth(self, noise_px: float) -> Array:
        """Nats that a detection right at a marker is worth in each view, (C,): its density there over that of all
        detections, which may all be false. Between 0.5 and 6."""
        return np.clip(-np.log(2 * np.pi * noise_px**2 * self.density), 0.5, 6.0)


def observe(views: MarkerViews, detections: Sequence[Array]) -> MarkerObservation:
    """Detections of one frame, one (n, 2) array of raw pixels per camera, made ready for the likelihood.

    Detections that are NaN or that no pinhole sees are left out.
    Raises ValueError for a wrong number of cameras or shape.
    """
    if len(detections) != views.n_views:
        raise ValueError(f"detections of {len(detections)} cameras, the rig has {views.n_views}")
    kept = []
    for camera, uv in zip(views.rig, detections, strict=True):
        if np.ndim(uv) != 2 or np.shape(uv)[1] != 2:
            raise ValueError(f"camera {camera.name}: detections have shape {np.shape(uv)}, expected (n, 2)")
        ideal = undistort(camera, np.asarray(uv, dtype=np.float64))
        kept.append(ideal[np.isfinite(ideal).all(axis=1)])
    first = np.concatenate([[0], np.cumsum([len(k) for k in kept])]).astype(np.int64)
    return MarkerObservation(views, np.ascontiguousarray(np.concatenate(kept)), first)
