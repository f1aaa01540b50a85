"""Background model: per-pixel mean and spread of the empty scene, from a clip, the running scene or a still."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from mocap.arrays import Image, Mask
from mocap.foreground import _kernels

MAX_SAMPLES = 31  # pictures kept in memory; more improve neither mean nor spread noticeably
STD_FLOOR = 1.2  # levels; compression freezes flat regions, their measured spread is 0
_STILL_STD_FLOOR = 2.0  # a still says nothing about flicker
_FAR = 20  # levels from the usual colour that count as "something else was here"
_MOVED_IN_EMPTY = 0.02
_MOVED_IN_MEDIAN = 0.01
COVERED_WORTH_A_WORD = 0.001  # of the picture
# Steps by which a chrominance of a camera without colours may be off that of the whole picture, and the share of the
# picture that may be further off. Compression tints all of it, by up to 8 levels of grey_few; noise of a colour camera
# before a grey wall is not even.
_GREY_STEPS, _MOST_COLOURED = 3, 0.001
# Levels of standard deviation from which pictures are calmed (below, errors of people are the same without), and how:
# over how many pixels, and how far apart the colours of one surface may be (decision 126).
_NOISY = 5.0
_CALMED_PX, _CALMED_SIGMA_PX, _CALMED_LEVELS = 5, 1.5, 80.0
EMPTY_REDUCTION = 2  # a pixel of 640 x 480 sees a centimetre of the floor, half of what is asked of it


@dataclass(frozen=True, eq=False)
class Background:
    """Per-pixel, per-channel statistics of the empty scene of one camera.

    mean, std : (H, W, 3) float32, grey levels.
    n_images : how many pictures were used.  kind : 'clip', 'median', 'still' or 'recording'.
    moving_share : share of the pixels at which some picture is far from the usual colour, or shows a person.
    covered : (H, W) bool, pixels that no picture shows empty: a person is always there; None = none.
    told_share : share of the pixels that no picture of this camera shows empty, and that others know.
    is_grey : no picture has colours, but for one tint: the camera sees none, or only the room has none.
    is_noisy : mean and std are those of `calmed` pictures, and what is compared with them is to be calmed, too.
    """

    mean: NDArray[np.float32]
    std: NDArray[np.float32]
    n_images: int
    kind: str
    moving_share: float
    covered: Mask | None = None
    told_share: float = 0.0
    is_grey: bool = False
    is_noisy: bool = False

    @property
    def holds_somebody(self) -> bool:
        """Whether so much was never seen empty that the outlines of who stays there are guesses."""
        return self.covered_share + self.told_share > COVERED_WORTH_A_WORD

    @property
    def covered_share(self) -> float:
        """Share of the pixels that are covered."""
        return 0.0 if self.covered is None else float(self.covered.mean())

    @property
    def warnings(self) -> tuple[str, ...]:
        """What makes this background doubtful, in words; empty when nothing does."""
        if self.kind == "clip" and self.moving_share > _MOVED_IN_EMPTY:
            return (f"something moves in {self.moving_share:.0%} of the picture of the empty-scene clip",)
        if self.kind == "median" and self.moving_share < _MOVED_IN_MEDIAN:
            return (
                "hardly anything moves in this clip: a person who stays in place is learnt as background; "
                "record an empty scene",
            )
        return ()


def learn_background(images: Iterable[Image]) -> Background:
    """Background from pictures of the empty scene; a single picture gives a 'still'.

    images : (H, W, 3) uint8 RGB each; at most 31 of them, evenly spread, are kept in memory.
    Per pixel and channel: the shortest interval that holds half of the samples, then mean and standard
    deviation of the samples within 2.5 spreads + 3 levels of its middle, so that somebody who crosses the
    clip leaves no trace. The standard deviation is at least 1.2 levels (2 for a still, whose noise is
    estimated from its fine structure).
    Raises ValueError for no picture or pictures of different shapes.
    Source: CF 2.2.3 (statistical background learnt from an empty scene).
    """
    samples = thinned(images)
    if len(samples) == 1:
        return _calmed_if_noisy(lambda shown: _still(shown[0]), samples)
    return _calmed_if_noisy(lambda shown: _statistics(shown, "clip"), samples)


def median_background(images: Iterable[Image]) -> Background:
    """Background from the clip itself, in which every place is empty in more than half of the pictures.

    images, errors : as of learn_background. Look at `warnings`: a person who never moves is learnt as
    background.
    """
    samples = thinned(images)
    return _calmed_if_noisy(lambda shown: _statistics(shown, "median"), samples)


def empty_picture(background: Background) -> NDArray[np.uint8]:
    """What a camera shows while nobody is there, (H // 2, W // 2, 4) uint8 RGBA; alpha is 0 where it was never seen."""
    size = tuple(length // EMPTY_REDUCTION for length in background.mean.shape[1::-1])
    whole = slice(size[1] * EMPTY_REDUCTION), slice(size[0] * EMPTY_REDUCTION)
    covered = np.zeros_like(background.mean[..., 0]) if background.covered is None else background.covered
    colour, share = (
        cv2.resize(part[whole].astype(np.float32), size, interpolation=cv2.INTER_AREA)
        for part in (background.mean, covered)
    )
    shown = np.clip(np.round(colour), 0, 255)
    return np.dstack([shown, np.where(share > 0, 0, 255)]).astype(np.uint8)


def thinned(images: Iterable[Image]) -> list[Image]:
    """Every 2^j-th picture, between 16 and 31 of a long clip; constant memory."""
    kept: list[Image] = []
    stride = 1
    for i, image in enumerate(images):
        _check_picture(image, i, kept[0].shape if kept else None)
        if i % stride:
            continue
        if len(kept) == MAX_SAMPLES:
            kept = kept[::2]
            stride *= 2
            if i % stride:
                continue
        kept.append(np.array(image))
    if not kept:
        raise ValueError("images: expected at least one picture of the scene, got none")
    return kept


def are_grey(pictures: Iterable[Image]) -> bool:
    """Whether no picture, (H, W, 3) uint8 RGB, has colours: nearly all of it has one tint."""
    return all(_coloured_share(picture) <= _MOST_COLOURED for picture in pictures)


def _coloured_share(picture: Image) -> float:
    some = cv2.cvtColor(np.ascontiguousarray(picture[::4, ::4]), cv2.COLOR_RGB2YCrCb)[..., 1:].reshape(-1, 2)
    off = np.abs(some - np.median(some, axis=0))
    return float((off > _GREY_STEPS).any(axis=1).mean())


def as_grey(picture: Image) -> Image:
    """A picture (H, W, 3) uint8 RGB with its brightness in all channels."""
    return cv2.cvtColor(brightness_of(picture), cv2.COLOR_GRAY2RGB).astype(np.uint8, copy=False)


def brightness_of(picture: Image) -> NDArray[np.uint8]:
    """The brightness (H, W) uint8 of a picture (H, W, 3) uint8 RGB."""
    return cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY).astype(np.uint8, copy=False)


def _check_picture(image: Image, i: int, shape: tuple[int, ...] | None) -> None:
    """ValueError for picture i if it is no colour picture, or has another shape than the first one."""
    if image.ndim != 3 or image.shape[2] != 3 or image.dtype != np.uint8:
        raise ValueError(f"images: expected (H, W, 3) uint8, got {image.shape} {image.dtype} at picture {i}")
    if shape is not None and image.shape != shape:
        raise ValueError(f"images: expected shape {shape} throughout, got {image.shape} at picture {i}")


def are_noisy(std: NDArray[np.float32]) -> bool:
    """Whether pictures of this spread, (H, W, 3) grey levels, hide much of a person in their noise.

    Three standard deviations are the least difference that is seen, and clothes differ from a room by tens of levels.
    """
    return float(np.median(std)) > _NOISY


def calmed(picture: Image) -> Image:
    """A picture (H, W, 3) uint8 RGB of a camera that has too little light, without most of its noise.

    Edges stay where they are.
    """
    calm = cv2.bilateralFilter(picture, _CALMED_PX, _CALMED_LEVELS, _CALMED_SIGMA_PX)
    return calm.astype(np.uint8, copy=False)


def _calmed_if_noisy(learn: Callable[[list[Image]], Background], samples: list[Image]) -> Background:
    """What is learnt of some pictures, or of the same pictures calmed if they are noisy."""
    background = learn(samples)
    if not are_noisy(background.std):
        return background
    return replace(learn([calmed(image) for image in samples]), is_noisy=True)


def _statistics(samples: list[Image], kind: str) -> Background:
    mean, std, moved = statistics_of(np.stack(samples), _FAR)
    # Single pixels are noise.
    pieces = cv2.morphologyEx(moved.any(axis=2).astype(np.uint8), cv2.MORPH_OPEN, np.ones((3, 3), np.uint8))
    moving = float(pieces.mean())
    return Background(mean, np.maximum(std, STD_FLOOR), len(samples), kind, moving, is_grey=are_grey(samples))


def statistics_of(
    stack: NDArray[np.uint8], far: int
) -> tuple[NDArray[np.float32], NDArray[np.float32], Mask]:
    """Robust mean and spread of pictures (N, H, W, 3), and where one is more than `far` levels off; (H, W, 3) each."""
    shape, flat = stack.shape[1:], stack.reshape(len(stack), -1)
    mean = np.empty(flat.shape[1], dtype=np.float32)
    std = np.empty(flat.shape[1], dtype=np.float32)
    moved = np.empty(flat.shape[1], dtype=np.uint8)
    _kernels.robust_statistics(flat, far, mean, std, moved)
    return mean.reshape(shape), std.reshape(shape), moved.reshape(shape) > 0


def _still(image: Image) -> Background:
    """Noise from the median absolute deviation of the picture from its own 3 x 3 median, per channel."""
    fine = image.astype(np.float32) - cv2.medianBlur(image, 3)
    noise = np.median(np.abs(fine), axis=(0, 1)) / 0.6745
    std = np.broadcast_to(np.maximum(noise, _STILL_STD_FLOOR).astype(np.float32), image.shape).copy()
    return Background(image.astype(np.float32), std, 1, "still", 0.0, is_grey=are_grey([image]))
