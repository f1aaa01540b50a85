"""Distance between the posed flesh and the outlines of the silhouettes, as residuals for a second-order refinement.

The hull is larger than the body, the more so when a camera may be wrong; the outlines are not.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cache, cached_property, lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from mocap.arrays import Array, Image, Mask
from mocap.body.flesh import LookUpTable
from mocap.body.kinematics import cones_of, distance_of_lines
from mocap.body.model import Body
from mocap.data.camera import Camera, CameraRig
from mocap.data.problem import StateLayout
from mocap.geometry._pixel_kernels import are_near, extent_of, pixels_of_points
from mocap.likelihood.residuals._outline_kernels import (
    Crops,
    OutlinePull,
    OutlineTerms,
    Pinholes,
    Rays,
    are_inside,
    nearest_of_labels,
    outline_equations,
    rays_through,
    slopes_at,
)
from mocap.likelihood.residuals._pull_kernels import FleshPoints
from mocap.likelihood.residuals.surface import flesh_sample

_MARGIN_PX = 24  # of the crop around a person
_BORDER_PX = 3  # outlines nearer to the picture's border may be cut off
_MIN_OUTLINE_PX = 12
_EDGE_KERNEL = np.ones(
    (17, 17), dtype=np.uint8
)  # the edge of what hides people is known to two cells of 4 px
_SOFT_PX = 2.0  # standard deviation of the blur under which an outline has a direction
_LEAST_SLOPE = 1e-3  # of eight pixels, as Sobel counts
_NEAR_PX = 9  # how far from the projected hull an outline may still be the person's


def _soft_slope(std_px: float) -> tuple[Array, Array]:
    """Weights of neighbours that blur a row of pixels, and those that give the slope of the blurred row: a Gaussian
    and Sobel's masks upon it."""
    reach = np.arange(-round(4 * std_px), round(4 * std_px) + 1)
    weight = np.exp(-0.5 * (reach / std_px) ** 2)
    weight /= weight.sum()
    return np.convolve(weight, [1.0, 2.0, 1.0]), np.convolve(weight, [1.0, 0.0, -1.0])[::-1].copy()


_SOFT_SLOPE = _soft_slope(_SOFT_PX)


@dataclass(frozen=True)
class OutlineFitSettings:
    """How outlines and flesh pull each other."""

    n_outline_points: int = 110
    """Outline points per camera, evenly thinned out."""
    n_flesh_points: int = 250
    """Flesh surface points tested in every camera for lying outside the silhouette."""
    scale_m: float = 0.04
    """Residual at which an outline point loses three quarters of its pull (Geman-McClure)."""
    flesh_scale_m: float = 0.06
    normal_cost_m: float = 0.06
    """Distance that opposite normals are worth when the touching cone is chosen."""
    flesh_gain: float = 0.5
    """Total weight of the flesh points against that of the outline points."""


@dataclass(frozen=True, eq=False)
class PinholeView:
    """A camera without its distortion: masks are resampled once, then everything is a plain pinhole.

    source : (H, W) which pixel of the real picture, row after row, each pixel shows, or None without distortion.
    inside : (H, W) bool, pixels that the real picture covers; others have source 0.
    """

    camera: Camera
    source: NDArray[np.intp] | None
    inside: Mask

    def undistort(self, mask: Mask, window: tuple[slice, slice] | None = None) -> NDArray[np.uint8]:
        """A mask (H, W) as the pinhole sees it, 0 or 1.  window : rows and columns wanted, None = all."""
        image = mask.view(np.uint8)
        wanted = window or (slice(None), slice(None))
        if self.source is None:
            return image[wanted]
        return image.ravel().take(self.source[wanted]) & self.inside[wanted].view(np.uint8)

    def picture(self, image: Image, window: tuple[slice, slice]) -> tuple[Image, Mask]:
        """A window of a picture (H, W, 3) as the pinhole sees it, and which of its pixels the real picture covers."""
        if self._places is None:
            return image[window], self.inside[window]
        shown = cv2.remap(image, self._places[window], None, cv2.INTER_NEAREST)
        return np.asarray(shown, dtype=np.uint8), self.inside[window]

    @cached_property
    def _places(self) -> NDArray[np.int16] | None:
        """`source` as columns and rows, (H, W, 2)."""
        if self.source is None:
            return None
        row, column = np.divmod(self.source, self.source.shape[1])
        return np.stack([column, row], axis=-1).astype(np.int16)


