"""Texture: the colours of many places of a person's surface, learnt over a clip, as residuals of a pose.

Where a sleeve ends, where hem and hairline lie, a pose that is off by a centimetre shows another colour; and a place
that has slid off its limb shows the trunk behind it, or the room. Neither hull nor outlines tell how a trunk turns
inside its silhouette, nor where along its length a limb is.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from mocap.arrays import Array, Image, Mask
from mocap.body.flesh import LookUpTable, cone_distances
from mocap.body.model import Body
from mocap.data.camera import Camera
from mocap.data.problem import StateLayout
from mocap.geometry._pixel_kernels import extent_of, pixels_of_points
from mocap.likelihood.colours import luma_and_chroma
from mocap.likelihood.residuals._texture_kernels import (
    Crops,
    Places,
    TextureTerms,
    count_colours,
    see_places,
    texture_equations,
)
from mocap.likelihood.residuals.outlines import PinholeView
from mocap.likelihood.residuals.surface import flesh_sample

_MAD = 1.4826  # a normal deviation by the median of what differs
_PYRAMID_STD_PX = 1.0  # deviation of the mask (1, 4, 6, 4, 1) / 16 by which a level of a pyramid is smoothed
_LEAST_STD_PX = 0.5  # less is what reading between pixels smooths by


@dataclass(frozen=True)
class TextureSettings:
    """Which places of the surface, and what is believed of their colours."""

    n_places: int = 1500
    """On the whole flesh, about 4 cm apart."""
    blur_m: float = 0.01
    """Deviation by which pictures are smoothed, at the person: from as far a pose is drawn to where a colour fits."""
    margin_m: float = 0.2
    """What of a picture is kept around a person's hull."""
    apart_m: float = 0.05
    """A pixel so near to another person's hull may show him."""
    least_std: tuple[float, float, float] = (6.0, 2.5, 2.5)
    """What luma and the two chromas of a place vary by at least, of 255."""
    least_seen: int = 10
    """A place that was seen less often is not known."""
    least_cosine: float = 0.35
    """Of the angle between normal and ray: the rim of a cone is not that of the person."""
    slack_m: float = 0.04
    """Flesh that lies so little before a place does not hide it."""
    scale: float = 4.0
    """Deviations at which a colour loses three quarters of its pull (Geman-McClure)."""


def places_of(body: Body, table: LookUpTable, n: int) -> Places:
    """About n places on the flesh, evenly spread, with its normals.

    Points of the table stand on a lattice: each is moved onto the cone that it is nearest to.
    """
    lattice, joint, _ = flesh_sample(table, n)
    points = lattice.copy()
    cones, normals = body.cones, np.zeros_like(points)
    for j in np.unique(joint):
        own, at = np.flatnonzero(cones.joint == j), np.flatnonzero(joint == j)
        start, end, radii = cones.start[own], cones.end[own], cones.radii[own]
        k = np.abs(cone_distances(points[at], start, end, radii, True)).argmin(axis=1)
        along = (end - start)[k]
        share = ((points[at] - start[k]) * along).sum(axis=1) / np.maximum((along**2).sum(axis=1), 1e-12)
        share = np.clip(share, 0.0, 1.0)[:, None]
        axis = start[k] + share * along
        away = points[at] - axis
        normals[at] = away / np.maximum(np.linalg.norm(away, axis=1, keepdims=True), 1e-9)
        points[at] = axis + (radii[k, :1] + share * (radii[k, 1:] - radii[k, :1])) * normals[at]
    return Places(np.ascontiguousarray(points), normals, np.ascontiguousarray(joint))


