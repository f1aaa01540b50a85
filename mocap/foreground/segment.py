"""Pictures to masks: running Gaussian background, chromatic shadow test, outline trimming, clean-up."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache, reduce
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from mocap.arrays import Image, Mask, largest_channel
from mocap.foreground import _kernels
from mocap.foreground.model import Background, are_grey, as_grey, calmed

Bytes = NDArray[np.uint8]

METHODS = ("gaussian", "mog2", "knn")
# OpenCV's models adapt everywhere: at our rate they absorb a person who stands still within a second.
# KNN takes a rate of 0 for "choose one".
_OPENCV_RATE = {"mog2": 0.0, "knn": 1e-5}
_REFERENCE_PIXELS = 640 * 480
_GAIN_STEP = 16  # every 16th pixel in both directions tells the gain
_FREE_SHARE = 0.1  # of the picture that must be free of persons to tell the gain
# Six tenths of the largest of three differences lie below 1.42 standard deviations: 2.12 times that is three. The rest
# may be persons and shadows that are not known yet.
_USUAL, _THREE_SIGMA = 0.6, 2.12
_MOST_NOISE = 6.0  # more is another picture
_NOISIER = 1.25  # from which on the thresholds rise
_NOISE_STEP = 0.1  # a smaller change of the noise leaves the thresholds
_LEAST_SAMPLES = 100
_BLOCK_PX = 5
# A step of a chrominance is 1.4 grey levels of red or 1.8 of blue. Chosen on six compressed sessions: decision 86.
_COARSE = 1.5  # grey levels per step
_SMALL_STEPS = 0.4  # of what lies between blocks is a step, or less where pictures were compressed twice
_ROUNDED_SHARE = 0.01  # of the blocks beside each other that differ at least; fewer are the borders of things
_COARSEST_STEP = 10  # of JPEG quality 10
_COLOUR_EVERY = 64  # pictures; it takes as long as two of them
# A lamp, flicker in bands and daylight change the light of a large part of the picture; a person does not.
_LIGHT_CELL_PX = (80, 32)
_LIGHT_STEPS_PX = (16, 6)
_UNEVEN = 0.04
_UNEVEN_SHARE = 0.3
_MOST_LEFT = 0.2  # of the picture differs when the light is divided out: persons; else it was not the light
_JUMP = 0.15  # from cell to cell: the outline of a person, whose cells say nothing about the light
_SEARCH_ROWS = 4  # one row in four is searched for differences
_SEARCH_LEAST = 3  # differing values in the searched rows of a cell that make it worth a closer look
_MAX_WINDOWS = 8
_ADAPT_ROWS = 16  # one row in sixteen adapts per picture
# Noise of the Sobel slope of a ratio, three standard deviations of its two components together, per standard
# deviation and unit of brightness of the pixel.
_EDGE_NOISE = 3 * 2**0.5 * 12**0.5 / 8 / 3**0.5
# JPEG and MPEG code colour in blocks of 8 x 8 values at half the resolution, in pictures of any size.
_COLOUR_BLOCK_PX = 16
_TRAIN = 40  # synthetic empty pictures that train the OpenCV models
_NOTHING = np.zeros((0, 0), dtype=np.uint8)


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
    shadow_chroma : how far the colour of a shadow, averaged over shadow_window_px, may be off the colour of the
        background, as a share of the brightness that is left; shadow_chroma_least : grey levels that are always
        allowed. shadow_chroma_pixel : grey levels that the single pixel may be off. The latter two rise with the
        noise of the picture, and with the steps to which compression has rounded its colours.
    shadow_edge : a shadow is soft; where the brightness relative to the background changes by more than this from
        pixel to pixel, there is an object.
    grey_edge, grey_window_px : shadow_edge and shadow_window_px of a camera that sees no colours: there the shade
        alone tells, which is softer than that of folds and limbs.
    outline_share, outline_window_px : a pixel at the rim of the foreground stays only if its difference from the
        background is by this share above that of its surroundings and below that of the inside, both averaged
        over the window: blur and compression draw a halo round a person.
    smeared_share : a pixel as bright as the background, within min_difference on the average of 3 x 3 pixels, differs
        only when its colour does by this share of the largest difference in colour that may lie in the same block:
        compression smears colours over the blocks of a picture.
    closing_px : gaps up to this width are closed where the picture differs from the background.
    closing_hint_px : gaps up to this width are closed, and holes filled, where it differs by half the threshold on
        the average of 5 x 5 pixels.
    max_hole_px : holes of differing pixels up to this area are filled (holes that show the background stay).
    min_area_px, min_area_share : smaller regions are dropped; share of the largest region.
    adaptation : share of the way to the new picture that background pixels go per picture; 0 = never. Only the
        'gaussian' method adapts.
    hold_frames : a pixel that has been foreground for so many pictures on end becomes background, unless
        protected; None = never.
    compensate_gain : divide out a brightness change of the whole picture, per channel, or of large parts of it; and
        raise the thresholds where what is left is noisier than the background was.
    max_foreground_share : above this share of the picture the mask is not usable.
    """

    method: str = "gaussian"
    threshold_sigma: float = 3.0
    min_difference: float = 6.0
    strong_difference: float = 20.0
    edge_jitter_px: float = 0.6
    shadow_darkest: float = 0.5
    shadow_brightest: float = 1.03
    shadow_chroma: float = 0.03
    shadow_chroma_least: float = 2.0
    shadow_chroma_pixel: float = 6.0
    shadow_edge: float = 0.07
    shadow_window_px: int = 5
    grey_edge: float = 0.03
    grey_window_px: int = 9
    outline_share: float = 0.4
    outline_window_px: int = 7
    smeared_share: float = 0.25
    closing_px: int = 5
    closing_hint_px: int = 5
    max_hole_px: float = 300.0
    min_area_px: float = 150.0
    min_area_share: float = 0.02
    adaptation: float = 0.005
    hold_frames: int | None = None
    compensate_gain: bool = True
    max_foreground_share: float = 0.6

    def __post_init__(self) -> None:
        if self.method not in METHODS:
            raise ValueError(f"method: expected one of {', '.join(METHODS)}, got {self.method!r}")
        if not 0 <= self.adaptation < 1:
            raise ValueError(f"adaptation: expected 0 <= adaptation < 1, got {self.adaptation}")
        if self.hold_frames is not None and self.hold_frames < 1:
            raise ValueError(f"hold_frames: expected at least 1 or None, got {self.hold_frames}")