def pinhole_view(camera: Camera) -> PinholeView:
    """The ideal pinhole of a camera: same matrix, size and place, no distortion."""
    width, height = camera.size
    if not np.any(camera.dist):
        return PinholeView(camera, None, np.ones((height, width), dtype=np.bool_))
    if camera.is_fisheye:
        dist = np.zeros(4)
        dist[: min(4, len(camera.dist))] = camera.dist[:4]
        maps = cv2.fisheye.initUndistortRectifyMap(
            camera.K, dist, np.eye(3), camera.K, camera.size, cv2.CV_32FC1
        )
    else:
        maps = cv2.initUndistortRectifyMap(camera.K, camera.dist, None, camera.K, camera.size, cv2.CV_32FC1)
    column, row = (np.rint(m).astype(np.intp) for m in maps)
    inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
    return PinholeView(camera, np.where(inside, row * width + column, 0), inside)


@dataclass(frozen=True, eq=False)
class Outlines:
    """One person's outlines in one frame.

    origins, directions, normals : (M, 3) rays through outline points, and the outward normal of the outline turned
    into the world, unit length, orthogonal to the ray.  camera : (M,) index.
    nearest, first, shape, corner : nearest silhouette pixel of every pixel of each camera's crop, as the kernel
    `body_to_silhouettes` takes it; a camera without a usable silhouette has shape (0, 0).
    """

    rig: CameraRig
    origins: Array
    directions: Array
    normals: Array
    camera: NDArray[np.int64]
    nearest: NDArray[np.int32]
    first: NDArray[np.int64]
    shape: NDArray[np.int64]
    corner: NDArray[np.int64]

    @property
    def n_points(self) -> int:
        return len(self.origins)

    @property
    def n_cameras(self) -> int:
        """Cameras with a usable silhouette."""
        return int(np.count_nonzero(self.shape[:, 0]))


def person_outlines(
    views: Sequence[PinholeView],
    rig: CameraRig,
    masks: Sequence[Mask],
    hull_points: Array,
    other_points: Array | None = None,
    *,
    n_points: int,
    is_whole: Sequence[bool] | NDArray[np.bool_] | None = None,
    hidden: Sequence[Mask | None] | None = None,
) -> Outlines:
    """Outlines of one person in all cameras.

    masks : one (H, W) bool per camera.  hull_points : (N, 3) m, surface of the person's hull: only outlines near its
    projection count.  other_points : (K, 3) m, hulls of the other persons: outlines near theirs do not.
    n_points : outline points per camera.  is_whole : cameras whose mask can be trusted; None = all.  hidden : per
    camera (H, W) bool, pixels in which the person would not be seen, or None; a silhouette that ends there ends at what
    hides him, and nobody is pulled out of there.
    """
    parts: list[tuple[Array, Array, Array, NDArray[np.int64]]] = []
    nearest: list[NDArray[np.int32]] = []
    first, shape, corner = (np.zeros((len(views), n), dtype=np.int64) for n in (1, 2, 2))
    filled = 0
    for v, view in enumerate(views):
        if is_whole is not None and not is_whole[v]:
            continue
        behind = None if hidden is None else hidden[v]
        found = _camera_outline(view, masks[v], behind, hull_points, other_points, n_points)
        if found is None:
            continue
        uv, normal_px, near, low = found
        rays, normals = rays_through(uv, normal_px, view.camera.K, view.camera.R)
        origins = np.tile(view.camera.center, (len(uv), 1))
        parts.append((origins, rays, normals, np.full(len(uv), v, dtype=np.int64)))
        nearest.append(near.ravel())
        first[v], shape[v], corner[v] = filled, near.shape, low
        filled += near.size
    empty = np.zeros((0, 3))
    return Outlines(
        rig=rig,
        origins=np.concatenate([p[0] for p in parts]) if parts else empty,
        directions=np.ascontiguousarray(np.concatenate([p[1] for p in parts])) if parts else empty,
        normals=np.ascontiguousarray(np.concatenate([p[2] for p in parts])) if parts else empty,
        camera=np.concatenate([p[3] for p in parts]) if parts else np.zeros(0, dtype=np.int64),
        nearest=np.concatenate(nearest) if nearest else np.zeros(0, dtype=np.int32),
        first=first[:, 0].copy(),
        shape=shape,
        corner=corner,
    )