def person_crops(
    views: Sequence[PinholeView],
    pictures: Sequence[Image],
    hull_points: Array,
    other_points: Array,
    *,
    is_used: Sequence[bool] | NDArray[np.bool_],
    hidden: Sequence[Mask | None],
) -> Crops:
    """What cameras show around one person.

    pictures : (H, W, 3) RGB, one per camera.  hull_points : (N, 3) m, surface of the person's hull.  other_points :
    (K, 3) m, of the other persons': pixels near theirs are not clear, for who stands in front is not known here.
    is_used : cameras that can be trusted.  hidden : per camera (H, W) bool, pixels in which something stands before the
    person, or None.
    """
    numbers = TextureSettings()
    n = len(views)
    colours, clear = [np.zeros((0, 3), dtype=np.uint8)], [np.zeros(0, dtype=np.bool_)]
    first, shape = np.zeros(n, dtype=np.int64), np.zeros((n, 2), dtype=np.int64)
    focal, middle = np.ones((n, 2)), np.zeros((n, 2))
    filled = 0
    for c, view in enumerate(views):
        camera = view.camera
        pixels = pixels_of_points(hull_points, camera.R, camera.t, camera.K, *camera.size)
        if not is_used[c] or not len(pixels):
            continue
        depth_m = float(np.median(hull_points @ camera.R[2] + camera.t[2]))
        px_per_m = camera.K[0, 0] / depth_m
        margin = int(np.ceil(numbers.margin_m * px_per_m))
        least, most = extent_of(pixels)
        low, high = np.maximum(least - margin, 0), np.minimum(most + margin + 1, camera.size)
        window = slice(low[1], high[1]), slice(low[0], high[0])
        crop, inside = view.picture(pictures[c], window)
        behind = hidden[c]
        if behind is not None:
            inside = inside & (view.undistort(behind, window) == 0)
        if len(other_points):
            inside = inside & ~_near(other_points, camera, window, numbers.apart_m * px_per_m)
        smooth, stride = _smoothed(crop, numbers.blur_m * px_per_m)
        inside = inside[::stride, ::stride]
        colours.append(luma_and_chroma(smooth.reshape(-1, 3)).reshape(-1, 3))
        clear.append(inside.ravel())
        first[c], shape[c] = filled, inside.shape
        focal[c], middle[c] = np.diag(camera.K)[:2] / stride, (camera.K[:2, 2] - low) / stride
        filled += inside.size
    return Crops(
        np.concatenate(colours),
        np.concatenate(clear),
        first,
        shape,
        np.stack([view.camera.R for view in views]),
        np.stack([view.camera.t for view in views]),
        focal,
        middle,
    )


def _smoothed(picture: Image, std_px: float) -> tuple[Image, int]:
    """A picture smoothed by a deviation, and every how many of its pixels are left: what is as smooth needs no more."""
    stride = 1
    while std_px >= _PYRAMID_STD_PX:
        picture = cv2.pyrDown(picture)
        std_px, stride = 0.5 * np.sqrt(std_px**2 - _PYRAMID_STD_PX**2), 2 * stride
    if std_px >= _LEAST_STD_PX:
        picture = cv2.GaussianBlur(picture, (0, 0), std_px)
    return picture, stride


def _near(points: Array, camera: Camera, window: tuple[slice, slice], reach_px: float) -> Mask:
    """Pixels of a window that lie within a reach of projected points (K, 3) m."""
    pixels = pixels_of_points(points, camera.R, camera.t, camera.K, *camera.size)
    marked = np.zeros(camera.size[::-1], dtype=np.uint8)
    marked[pixels[:, 1], pixels[:, 0]] = 1
    side = 2 * int(np.ceil(reach_px)) + 1
    return np.asarray(cv2.dilate(marked, np.ones((side, side), dtype=np.uint8))[window], dtype=np.bool_)


@dataclass(frozen=True, eq=False)
class Texture:
    """What is known of the colours of a person's surface: of places of his body."""

    body: Body
    places: Places
    terms: TextureTerms
    settings: TextureSettings


