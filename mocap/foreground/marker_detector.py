"""Coloured markers in pictures: their colour learnt from labelled points, patches of that colour as detections."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray

from mocap.arrays import Array, Image

_QUANTISATION_STD = 1.5  # of 8-bit chroma after compression: a learnt colour is never sharper
_TRIM = 3.0  # robust standard deviations beyond which a labelled pixel is no marker
_RING_PX = (6.0, 9.0)  # what is around a label
_MAD_TO_STD = 1.4826
MIN_PIXELS = 12


@dataclass(frozen=True)
class MarkerDetectorSettings:
    """What counts as a marker in a picture."""

    mahalanobis: float = 3.0
    """Gate on the distance from the learnt colour.  Source: CF 6.6.2."""
    min_area_px: int = 3
    max_area_px: int = 400

    def __post_init__(self) -> None:
        if not self.mahalanobis > 0 or not 1 <= self.min_area_px <= self.max_area_px:
            raise ValueError(
                f"mahalanobis must be positive and 1 <= min_area_px <= max_area_px, got {self.mahalanobis}, "
                f"{self.min_area_px}, {self.max_area_px}"
            )


@dataclass(frozen=True, eq=False)
class MarkerColour:
    """A Gaussian in the plane of (Cr, Cb).  mean : (2,).  covariance : (2, 2).  n_pixels : it was learnt from."""

    mean: Array
    covariance: Array
    n_pixels: int

    @cached_property
    def distances(self) -> Array:
        """Mahalanobis distance of every 8-bit (Cr, Cb), (256, 256)."""
        grid = np.stack(np.meshgrid(np.arange(256.0), np.arange(256.0), indexing="ij"), axis=-1) - self.mean
        return np.sqrt(np.einsum("abi,ij,abj->ab", grid, np.linalg.inv(self.covariance), grid))


def learn_marker_colour(
    images: Sequence[Image], labels: Sequence[Array], *, radius_px: float = 2.0
) -> MarkerColour:
    """The colour of markers from labelled points.

    images : (H, W, 3) uint8 RGB.  labels : per image (n, 2) px, points on markers. Pixels within radius_px of a label
    count, the half of them that differs most from the surroundings; those far from the median of all are left out.
    Raises ValueError when fewer than 12 pixels are left.
    Source: CF 6.6.2: a Gaussian in Cr and Cb, learnt around points that are labelled by hand.
    """
    found = []
    near, ring = _disc(0.0, radius_px), _disc(_RING_PX[0], _RING_PX[1])
    for image, uv in zip(images, labels, strict=True):
        chroma = _chroma(image)
        for center in np.round(uv).astype(np.int64):
            own, around = _pixels_at(chroma, center + near), _pixels_at(chroma, center + ring)
            if len(own) and len(around):
                # Small markers are mostly border: the half that differs most from what is around is the marker.
                contrast = np.linalg.norm(own - np.median(around, axis=0), axis=1)
                found.append(own[np.argsort(-contrast, kind="stable")[: (len(own) + 1) // 2]])
    pixels = np.concatenate([np.zeros((0, 2)), *found])
    if len(pixels):
        off = np.abs(pixels - np.median(pixels, axis=0))
        spread = np.maximum(_MAD_TO_STD * np.median(off, axis=0), _QUANTISATION_STD)
        pixels = pixels[np.all(off <= _TRIM * spread, axis=1)]
    if len(pixels) < MIN_PIXELS:
        raise ValueError(f"{len(pixels)} labelled pixels, at least {MIN_PIXELS} are needed to learn a colour")
    covariance = np.cov(pixels.T) + _QUANTISATION_STD**2 * np.eye(2)
    return MarkerColour(pixels.mean(axis=0), covariance, len(pixels))


def _disc(inner_px: float, outer_px: float) -> NDArray[np.int64]:
    """Steps (n, 2) to the pixels between two radii."""
    reach = int(np.ceil(outer_px))
    step = np.stack(np.meshgrid(*[np.arange(-reach, reach + 1)] * 2, indexing="ij"), axis=-1).reshape(-1, 2)
    radius = np.hypot(step[:, 0], step[:, 1])
    return step[(radius >= inner_px) & (radius <= outer_px)]


def _pixels_at(chroma: Image, at: NDArray[np.int64]) -> Array:
    """Values (n, 2) at those pixels (n, 2) that lie inside the picture."""
    h, w = chroma.shape[:2]
    inside = at[np.all((at >= 0) & (at < [w, h]), axis=1)]
    return chroma[inside[:, 1], inside[:, 0]].astype(np.float64)


def detect_markers(image: Image, colour: MarkerColour, settings: MarkerDetectorSettings) -> Array:
    """Centres (n, 2) px of the patches of marker colour in a picture (H, W, 3) uint8 RGB, from top to bottom.

    Touching markers come out as one. An empty picture gives (0, 2).
    Source: CF 6.6.2: a threshold on the Mahalanobis distance in Cr and Cb.
    """
    table = (colour.distances < settings.mahalanobis).astype(np.uint8)
    chroma = _chroma(image)
    mask = table[chroma[..., 0], chroma[..., 1]]
    _, _, stats, centers = cv2.connectedComponentsWithStats(mask, connectivity=8)
    area = stats[1:, cv2.CC_STAT_AREA]
    return centers[1:][(area >= settings.min_area_px) & (area <= settings.max_area_px)]


def _chroma(image: Image) -> Image:
    """Cr and Cb of a picture, (H, W, 2)."""
    return cv2.cvtColor(image, cv2.COLOR_RGB2YCrCb)[..., 1:]