@dataclass(frozen=True, eq=False)
class ForegroundMask:
    """One segmented picture.

    mask : (H, W) bool, the person.  shadow : (H, W) bool, darker than the background but of its colour.
    doubtful : (H, W) bool, pixels of the mask that are so as well, and were kept for their surroundings' sake.
    foreground_share, shadow_share : shares of the picture.
    is_usable : False when the foreground fills so much of the picture that the background must be wrong.
    box : u0, u1, v0, v1, inclusive, outside which there is neither; 0, -1, 0, -1 for nothing.
    """

    mask: Mask
    shadow: Mask
    doubtful: Mask
    foreground_share: float
    shadow_share: float
    is_usable: bool
    box: tuple[int, int, int, int]


class _Window(NamedTuple):
    """A part of the picture that is looked at closely, [y0, y1) x [x0, x1); ."""

    y0: int
    y1: int
    x0: int
    x1: int

    def overlaps(self, other: _Window) -> bool:
        return self.y0 < other.y1 and other.y0 < self.y1 and self.x0 < other.x1 and other.x0 < self.x1

    def joined(self, other: _Window) -> _Window:
        return _Window(
            min(self.y0, other.y0), max(self.y1, other.y1), min(self.x0, other.x0), max(self.x1, other.x1)
        )

    @property
    def slices(self) -> tuple[slice, slice]:
        return slice(self.y0, self.y1), slice(self.x0, self.x1)


class _Regions(NamedTuple):
    """Connected regions as runs along rows; see _kernels.label_regions."""

    runs: NDArray[np.int32]
    n_runs: int
    area: NDArray[np.int64]
    flagged: NDArray[np.int64]


