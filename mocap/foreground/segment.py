"""Pictures to masks: running Gaussian background, chromatic shadow test, outline trimming, clean-up."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from mocap.foreground import _kernels
from mocap.foreground.model import Background

Image = NDArray[np.uint8]
Mask = NDArray[np.bool_]
Bytes = NDArray[np.uint8]

METHODS = ("gaussian", "mog2", "knn")
# OpenCV's models adapt everywhere: at our rate they absorb a person who stands still within a second.
# KNN takes a rate of 0 for "choose one".
_OPENCV_RATE = {"mog2": 0.0, "knn": 1e-5}
_REFERENCE_PIXELS = 640 * 480
_GAIN_STEP = 12  # every 12th pixel in both directions tells the gain
_ADAPT_ROWS = 8  # one row in eight adapts per picture
_TRAIN = 40  # synthetic empty pictures that train the OpenCV models


@dataclass(frozen=True)
class ForegroundSettings:
    """How a picture is split. Lengths and areas are pixels of a 640 x 480 picture; others scale them.

    method : 'gaussian' (ours), or OpenCV's 'mog2' or 'knn' with their own shadow tests.
    threshold_sigma, min_difference : a pixel differs from the background when a channel is off by more than
        so many standard deviations and grey levels.
    strong_difference : grey levels; a region without any pixel this different is dropped (hysteresis).
    edge_jitter_px : the camera may shake by so much: at an edge of the background the threshold rises by the
        grey levels between this pixel and one so far away.
    shadow_darkest, shadow_brightest : brightness relative to the background that a shadow may have.
    shadow_chroma : grey levels that the colour of a shadow, averaged over shadow_window_px, may be off the
        colour of the background at that brightness. shadow_chroma_pixel : the same for the single pixel.
        Both rise with the noise of the picture.
    shadow_tint : added to both, per grey level of darkening: the light that is missing need not be white.
    outline_share, outline_px : a pixel at the rim of the foreground stays only if it differs from the
        background by this share of the largest difference within outline_px: blur and compression draw a halo
        round a person.
    closing_px : gaps up to this width are closed where the picture differs from the background.
    closing_hint_px : gaps up to this width are closed, and holes filled, where it differs by half the threshold on
        the average of 5 x 5 pixels.
    max_hole_px : holes of differing pixels up to this area are filled (holes that show the background stay).
    min_area_px, min_area_share : smaller regions are dropped; share of the largest region.
    adaptation : share of the way to the new picture that background pixels go per picture; 0 = never. Only the
        'gaussian' method adapts.
    compensate_gain : divide out a brightness change of the whole picture, per channel.
    max_foreground_share : above this share of the picture the mask is not usable.
    """

    method: str = "gaussian"
    threshold_sigma: float = 3.0
    min_difference: float = 7.0
    strong_difference: float = 20.0
    edge_jitter_px: float = 0.5
    shadow_darkest: float = 0.6
    shadow_brightest: float = 1.03
    shadow_chroma: float = 2.5
    shadow_chroma_pixel: float = 6.0
    shadow_tint: float = 0.0
    shadow_window_px: int = 5
    outline_share: float = 0.35
    outline_px: int = 5
    closing_px: int = 7
    closing_hint_px: int = 5
    max_hole_px: float = 500.0
    min_area_px: float = 150.0
    min_area_share: float = 0.02
    adaptation: float = 0.005
    compensate_gain: bool = True
    max_foreground_share: float = 0.6

    def __post_init__(self) -> None:
        if self.method not in METHODS:
            raise ValueError(f"method: expected one of {', '.join(METHODS)}, got {self.method!r}")
        if not 0 <= self.adaptation < 1:
            raise ValueError(f"adaptation: expected 0 <= adaptation < 1, got {self.adaptation}")


@dataclass(frozen=True, eq=False)
class ForegroundMask:
    """One segmented picture.

    mask : (H, W) bool, the person.  shadow : (H, W) bool, darker than the background but of its colour.
    foreground_share, shadow_share : shares of the picture.
    is_usable : False when the foreground fills so much of the picture that the background must be wrong.
    """

    mask: Mask
    shadow: Mask
    foreground_share: float
    shadow_share: float
    is_usable: bool


class Segmenter:
    """Splits the pictures of one camera, in order; keeps the slowly adapting background between them.

    Only pixels that are neither foreground nor shadow adapt, so a person who stands still is never absorbed.
    One Segmenter per camera and clip; not to be shared between threads.
    Source: CF 2.2.3. Departs from it: one Gaussian per pixel instead of a mixture, and a shadow test on the
    colour averaged over a window, because a person whose clothes have nearly the colour of the wall is lost
    otherwise ('mog2' keeps the mixture).
    """

    def __init__(self, background: Background, settings: ForegroundSettings | None = None) -> None:
        self.settings = settings or ForegroundSettings()
        self.shape = background.mean.shape
        self._n_seen = 0
        self._mean = np.array(background.mean, dtype=np.float32)
        self._background = np.clip(np.round(self._mean), 0, 255).astype(np.uint8)
        self._noise = float(np.median(background.std))
        self._weak_level = 0.5 * max(
            self.settings.min_difference, self.settings.threshold_sigma * self._noise
        )
        limit = np.maximum(
            self.settings.threshold_sigma * background.std.max(axis=2), self.settings.min_difference
        )
        limit += self.settings.edge_jitter_px * _slope(self._background)
        self._threshold = np.clip(np.round(limit), 1, 254).astype(np.uint8)
        self._frozen = np.zeros(self.shape[:2], dtype=np.uint8)
        self._subtractor = None
        if self.settings.method != "gaussian":
            self._subtractor = _trained_subtractor(self.settings.method, background)

    def segment(self, image: Image) -> ForegroundMask:
        """Foreground of the next picture, (H, W, 3) uint8 RGB; ValueError for another shape than before."""
        if image.shape != self.shape or image.dtype != np.uint8:
            raise ValueError(f"image: expected uint8 of shape {self.shape}, got {image.dtype} {image.shape}")
        if self._subtractor is not None:
            raw = self._subtractor.apply(image, learningRate=_OPENCV_RATE[self.settings.method])
            kept = clean_mask(raw == 255, self.settings)
            return self._answer(kept.astype(np.uint8), ((raw == 127) & ~kept).astype(np.uint8))
        # The kernels are compiled for writable contiguous arrays; any other kind would be compiled anew.
        picture = np.require(image, requirements=("C", "W"))
        if self.settings.compensate_gain:
            picture = self._without_gain(picture)
        height, width = self.shape[:2]
        largest = np.empty((height, width), dtype=np.uint8)
        candidate = np.empty((height, width), dtype=np.uint8)
        _kernels.difference(
            picture.reshape(-1), self._background.reshape(-1), self._threshold.reshape(-1),
            largest.reshape(-1), candidate.reshape(-1),
        )  # fmt: skip
        mask = np.zeros((height, width), dtype=np.uint8)
        shadow = np.zeros((height, width), dtype=np.uint8)
        solid = cv2.medianBlur(candidate, 3)
        x, y, w, h = cv2.boundingRect(solid)
        if w and h:
            margin = _scaled_px(10, self.shape)
            rows = slice(max(y - margin, 0), min(y + h + margin, height))
            columns = slice(max(x - margin, 0), min(x + w + margin, width))
            window = (rows, columns)
            parts = (picture, self._background, solid, largest)
            mask[window], shadow[window] = self._split(*(np.ascontiguousarray(a[window]) for a in parts))
        if self.settings.adaptation > 0:
            self._adapt(picture, candidate, mask)
        return self._answer(mask, shadow)

    def _answer(self, mask: Bytes, shadow: Bytes) -> ForegroundMask:
        share = cv2.countNonZero(mask) / mask.size
        return ForegroundMask(
            mask.view(np.bool_), shadow.view(np.bool_), share, cv2.countNonZero(shadow) / mask.size,
            share <= self.settings.max_foreground_share,
        )  # fmt: skip

    def _without_gain(self, picture: Image) -> Image:
        step = max(1, _scaled_px(_GAIN_STEP, self.shape))
        ratios = np.empty((3, -(-self.shape[0] // step) * -(-self.shape[1] // step)), dtype=np.float32)
        n = _kernels.brightness_ratios(picture, self._background, self._frozen, step, ratios)
        if n < 0.1 * ratios.shape[1]:
            return picture
        gain = np.median(ratios[:, :n], axis=1)
        if np.abs(gain - 1).max() < 0.004:
            return picture
        levels = np.arange(256)[:, None] / np.clip(gain, 0.5, 2.0)
        table = np.clip(np.round(levels), 0, 255).astype(np.uint8)
        return cv2.LUT(picture, table.reshape(1, 256, 3))

    def _split(
        self, picture: Image, background: Image, candidate: Bytes, largest: Bytes
    ) -> tuple[Bytes, Bytes]:
        s = self.settings
        shape = candidate.shape
        ratio = np.empty(shape, dtype=np.float32)
        residual = np.empty((*shape, 2), dtype=np.float32)
        _kernels.chroma_residual(picture, background, ratio, residual)
        # The window averages noise, which small pictures have no less of.
        side = _odd(max(_scaled_px(s.shadow_window_px, self.shape), s.shadow_window_px))
        chroma = max(s.shadow_chroma, 2.5 * self._noise * 2**0.5 / side)
        chroma_pixel = max(s.shadow_chroma_pixel, 4.0 * self._noise)
        smooth = cv2.boxFilter(residual, -1, (side, side))
        foreground = np.empty(shape, dtype=np.uint8)
        shadow = np.empty(shape, dtype=np.uint8)
        _kernels.split_shadow(
            candidate, ratio, residual, smooth, background,
            np.float32(s.shadow_darkest), np.float32(s.shadow_brightest), np.float32(chroma),
            np.float32(chroma_pixel), np.float32(s.shadow_tint), foreground, shadow,
        )  # fmt: skip
        foreground = _trim_outline(foreground, largest, s, self.shape)
        mask = _clean(foreground, shadow, candidate, largest, self._weak_level, s, self.shape)
        return mask, shadow & (1 - mask)

    def _adapt(self, picture: Image, candidate: Bytes, mask: Bytes) -> None:
        near = cv2.dilate(mask, np.ones((5, 5), dtype=np.uint8))
        self._frozen = candidate | near
        rate = np.float32(1 - (1 - self.settings.adaptation) ** _ADAPT_ROWS)
        _kernels.adapt_rows(
            picture, self._mean, self._background, self._frozen, self._n_seen % _ADAPT_ROWS, _ADAPT_ROWS, rate
        )
        self._n_seen += 1


def clean_mask(mask: Mask, settings: ForegroundSettings | None = None) -> Mask:
    """A mask without specks, small gaps and small holes.

    mask : (H, W) bool. Regions below min_area_px or min_area_share of the largest go; gaps up to closing_px
    close; holes up to min_area_px are filled (larger ones may be the view between an arm and the body).
    An empty mask stays empty.
    """
    s = settings or ForegroundSettings()
    raw = np.ascontiguousarray(mask).astype(np.uint8)
    kept = _large_regions(raw, s, raw.shape, raw)
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (_odd(_scaled_px(s.closing_px, raw.shape)),) * 2)
    closed = cv2.morphologyEx(kept, cv2.MORPH_CLOSE, kernel)
    labels, area, _ = _regions(1 - closed, raw, 4)
    return _select(labels, area < s.min_area_px * _area_scale(raw.shape), of_zero=True).astype(np.bool_)


def _slope(background: Image) -> NDArray[np.float32]:
    """Largest difference to a neighbouring pixel over the channels, (H, W) grey levels per pixel."""
    square = np.ones((3, 3), dtype=np.uint8)
    above = cv2.dilate(background, square) - background
    below = background - cv2.erode(background, square)
    return np.maximum(above, below).max(axis=2).astype(np.float32)


def _area_scale(shape: tuple[int, ...]) -> float:
    return shape[0] * shape[1] / _REFERENCE_PIXELS


def _scaled_px(length: float, shape: tuple[int, ...]) -> int:
    return max(1, round(length * _area_scale(shape) ** 0.5))


def _odd(length: int) -> int:
    return length | 1


def _trim_outline(foreground: Bytes, largest: Bytes, s: ForegroundSettings, shape: tuple[int, ...]) -> Bytes:
    if s.outline_share <= 0:
        return foreground
    side = _odd(_scaled_px(s.outline_px, shape))
    square = np.ones((side, side), dtype=np.uint8)
    peak = cv2.dilate(cv2.multiply(largest, foreground), square)
    core = cv2.erode(foreground, square)
    weak = cv2.compare(largest, cv2.multiply(peak, s.outline_share), cv2.CMP_LT)
    return core | (foreground & ~weak)


def _clean(
    foreground: Bytes,
    shadow: Bytes,
    candidate: Bytes,
    largest: Bytes,
    weak_level: float,
    s: ForegroundSettings,
    shape: tuple[int, ...],
) -> Bytes:
    """Closing and hole filling among differing pixels, then hysteresis and small regions."""
    mask = np.zeros_like(foreground)
    x, y, w, h = cv2.boundingRect(foreground)
    if not w or not h:
        return mask
    scale = _area_scale(shape)
    side = _odd(_scaled_px(s.closing_px, shape))
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (side, side))
    # Closing joins foreground to a border nearer than its kernel, and would cut the background into "holes".
    margin = _odd(_scaled_px(max(s.closing_px, s.closing_hint_px), shape))
    window = (slice(max(y - margin, 0), y + h + margin), slice(max(x - margin, 0), x + w + margin))
    tight = foreground[window]
    differs = cv2.min(candidate[window], 1)
    strong = cv2.compare(largest[window], s.strong_difference, cv2.CMP_GT)
    # Specks in the shadow would be joined to the person by the closing.
    labels, area, n_strong = _regions(tight, strong, 8)
    tight = _select(labels, (area >= 0.25 * s.min_area_px * scale) & (n_strong > 0), of_zero=False)
    tight |= cv2.morphologyEx(tight, cv2.MORPH_CLOSE, kernel) & differs
    # Clothes of nearly the colour of the wall: each pixel is within the threshold, their average is not noise.
    # The average leaves the foreground and its blurred rim out.
    beside = cv2.dilate(tight, np.ones((3, 3), dtype=np.uint8)) ^ 1
    total = cv2.boxFilter(cv2.multiply(largest[window], beside), cv2.CV_32F, (5, 5), normalize=False)
    count = cv2.boxFilter(beside, cv2.CV_32F, (5, 5), normalize=False)
    hint = (total >= weak_level * count).view(np.uint8) & (shadow[window] ^ 1)
    wide = _odd(_scaled_px(s.closing_hint_px, shape))
    ellipse = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (wide, wide))
    tight |= cv2.morphologyEx(tight, cv2.MORPH_CLOSE, ellipse) & hint
    evidence = differs | hint
    labels, area, differing = _regions(1 - tight, evidence, 4)
    fill = (area < 0.2 * s.min_area_px * scale) | ((differing > 0.5 * area) & (area < s.max_hole_px * scale))
    tight |= _select(labels, fill, of_zero=False)
    mask[window] = _large_regions(tight, s, shape, strong)
    return mask


def _large_regions(mask: Bytes, s: ForegroundSettings, shape: tuple[int, ...], strong: Bytes) -> Bytes:
    """The mask without small regions and without regions that hold no strong pixel."""
    labels, area, n_strong = _regions(mask, strong, 8)
    if len(area) == 1:
        return mask
    least = max(s.min_area_px * _area_scale(shape), s.min_area_share * area[1:].max())
    return _select(labels, (area >= least) & (n_strong > 0), of_zero=False)


def _regions(
    mask: Bytes, flags: Bytes, connectivity: int
) -> tuple[NDArray[np.int32], NDArray[np.int64], NDArray[np.int64]]:
    """Labels (0 = outside the mask), and per label its area and how many of its pixels are flagged."""
    n, labels = cv2.connectedComponents(mask, connectivity=connectivity)
    area = np.zeros(n, dtype=np.int64)
    flagged = np.zeros(n, dtype=np.int64)
    _kernels.count_regions(labels, flags, area, flagged)
    return labels, area, flagged


def _select(labels: NDArray[np.int32], keep: Mask, *, of_zero: bool) -> Bytes:
    """1 where keep[label]; label 0 counts as of_zero."""
    chosen = keep.astype(np.uint8)
    chosen[0] = of_zero
    out = np.empty(labels.shape, dtype=np.uint8)
    _kernels.select_regions(labels, chosen, out)
    return out


def _trained_subtractor(method: str, background: Background) -> Any:
    """OpenCV's model, trained on pictures drawn from the background statistics (fixed seed)."""
    model: Any
    if method == "mog2":
        model = cv2.createBackgroundSubtractorMOG2(detectShadows=True)
        model.setShadowThreshold(0.7)
    else:
        model = cv2.createBackgroundSubtractorKNN(detectShadows=True)
    rng = np.random.default_rng(0)
    for _ in range(_TRAIN):
        drawn = background.mean + background.std * rng.standard_normal(
            background.mean.shape, dtype=np.float32
        )
        model.apply(np.clip(np.round(drawn), 0, 255).astype(np.uint8))
    return model