def _pinhole_pixels(camera: Camera, points: Array) -> NDArray[np.int64]:
    """Pixels (M, 2) of those world points (N, 3) that are in front of the camera and in its picture."""
    return pixels_of_points(points, camera.R, camera.t, camera.K, *camera.size)


def _camera_outline(
    view: PinholeView,
    mask: Mask,
    hidden: Mask | None,
    hull_points: Array,
    other_points: Array | None,
    n_points: int,
) -> tuple[Array, Array, NDArray[np.int32], NDArray[np.int64]] | None:
    """Outline points (M, 2) px, outward normals (M, 2), nearest silhouette pixels of the crop, its corner."""
    pixels = _pinhole_pixels(view.camera, hull_points)
    if len(pixels) < _MIN_OUTLINE_PX:
        return None
    first, last = extent_of(pixels)
    low, high = np.maximum(first - _MARGIN_PX, 0), np.minimum(last + _MARGIN_PX + 1, view.camera.size)
    window = slice(low[1], high[1]), slice(low[0], high[0])
    crop = np.ascontiguousarray(view.undistort(mask, window))
    if not crop.any():
        return None
    behind = None if hidden is None else view.undistort(hidden, window)
    possible = crop if behind is None else crop | behind
    _, labels = cv2.distanceTransformWithLabels(1 - possible, cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL)
    near = nearest_of_labels(labels, possible)

    contours, _ = cv2.findContours(crop, cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
    points = [c[:, 0] for c in contours if len(c) >= _MIN_OUTLINE_PX]
    if not points:
        return None
    at = np.concatenate(points).astype(np.int64)  # as rays have theirs: kernels are compiled once
    good = are_inside(at, low, crop.shape, view.camera.size, _BORDER_PX)
    if behind is not None:
        good &= cv2.dilate(behind, _EDGE_KERNEL)[at[:, 1], at[:, 0]] == 0
    at = at[good]
    at = at[are_near(at, pixels, low, crop.shape, _NEAR_PX)]
    if other_points is not None and len(other_points):
        others = _pinhole_pixels(view.camera, other_points)
        at = at[~are_near(at, others, low, crop.shape, _NEAR_PX)]
    if len(at) == 0:
        return None
    at = at[_spread(len(at), n_points)]
    slope = -slopes_at(crop, at, *_SOFT_SLOPE)
    length = np.linalg.norm(slope, axis=1)
    clear = length > _LEAST_SLOPE
    normal = slope[clear] / length[clear, None]
    # The outline runs between the last pixel of the silhouette and the next.
    return at[clear] + low + 0.5 * normal, normal, near, low


def _spread(n: int, n_wanted: int) -> NDArray[np.int64]:
    """At most so many of n rows, evenly spread, ascending."""
    rows = np.linspace(0, n - 1, n_wanted).astype(np.int64)
    return rows if n >= n_wanted else np.unique(rows)


@dataclass(frozen=True, eq=False)
class OutlineProblem:
    """Robust distance of a body to one frame's outlines: `normal_equations(state)` for the refinement.

    Rays through outline points pull the flesh that they should touch; flesh points outside a silhouette are pulled in,
    camera by camera.
    """

    body: Body
    table: LookUpTable
    outlines: Outlines
    settings: OutlineFitSettings
    _flesh: Array = field(init=False, repr=False)
    _flesh_joint: NDArray[np.int64] = field(init=False, repr=False)
    _cameras: Pinholes = field(init=False, repr=False)

    def __post_init__(self) -> None:
        flesh, joint, _ = flesh_sample(self.table, self.settings.n_flesh_points)
        for name, value in (
            ("_flesh", flesh),
            ("_flesh_joint", joint),
            ("_cameras", _pinholes(self.outlines.rig)),
        ):
            object.__setattr__(self, name, value)

    @property
    def layout(self) -> StateLayout:
        return self.body.layout

    @property
    def n_points(self) -> int:
        """Outline points used."""
        return self.outlines.n_points

    @cached_property
    def terms(self) -> OutlineTerms:
        """The problem as the kernels take it."""
        settings, o = self.settings, self.outlines
        return OutlineTerms(
            _rays(o.origins, o.directions, o.normals),
            FleshPoints(self._flesh, self._flesh_joint),
            self._cameras,
            Crops(o.corner, o.nearest, o.first, o.shape),
            OutlinePull(
                scale_m=settings.scale_m,
                normal_cost_m=settings.normal_cost_m,
                flesh_scale_m=settings.flesh_scale_m,
                flesh_gain=settings.flesh_gain * o.n_points / (len(self._flesh) * max(1, o.n_cameras)),
            ),
        )

    def normal_equations(self, state: Array) -> tuple[float, Array, Array]:
        """Robust cost, its Gauss-Newton matrix (D, D) and gradient (D,) at a state (D,).

        Units: metres squared, summed over the outline points. No outlines give zeros.
        """
        body, o = self.body, self.outlines
        D = body.layout.n_columns
        H, g = np.zeros((D, D)), np.zeros(D)
        if o.n_points == 0:
            return 0.0, H, g
        x = np.ascontiguousarray(state, dtype=np.float64)
        return float(outline_equations(x, body.arrays, self.terms, H, g)), H, g

    def unexplained_share(self, state: Array, distance_m: float) -> float:
        """Share of the outline points that lie further than distance_m outside the flesh of a state (D,), 0 without.

        Other than of a hull, few cameras leave no more of it.
        """
        o = self.outlines
        if o.n_points == 0:
            return 0.0
        outside = distance_of_lines(self.body, cones_of(self.body, state), o.origins, o.directions).min(
            axis=1
        )
        return float((outside > distance_m).mean())


@lru_cache(maxsize=64)
def _pinholes(rig: CameraRig) -> Pinholes:
    """The cameras of a rig as kernels take them."""
    cameras = list(rig)
    intrinsics = [
        [c.K[0, 0], c.K[1, 1], c.K[0, 2], c.K[1, 2], 1.0, 1.0, c.size[0] - 2.0, c.size[1] - 2.0]
        for c in cameras
    ]
    return Pinholes(np.stack([c.R for c in cameras]), np.stack([c.t for c in cameras]), np.array(intrinsics))


def _rays(origins: Array, directions: Array, normals: Array) -> Rays:
    columns = np.concatenate([origins, directions, normals], axis=1).T
    return Rays(origins, directions, normals, np.ascontiguousarray(columns, dtype=np.float32))


@cache
def no_outline_terms() -> OutlineTerms:
    """`OutlineProblem.terms` where there are no outlines."""
    row, index = np.zeros((0, 3)), np.zeros(0, dtype=np.int64)
    pairs = np.zeros((0, 2), dtype=np.int64)
    return OutlineTerms(
        _rays(row, row, row),
        FleshPoints(row, index),
        Pinholes(np.zeros((0, 3, 3)), row, np.zeros((0, 8))),
        Crops(pairs, np.zeros(0, dtype=np.int32), index, pairs),
        OutlinePull(1.0, 1.0, 1.0, 0.0),
    )