class Segmenter:
    """Splits the pictures of one camera, in order; keeps the slowly adapting background between them.

    Only pixels that are neither foreground nor shadow adapt, so a person who stands still is not absorbed; see
    hold_frames and `protect`. One Segmenter per camera and clip; not to be shared between threads.
    roi : (H, W) bool, where a person can be; None = everywhere. Outside, nothing is foreground.
    Only windows around cells of 16 x 16 pixels with differences in every fourth row are looked at closely.
    Source: CF 2.2.3. Departs from it: one Gaussian per pixel instead of a mixture, and a shadow test on the
    colour averaged over a window, because a person whose clothes have nearly the colour of the wall is lost
    otherwise ('mog2' keeps the mixture).
    """

    def __init__(
        self, background: Background, settings: ForegroundSettings | None = None, *, roi: Mask | None = None
    ) -> None:
        self.settings = s = settings or ForegroundSettings()
        self.shape = background.mean.shape
        height, width = self.shape[:2]
        if roi is not None and roi.shape != (height, width):
            raise ValueError(f"roi: expected shape {(height, width)}, got {roi.shape}")
        self._n_seen = 0
        self._colour_noise = 0.0
        self._learnt = background
        self._set_colours(is_grey=background.is_grey)
        self._learnt_noise = float(np.median(background.std))
        limit = np.maximum(s.threshold_sigma * largest_channel(background.std), s.min_difference)
        limit += s.edge_jitter_px * _slope(self._background.reshape(self.shape))
        self._limit = limit.astype(np.float32)
        self._outside = np.zeros((height, width), dtype=np.uint8)
        if roi is not None:
            self._outside = (~roi).astype(np.uint8)
        self._set_noise(1.0)
        self._covered = _NOTHING if background.covered is None else background.covered.astype(np.uint8)
        if roi is not None and self._covered.size:
            self._covered[~roi] = 0
        if self._covered.size:
            self._covered_in_cells = _count_in_cells(self._covered)
        self._near = self._outside.copy()
        self._touched: list[_Window] = []  # where _near differs from _outside
        self._age = np.zeros((height, width) if s.hold_frames is not None else (0, 0), dtype=np.uint16)
        self._subtractor = None
        if s.method != "gaussian":
            self._subtractor = _trained_subtractor(s.method, background)

    def _set_colours(self, *, is_grey: bool) -> None:
        """Look at all colours, or at nothing but the brightness.  Begins anew from the background that was learnt."""
        s = self.settings
        self._is_grey = is_grey
        self._edge, self._window_px = (
            (s.grey_edge, s.grey_window_px) if is_grey else (s.shadow_edge, s.shadow_window_px)
        )
        mean = np.array(self._learnt.mean, dtype=np.float32)
        shown = np.clip(np.round(mean), 0, 255).astype(np.uint8)
        if is_grey:
            shown = as_grey(shown)
            mean = shown.astype(np.float32)
        self._mean, self._background = mean.reshape(len(mean), -1), shown.reshape(len(shown), -1)

    def _set_noise(self, times: float) -> None:
        """Thresholds for pictures that are so many times as noisy as was learnt."""
        s = self.settings
        self._times_noise = times
        self._noise = times * self._learnt_noise
        self._weak_level = 0.5 * max(s.min_difference, s.threshold_sigma * self._learnt_noise) * times
        self._threshold = np.clip(np.round(times * self._limit), 1, 254).astype(np.uint8)
        self._threshold[self._outside != 0] = 255  # which no difference exceeds

    @property
    def background(self) -> Image:
        """The background as it is now, (H, W, 3) uint8 RGB."""
        return self._background.reshape(self.shape).copy()

    def segment(self, image: Image, *, protect: Mask | None = None) -> ForegroundMask:
        """Foreground of the next picture, (H, W, 3) uint8 RGB.

        protect : (H, W) bool, pixels that are known to show a person, for example the reprojected body of a track:
        they are not absorbed into the background however long they stay. It does not change this mask.
        Raises ValueError for another shape than the background's.
        """
        self._check(image, protect)
        if self._learnt.is_noisy:
            image = calmed(image)
        if self._is_grey and not are_grey([image]):
            self._set_colours(is_grey=False)  # somebody in colour came into a grey room
        if self._is_grey:
            image = as_grey(image)
        if self._subtractor is not None:
            raw = self._subtractor.apply(image, learningRate=_OPENCV_RATE[self.settings.method])
            raw[self._outside != 0] = 0
            kept = clean_mask(raw == 255, self.settings)
            height, width = self.shape[:2]
            whole = _Window(0, height, 0, width)
            return self._answer(kept.astype(np.uint8), (raw == 127).astype(np.uint8), [whole])
        # The kernels are compiled for writable contiguous arrays; any other kind would be compiled anew.
        rows = np.require(image, requirements=("C", "W")).reshape(self.shape[0], -1)
        if self.settings.compensate_gain:
            rows = self._without_gain(rows)
            self._follow_noise(rows, image)
        dark = np.zeros(self.shape[:2], dtype=np.uint8)
        windows = self._windows(rows)
        mask = self._joined([self._split(rows, window, dark) for window in windows])
        if self.settings.adaptation > 0 or self.settings.hold_frames is not None:
            self._adapt(rows, protect)
        return self._answer(mask, dark, windows)

    def _check(self, image: Image, protect: Mask | None) -> None:
        """ValueError for pictures of another kind than the background."""
        if image.shape != self.shape or image.dtype != np.uint8:
            raise ValueError(f"image: expected uint8 of shape {self.shape}, got {image.dtype} {image.shape}")
        if protect is not None and (protect.shape != self.shape[:2] or protect.dtype != np.bool_):
            raise ValueError(
                f"protect: expected bool of shape {self.shape[:2]}, got {protect.dtype} {protect.shape}"
            )

    def _joined(self, pieces: list[tuple[_Window, Bytes, _Regions]]) -> Bytes:
        """The mask (H, W) of all windows without small regions."""
        mask = np.zeros(self.shape[:2], dtype=np.uint8)
        least = self.settings.min_area_px * _area_scale(self.shape)
        for _, _, regions in pieces:
            least = max(least, self.settings.min_area_share * regions.area.max(initial=0))
        self._clear_near()
        self._touched = [window for window, _, _ in pieces]
        for window, found, regions in pieces:
            drop = (regions.area < least) | (regions.flagged == 0)
            _kernels.paint_regions(found, regions.runs, regions.n_runs, drop, 0)
            width = window.x1 - window.x0
            mask[window.slices] = found[:, :width]
            self._near[window.slices] |= cv2.dilate(found, _square(5))[:, :width]
        return mask

    def _answer(self, mask: Bytes, dark: Bytes, windows: list[_Window]) -> ForegroundMask:
        """dark : (H, W) uint8, SHADOW or DOUBTFUL, becomes the shadow: what is foreground is none.  windows : with all
        of both."""
        doubtful = np.zeros_like(mask)
        n_mask, n_shadow = 0, 0
        for window in windows:
            here = window.slices
            n, m = _kernels.tell_apart(mask[here], dark[here], doubtful[here])
            n_mask, n_shadow = n_mask + n, n_shadow + m
        share = n_mask / mask.size
        whole = reduce(_Window.joined, windows) if windows else _Window(0, 0, 0, 0)
        return ForegroundMask(
            mask.view(np.bool_), dark.view(np.bool_), doubtful.view(np.bool_), share, n_shadow / mask.size,
            share <= self.settings.max_foreground_share, (whole.x0, whole.x1 - 1, whole.y0, whole.y1 - 1),
        )  # fmt: skip

    def _without_gain(self, rows: Bytes) -> Bytes:
        step = max(1, _scaled_px(_GAIN_STEP, self.shape))
        gain = np.empty(3)
        n = _kernels.median_gain(rows, self._background, self._near, step, gain)
        if n * step * step < _FREE_SHARE * self._near.size:
            # The light changed, all became foreground, and nothing would be left to tell the gain from.
            self._forget_foreground()
            n = _kernels.median_gain(rows, self._background, self._near, step, gain)
            if n * step * step < _FREE_SHARE * self._near.size:
                return rows
        if (field := self._light_field(rows, float(gain.mean()))) is not None:
            light = np.clip(field[:, :, None] * (gain / gain.mean()).astype(np.float32), 0.4, 2.5)
            even = np.clip(np.round(rows.reshape(self.shape) / light), 0, 255).astype(np.uint8)
            if self._share_that_differs(even, step) < _MOST_LEFT:
                return even.reshape(rows.shape)
            # Else no light explains it: another place, another camera.
        if np.abs(gain - 1).max() < 0.004:
            return rows
        factor = np.round(65536 / np.clip(gain, 0.5, 2.0)).astype(np.uint32)
        out = np.empty_like(rows)
        _kernels.scale_rows(rows, self._background, factor, out)
        return out

    def _forget_foreground(self) -> None:
        """Take no part of the picture for a person's until the next one has been split."""
        self._clear_near()
        self._touched = []

    def _clear_near(self) -> None:
        for window in self._touched:
            self._near[window.slices] = self._outside[window.slices]

    def _follow_noise(self, rows: Bytes, image: Image) -> None:
        """Raise the thresholds where the picture is noisier than the background was: more gain, more compression.

        image : as it was stored, with the steps of its colours.
        """
        step = max(1, _scaled_px(_GAIN_STEP, self.shape))
        height, width = self.shape[:2]
        ratios = np.empty(-(-height // step) * -(-width // step), dtype=np.float32)
        n = _kernels.sampled_ratios(rows, self._background, self._limit, self._near, step, ratios)
        if n < _LEAST_SAMPLES:
            return
        times = _THREE_SIGMA * _usual(ratios[:n])
        times = times if _NOISIER < times < _MOST_NOISE else 1.0
        if abs(times - self._times_noise) > _NOISE_STEP * self._times_noise:
            self._set_noise(times)
        if self._n_seen % _COLOUR_EVERY == 0:
            self._colour_noise = max(self._colour_noise_of(rows), _COARSE * colour_step(image))

    def _colour_noise_of(self, rows: Bytes) -> float:
        """Three standard deviations of the colour, grey levels, averaged over blocks as compression leaves them."""
        height, width = self.shape[:2]
        size = (max(1, width // _BLOCK_PX), max(1, height // _BLOCK_PX))
        picture, background = (
            cv2.resize(image.reshape(self.shape), size, interpolation=cv2.INTER_AREA).astype(np.float32)
            for image in (rows, self._background)
        )
        free = cv2.resize(self._near, size, interpolation=cv2.INTER_NEAREST) == 0
        if np.count_nonzero(free) < _LEAST_SAMPLES:
            return self._colour_noise
        picture, background = picture[free], background[free]
        ratio = (picture * background).sum(axis=1) / ((background * background).sum(axis=1) + 1)
        residual = np.abs(picture - ratio[:, None] * background).max(axis=1)
        return _THREE_SIGMA * _usual(residual)

    def _share_that_differs(self, picture: Image, step: int) -> float:
        """Share of the looked-at pixels, every `step`-th each way, that are not the background's."""
        some = (slice(None, None, step), slice(None, None, step))
        difference = cv2.absdiff(
            np.ascontiguousarray(picture[some]),
            np.ascontiguousarray(self._background.reshape(self.shape)[some]),
        )
        return float((largest_channel(difference) > self._threshold[some]).mean())

    def _light_field(self, rows: Bytes, gain: float) -> NDArray[np.float32] | None:
        """The light relative to the background, (H, W), where it has changed unevenly; None where it has not."""
        height, width = self.shape[:2]
        w, h = (_scaled_px(length, self.shape) for length in _LIGHT_CELL_PX)
        cells = np.empty((-(-height // h), -(-width // w)), dtype=np.float32)
        for step in _LIGHT_STEPS_PX:  # a quick look first, at most pictures the only one
            _kernels.cell_gains(rows, self._background, self._near, _scaled_px(step, self.shape), w, h, cells)
            levels = (np.float32(level) for level in (gain, _UNEVEN * gain, _JUMP * gain))
            if _kernels.count_uneven(cells, *levels) < _UNEVEN_SHARE * cells.size:
                return None
        known = cells > 0
        cells[~known] = gain
        even = known & (np.abs(cells - cv2.medianBlur(cells, 5)) < _JUMP * gain)
        near = cv2.GaussianBlur(even.astype(np.float32), (0, 0), 1.0)
        around = cv2.GaussianBlur(np.where(even, cells, np.float32(0)), (0, 0), 1.0)
        cells = np.where(even, cells, np.where(near > 1e-3, around / np.maximum(near, 1e-3), gain))
        field = cv2.resize(cells.astype(np.float32), (cells.shape[1] * w, cells.shape[0] * h))
        return np.ascontiguousarray(field[:height, :width])

    def _windows(self, rows: Bytes) -> list[_Window]:
        """Where the picture differs from the background, with a margin; none of them overlap."""
        height, width = self.shape[:2]
        cell = _kernels.CELL
        counts = np.zeros((-(-height // cell), -(-width // cell)), dtype=np.int32)
        first = min(1, height - 1)
        _kernels.count_differences(rows, self._background, self._threshold, first, _SEARCH_ROWS, counts)
        if self._covered.size:
            counts += self._covered_in_cells
        active = (counts >= _SEARCH_LEAST).view(np.uint8)
        if not active.any():
            return []
        s = self.settings
        longest = max(s.closing_px, s.closing_hint_px, s.outline_window_px, self._window_px)
        margin = 1 + _scaled_px(longest, self.shape) // cell
        grown = cv2.dilate(active, _square(2 * margin + 1))
        n, labels, stats, _ = cv2.connectedComponentsWithStats(grown, connectivity=8)
        found = np.bincount(labels.ravel(), counts.ravel(), n) * _SEARCH_ROWS
        windows: list[_Window] = []
        for i in range(1, n):
            if found[i] < 0.25 * s.min_area_px * _area_scale(self.shape):
                continue
            x, y, w, h = (cell * int(v) for v in stats[i, :4])
            windows.append(_Window(y, min(y + h, height), x, min(x + w, width)))
        return _without_overlaps(windows)

    def _split(self, rows: Bytes, window: _Window, shadow: Bytes) -> tuple[_Window, Bytes, _Regions]:
        """Where in the window foreground is, that part as (h, w) uint8 of 0 and 1, and its regions.

        shadow : (H, W) uint8, SHADOW or DOUBTFUL, written inside the window.  w is rounded up to multiples of 8;
        columns beyond the picture are 0.
        """
        s = self.settings
        width = window.x1 - window.x0
        planes = np.zeros((5, window.y1 - window.y0, -(-width // 8) * 8), dtype=np.uint8)
        largest, candidate, solid, foreground, dark = planes
        _kernels.difference(
            rows, self._background, self._threshold, window.y0, window.x0, width, largest, candidate
        )
        _kernels.majority(candidate, solid)
        self._take_out_smeared(rows, window, solid, largest)
        # The window averages noise, which small pictures have no less of.
        side = _odd(max(_scaled_px(self._window_px, self.shape), self._window_px))
        rule = _kernels.ShadowRule(
            half=side // 2,
            darkest=s.shadow_darkest,
            brightest=s.shadow_brightest,
            chroma_pixel=max(s.shadow_chroma_pixel, 4.0 * self._noise, 3.0 * self._colour_noise),
            chroma=s.shadow_chroma,
            least_chroma=max(s.shadow_chroma_least, 2.5 * self._noise * 2**0.5 / side, self._colour_noise),
            edge=self._edge,
            noise=_EDGE_NOISE * self._noise,
        )
        place = (window.y0, window.x0, width)
        _kernels.shadow_test(rows, self._background, place, solid, rule, foreground, dark)
        if self._covered.size:
            always = self._covered[window.slices]
            foreground[:, :width] |= always
            dark[:, :width] *= always ^ 1
            np.maximum(largest[:, :width], always * round(s.strong_difference + 1), out=largest[:, :width])
        shadow[window.slices] = dark[:, :width]
        # Specks in the shadow would be joined to the person by the closing.
        specks = _regions(foreground, _strong(largest, s), 1)
        drop = (specks.area < 0.25 * s.min_area_px * _area_scale(self.shape)) | (specks.flagged == 0)
        _kernels.paint_regions(foreground, specks.runs, specks.n_runs, drop, 0)
        # What follows touches only the surroundings of the foreground, which are often a small part of the window.
        longest = max(s.closing_px, s.closing_hint_px, s.outline_window_px)
        rows_of, columns_of = _around(
            specks, ~drop, 1 + _odd(_scaled_px(longest, self.shape)), foreground.shape
        )
        inside, dark_inside, differs, far = (
            np.ascontiguousarray(p[rows_of, columns_of]) for p in (foreground, dark, solid, largest)
        )
        _trim_outline(inside, far, s, self.shape)
        found = _closed(inside, dark_inside & _kernels.SHADOW, differs, far, self._weak_level, s, self.shape)
        y, x = window.y0 + rows_of.start, window.x0 + columns_of.start
        inner = _Window(y, y + found.shape[0], x, min(x + found.shape[1], self.shape[1]))
        return inner, found, _regions(found, _strong(far, s), 1)

    def _take_out_smeared(self, rows: Bytes, window: _Window, candidate: Bytes, largest: Bytes) -> None:
        """Takes colour that compression smears round a person out of the candidates of the window, in place; what is
        left of `largest` there is the difference in brightness.
        """
        s = self.settings
        x, y, w, h = cv2.boundingRect(candidate)
        if not w:
            return
        here = (slice(window.y0 + y, window.y0 + y + h), slice(window.x0 + x, window.x0 + x + w))
        picture, background = (
            cv2.cvtColor(image.reshape(self.shape)[here], cv2.COLOR_RGB2YCrCb)
            for image in (rows, self._background)
        )
        bright, red, blue = cv2.split(cv2.absdiff(picture, background))
        brightness, colour = (cv2.blur(difference, (3, 3)) for difference in (bright, cv2.max(red, blue)))
        around = cv2.dilate(colour, _square(2 * _COLOUR_BLOCK_PX - 1))
        smeared = colour < cv2.convertScaleAbs(around, alpha=s.smeared_share)
        smeared &= brightness < math.ceil(s.min_difference)  # as whole as brightness is
        inside = (slice(y, y + h), slice(x, x + w))
        candidate[inside] &= ~smeared
        np.copyto(largest[inside], bright, where=smeared)

    def _adapt(self, rows: Bytes, protect: Mask | None) -> None:
        s = self.settings
        rate = np.float32(1 - (1 - s.adaptation) ** _ADAPT_ROWS)
        patience = -1 if s.hold_frames is None else min(s.hold_frames // _ADAPT_ROWS, 65535)
        _kernels.adapt_rows(
            rows, self._background, self._mean, self._threshold, self._near,
            _NOTHING if protect is None else np.ascontiguousarray(protect).view(np.uint8), self._age,
            self._n_seen % _ADAPT_ROWS, _ADAPT_ROWS, rate, patience,
        )  # fmt: skip
        self._n_seen += 1


def colour_step(picture: Image) -> int:
    """Levels between neighbouring chrominances of a picture (H, W, 3) uint8 RGB as compression has rounded them; 1 when
    they are fine, or when the picture does not tell.

    Rounding leaves whole blocks of one chrominance, and most that differ from those beside them do by one step.
    """
    side = _COLOUR_BLOCK_PX // 2  # of a picture at half its size, too
    coded = cv2.cvtColor(picture, cv2.COLOR_RGB2YCrCb)
    # Of every cell the inner part: decoders blur the borders of blocks.
    lowest, highest = (
        bound(coded, _square(side // 2))[side // 2 :: side, side // 2 :: side, 1:]
        for bound in (cv2.erode, cv2.dilate)
    )
    level = np.where(highest - lowest <= 1, highest, np.nan)
    apart = np.abs(np.concatenate([np.diff(level, axis=axis).ravel() for axis in (0, 1)]))
    n_even, apart = np.count_nonzero(apart >= 0), apart[apart > 0]
    if len(apart) < max(_LEAST_SAMPLES, _ROUNDED_SHARE * n_even):
        return 1
    step = int(np.quantile(apart, _SMALL_STEPS))
    is_one = np.count_nonzero(np.abs(apart - step) <= 1) >= 0.5 * len(apart)
    return step if is_one and step <= _COARSEST_STEP else 1


def _usual(values: NDArray[np.float32]) -> float:
    """What most values do not exceed."""
    k = int(_USUAL * len(values))
    return float(np.partition(values, k)[k])


def clean_mask(mask: Mask, settings: ForegroundSettings | None = None) -> Mask:
    """A mask without specks, small gaps and small holes.

    mask : (H, W) bool. Regions below min_area_px or min_area_share of the largest go; gaps up to closing_px
    close; holes up to min_area_px are filled (larger ones may be the view between an arm and the body).
    An empty mask stays empty.
    """
    s = settings or ForegroundSettings()
    height, width = mask.shape
    raw = np.zeros((height, -(-width // 8) * 8), dtype=np.uint8)
    raw[:, :width] = mask
    regions = _regions(raw, raw, 1)
    least = max(s.min_area_px * _area_scale(mask.shape), s.min_area_share * regions.area.max(initial=0))
    _kernels.paint_regions(raw, regions.runs, regions.n_runs, regions.area < least, 0)
    closed = cv2.morphologyEx(raw, cv2.MORPH_CLOSE, _disc(_odd(_scaled_px(s.closing_px, mask.shape))))
    holes = _regions(closed, closed, 0)
    small = holes.area < s.min_area_px * _area_scale(mask.shape)
    _kernels.paint_regions(closed, holes.runs, holes.n_runs, small, 1)
    return closed[:, :width].astype(np.bool_)


def _without_overlaps(windows: list[_Window]) -> list[_Window]:
    """Windows that overlap are joined; all are when there are many."""
    if len(windows) > _MAX_WINDOWS:
        whole = windows[0]
        for window in windows[1:]:
            whole = whole.joined(window)
        return [whole]
    apart: list[_Window] = []
    for window in windows:
        # A joined window may overlap one that was passed already.
        while any(window.overlaps(other) for other in apart):
            for other in [o for o in apart if window.overlaps(o)]:
                apart.remove(other)
                window = window.joined(other)
        apart.append(window)
    return apart


def _count_in_cells(mask: Bytes) -> NDArray[np.int32]:
    """Ones of a mask (H, W) in every cell of the search."""
    cell = _kernels.CELL
    height, width = mask.shape
    padded = np.pad(mask, ((0, -height % cell), (0, -width % cell)))
    cells = padded.reshape(padded.shape[0] // cell, cell, padded.shape[1] // cell, cell)
    return cells.sum(axis=(1, 3), dtype=np.int32)


def _slope(background: Image) -> NDArray[np.float32]:
    """Largest difference to a neighbouring pixel over the channels, (H, W) grey levels per pixel."""
    above = cv2.dilate(background, _square(3)) - background
    below = background - cv2.erode(background, _square(3))
    return largest_channel(np.maximum(above, below)).astype(np.float32)


def _area_scale(shape: tuple[int, ...]) -> float:
    return shape[0] * shape[1] / _REFERENCE_PIXELS


def _scaled_px(length: float, shape: tuple[int, ...]) -> int:
    return max(1, round(length * _area_scale(shape) ** 0.5))


def _odd(length: int) -> int:
    return length | 1


@cache
def _square(side: int) -> Bytes:
    return np.ones((side, side), dtype=np.uint8)


@cache
def _disc(side: int) -> Bytes:
    return cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (side, side))


def _strong(largest: Bytes, s: ForegroundSettings) -> Bytes:
    return cv2.threshold(largest, s.strong_difference, 1, cv2.THRESH_BINARY)[1]


def _around(regions: _Regions, chosen: Mask, margin: int, shape: tuple[int, ...]) -> tuple[slice, slice]:
    """Rows and columns of the chosen regions with a margin; columns are multiples of 8."""
    y0, y1, x0, x1 = _kernels.bounds_of(regions.runs, regions.n_runs, chosen)
    rows = slice(max(y0 - margin, 0), min(y1 + margin, shape[0]))
    return rows, slice(max(x0 - margin, 0) // 8 * 8, min((x1 + margin + 7) // 8 * 8, shape[1]))


def _trim_outline(foreground: Bytes, largest: Bytes, s: ForegroundSettings, shape: tuple[int, ...]) -> None:
    """Takes blurred rims out of the foreground, in place."""
    if s.outline_share <= 0:
        return
    side = _odd(_scaled_px(s.outline_window_px, shape))
    core = cv2.erode(foreground, _square(3))
    beside = cv2.dilate(foreground, _square(3)) ^ 1
    deep = cv2.erode(foreground, _square(_odd(max(side - 2, 3))))
    _kernels.trim_outline(
        foreground, core, beside, deep, core * largest, beside * largest, largest, side // 2, s.outline_share
    )


def _closed(
    foreground: Bytes,
    shadow: Bytes,
    differs: Bytes,
    largest: Bytes,
    weak_level: float,
    s: ForegroundSettings,
    shape: tuple[int, ...],
) -> Bytes:
    """Gaps and holes closed where the picture differs from the background."""
    scale = _area_scale(shape)
    closing = cv2.morphologyEx(foreground, cv2.MORPH_CLOSE, _disc(_odd(_scaled_px(s.closing_px, shape))))
    mask = foreground | (closing & differs)
    # Clothes of nearly the colour of the wall: each pixel is within the threshold, their average is not noise.
    # The average leaves the foreground and its blurred rim out.
    beside = cv2.dilate(mask, _square(3)) ^ 1
    total = cv2.boxFilter(largest * beside, cv2.CV_16S, (5, 5), normalize=False)
    count = cv2.boxFilter(beside, cv2.CV_16S, (5, 5), normalize=False)
    # In whole numbers of half a level, which 16 bits hold: no sum exceeds 25 x 255.
    hint = (2 * total >= np.int16(min(round(2 * weak_level), 500)) * count).view(np.uint8) & (shadow ^ 1)
    closing = cv2.morphologyEx(mask, cv2.MORPH_CLOSE, _disc(_odd(_scaled_px(s.closing_hint_px, shape))))
    mask |= closing & hint
    holes = _regions(mask, differs | hint, 0)
    fill = holes.area < 0.2 * s.min_area_px * scale
    fill |= (holes.flagged > 0.5 * holes.area) & (holes.area < s.max_hole_px * scale)
    _kernels.paint_regions(mask, holes.runs, holes.n_runs, fill, 1)
    return mask


def _regions(mask: Bytes, flags: Bytes, value: int) -> _Regions:
    """Regions of the ones (corners join them) or of the zeros (corners do not) of a mask."""
    most = mask.shape[0] * (mask.shape[1] // 2 + 1)
    runs = np.empty((most, 4), dtype=np.int32)
    area, flagged = np.empty(most, dtype=np.int64), np.empty(most, dtype=np.int64)
    n_runs, n = _kernels.label_regions(mask, flags, value, value, runs, area, flagged)
    return _Regions(runs, n_runs, area[:n], flagged[:n])


def _trained_subtractor(method: str, background: Background) -> Any:
    """OpenCV's model, trained on pictures drawn from the background statistics (fixed seed)."""
    model: Any
    if method == "mog2":
        model = cv2.createBackgroundSubtractorMOG2(detectShadows=True)
        model.setShadowThreshold(0.7)
    else:
        model = cv2.createBackgroundSubtractorKNN(detectShadows=True)
        # Its default of 0.5 takes more of dark clothes for shadow.
        model.setShadowThreshold(0.6)
    rng = np.random.default_rng(0)
    for _ in range(_TRAIN):
        drawn = background.mean + background.std * rng.standard_normal(
            background.mean.shape, dtype=np.float32
        )
        model.apply(np.clip(np.round(drawn), 0, 255).astype(np.uint8))
    return model