@dataclass(frozen=True, eq=False)
class ColourCounts:
    """How often places of a body were seen in which colour.  counts : (M, 3, 256)."""

    body: Body
    places: Places
    counts: NDArray[np.int64]
    settings: TextureSettings

    def see(self, crops: Crops, state: Array) -> None:
        """Count what a frame's crops show under a pose (D,)."""
        x = np.ascontiguousarray(state, dtype=np.float64)
        seen = _seen(self.body, self.places, crops, x, self.settings)
        count_colours(x, self.body.arrays, self.places, crops, seen, self.counts)

    @property
    def texture(self) -> Texture:
        """The median colour of every place and how far colours usually differ from it: what is seen by mistake, an arm
        before the trunk for instance, has no say."""
        n, numbers = self.counts[:, 0].sum(axis=1), self.settings
        median = _medians(self.counts)
        levels = np.arange(256)
        # How often a colour lies 0, 1, .. levels from the median: those above and those below.
        off = np.zeros_like(self.counts)
        for sign in (1, -1):
            at = median[..., None] + sign * levels
            if sign < 0:
                at[..., 0] = -1  # 0 levels off counts once
            inside = (at >= 0) & (at < 256)
            off += np.where(inside, np.take_along_axis(self.counts, np.clip(at, 0, 255), axis=2), 0)
        variance = (_MAD * _medians(off)) ** 2 + np.square(numbers.least_std)
        inverse = np.where((n >= numbers.least_seen)[:, None], 1.0 / np.sqrt(variance), 0.0)
        terms = TextureTerms(median.astype(np.float64), inverse, numbers.scale)
        return Texture(self.body, self.places, terms, numbers)


def _medians(counts: NDArray[np.int64]) -> NDArray[np.int64]:
    """Medians (M, 3) of what is counted (M, 3, 256), the lower of two."""
    total = counts.cumsum(axis=2)
    return np.asarray((2 * total >= total[..., -1:]).argmax(axis=2))


def _seen(body: Body, places: Places, crops: Crops, state: Array, settings: TextureSettings) -> Mask:
    seen = np.zeros((len(crops.first), len(places.joint)), dtype=np.bool_)
    see_places(state, body.arrays, places, crops, settings.least_cosine, settings.slack_m, seen)
    return seen


@dataclass(frozen=True, eq=False)
class TextureProblem:
    """The colours that one frame shows where places of a body lie: `normal_equations(state)` for a refinement.

    seen : (C, M) which places which cameras see, held while the pose moves.  weight : nats per mean squared deviation,
    half of them, of a colour.
    """

    texture: Texture
    crops: Crops
    seen: Mask
    weight: float = 1.0

    @classmethod
    def about(cls, texture: Texture, crops: Crops, state: Array, weight: float = 1.0) -> TextureProblem:
        """Of what is seen under a state (D,)."""
        x = np.ascontiguousarray(state, dtype=np.float64)
        return cls(texture, crops, _seen(texture.body, texture.places, crops, x, texture.settings), weight)

    @property
    def layout(self) -> StateLayout:
        return self.texture.body.layout

    @property
    def compared(self) -> NDArray[np.bool_]:
        """Parts (P,) of which two cameras or more see places whose colours are known: one does not tell how far away
        they are."""
        own = self.texture
        is_known, part = own.terms.inverse.any(axis=1), own.body.part_of_joint[own.places.joint]
        sees = np.zeros((len(self.seen), self.layout.n_parts), dtype=np.bool_)
        for camera, seen in enumerate(self.seen):
            sees[camera, part[seen & is_known]] = True
        return np.asarray(sees.sum(axis=0) >= 2)

    def normal_equations(self, state: Array) -> tuple[float, Array, Array]:
        """Robust cost, nats, its Gauss-Newton matrix (D, D) and gradient (D,) at a state (D,).

        A place whose colour is not known costs nothing and pulls nowhere.
        """
        D = self.layout.n_columns
        H, g = np.zeros((D, D)), np.zeros(D)
        x = np.ascontiguousarray(state, dtype=np.float64)
        own = self.texture
        cost = texture_equations(x, own.body.arrays, own.places, self.crops, self.seen, own.terms, H, g)
        share = self.weight / max(int(self.seen.sum()), 1)
        return share * float(cost), share * H, share * g
