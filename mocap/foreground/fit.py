"""A background from a clip of its own, held against the recording: moved, of another place, or not empty.

The empty clip may be of another day. Its light is divided out picture by picture while the recording is segmented; the
rest is put right here, before: a camera that was pushed by some pixels, somebody or something that stood there.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from mocap.arrays import Image, Mask
from mocap.foreground import _kernels
from mocap.foreground.model import Background, are_grey, as_grey

LEAST_PICTURES = 3  # fewer do not tell what stands still from who walks past
_FAR = 20  # levels, after the light is divided out: something else is seen
_LEAST_SHIFT_PX, _MOST_SHIFT_PX = 0.4, 12.0  # of 640; below it the tolerance at edges is enough
_BETTER = 0.8  # times the difference that a shift must leave at most
# Of another place: likeness, and share of the picture that differs in every picture. The likeness is what correlations
# of the fine structure stay below in six tenths of the cells of a grid: whoever stays in the recording covers fewer.
# Clips of their recording have 0.98 or more, also with somebody in them, those of another camera 0.08 at most, through
# a lens of 3 % more focal length 0.29 to 0.63, of 5 % 0.45 at most (python -m eval.empty_clips).
_LEAST_LIKENESS, _LEAST_DIFFERING = 0.75, 0.005
_CELLS, _OF_CELLS = (10, 8), 0.6
_LEAST_TEXTURE = 1.5  # levels; rooms have 3 to 7. Bare walls are alike everywhere
_LEAST_CELLS = 8  # with texture
# Edges round what stands in one of two pictures, over those of the other picture at the same place: of regions near
# each other together, somebody who stays in the recording has 0.1 to 0.7, his shadow 1.4 at most, somebody in the clip
# mostly 2.1 and more (the same command, and people who sit at tables).
_STRONGER = 1.7
_DARK = 16.0  # levels below which edges are noise
_LEAST_THING_PX = 150.0  # of 640 x 480
_APART_PX = 16.0  # of 640: regions nearer to each other belong together
# What is not in the recording differs in so many of the pictures: in the others somebody may stand just there. The same
# command counts what is found of somebody in the clip.
_MOSTLY = 0.6
_RIM_PX = 5
# Mean and standard deviation, levels, below which a picture shows nothing: the camera is off, as camera faults have it.
_BLACK_LEVEL, _BLACK_CONTRAST = 16.0, 6.0


@dataclass(frozen=True, eq=False)
class Fit:
    """How a background fits a recording.

    background : shifted, and without what has gone.
    shift_px : (right, down) by which the clip was moved.  gone : (H, W) bool, where something stood in the clip that is
    not in the recording.  is_elsewhere : the clip shows another place, or the same through another lens; background is
    then as it was.  likeness : of its fine structure to that of the recording, 1 = the same, 0 = nothing in common.
    differing_share : of its pixels, that differ from every picture.
    """

    background: Background
    shift_px: tuple[float, float]
    gone: Mask
    is_elsewhere: bool
    likeness: float = 1.0
    differing_share: float = 0.0


def unfitted(background: Background) -> Fit:
    """A background as it is, where there is nothing to fit it to."""
    return Fit(
        background, (0.0, 0.0), np.zeros(background.mean.shape[:2], dtype=np.bool_), is_elsewhere=False
    )


def is_black(picture: Image) -> bool:
    """Whether a picture is of a camera that was off or covered."""
    return bool(picture.mean() < _BLACK_LEVEL and picture.std() < _BLACK_CONTRAST)


def fit_background(background: Background, pictures: Sequence[Image]) -> Fit:
    """A background of a clip of its own, fitted to pictures of the recording.

    pictures : (H, W, 3) uint8, at least LEAST_PICTURES, some seconds apart, with persons or without.
    Raises ValueError for fewer, or for another shape.
    """
    if len(pictures) < LEAST_PICTURES:
        raise ValueError(f"pictures: expected at least {LEAST_PICTURES}, got {len(pictures)}")
    if any(picture.shape != background.mean.shape for picture in pictures):
        raise ValueError(f"pictures: expected shape {background.mean.shape}, got {pictures[0].shape}")
    background = _with_colours_of(background, pictures)
    stack = np.stack([_in_light_of(background.mean, picture) for picture in pictures])
    usual = np.empty_like(stack[0])
    _kernels.medians(stack.reshape(len(stack), -1), usual.reshape(-1))
    shift = _shift(background.mean, usual)
    moved = background
    if shift != (0.0, 0.0):
        moved = replace(moved, mean=_shifted(background.mean, shift), std=_shifted(background.std, shift))
    n_differing = np.zeros(stack.shape[1:3], dtype=np.int64)
    for picture in stack:
        n_differing += cv2.inRange(cv2.absdiff(picture, moved.mean), (0, 0, 0), (_FAR, _FAR, _FAR)) == 0
    alike, differing = _likeness(moved.mean, usual), float((n_differing == len(stack)).mean())
    if alike < _LEAST_LIKENESS and differing > _LEAST_DIFFERING:
        return replace(unfitted(background), is_elsewhere=True, likeness=alike, differing_share=differing)
    gone = _gone(n_differing >= _MOSTLY * len(stack), moved.mean, usual)
    if gone.any():
        mean, std = moved.mean.copy(), moved.std.copy()
        mean[gone] = usual[gone]
        # Of noise: the median leaves out who walks past.
        spread = 1.4826 * np.median(np.abs(stack[:, gone] - usual[gone]), axis=0)
        std[gone] = np.maximum(np.median(moved.std), spread)
        moved = replace(moved, mean=mean, std=std)
    return Fit(moved, shift, gone, is_elsewhere=False, likeness=alike, differing_share=differing)


def _with_colours_of(background: Background, pictures: Sequence[Image]) -> Background:
    """The background as a camera sees it that sees colours, or none, in the recording: in a grey room people in colour
    tell, and at night a camera may have switched to infrared.
    """
    is_grey = are_grey(pictures)
    if is_grey == background.is_grey:
        return background
    shown = np.clip(np.round(background.mean), 0, 255).astype(np.uint8)
    mean = as_grey(shown).astype(np.float32) if is_grey else background.mean
    return replace(background, mean=mean, is_grey=is_grey)


def _in_light_of(mean: NDArray[np.float32], picture: Image) -> NDArray[np.float32]:
    """The picture with its light, channel by channel, as that of the background."""
    some = (slice(None, None, 8), slice(None, None, 8))
    gain = np.median((picture[some] + np.float32(1)) / (mean[some] + np.float32(1)), axis=(0, 1))
    return np.clip(picture / np.clip(gain, 0.3, 3.0), 0, 255).astype(np.float32)


def _brightness(picture: NDArray[np.float32]) -> NDArray[np.float32]:
    """Mean of the channels, (H, W): five times as fast as numpy's mean."""
    return (picture[..., 0] + picture[..., 1] + picture[..., 2]) / np.float32(3)


def _grey(picture: NDArray[np.float32]) -> NDArray[np.float32]:
    """Fine structure of a picture: its brightness less that of the surroundings, cut off at both ends."""
    grey = _brightness(picture)
    return np.clip(grey - cv2.GaussianBlur(grey, (0, 0), 8.0), -_FAR, _FAR)


def _likeness(mean: NDArray[np.float32], usual: NDArray[np.float32]) -> float:
    """How alike the fine structures of two pictures (H, W, 3) are where they have any, whoever stands in one of them: a
    quantile of the correlations of their cells; 1 where hardly any has texture.
    """
    a, b = (cv2.GaussianBlur(_grey(picture), (0, 0), 1.0) for picture in (mean, usual))
    both, own, other = (
        cv2.resize(product, _CELLS, interpolation=cv2.INTER_AREA) for product in (a * b, a * a, b * b)
    )
    textured = np.minimum(own, other) > _LEAST_TEXTURE**2
    if np.count_nonzero(textured) < _LEAST_CELLS:
        return 1.0
    return float(np.quantile(both[textured] / np.sqrt(own[textured] * other[textured]), _OF_CELLS))


def _shift(mean: NDArray[np.float32], usual: NDArray[np.float32]) -> tuple[float, float]:
    """By how many pixels (right, down) the background must move to fit; zeros where that is not clear or too little."""
    a, b = _grey(mean), _grey(usual)
    height, width = a.shape
    window = cv2.createHanningWindow((width, height), cv2.CV_32F)
    (right, down), _ = cv2.phaseCorrelate(a, b, window)
    scale = width / 640
    if not _LEAST_SHIFT_PX * scale <= np.hypot(right, down) <= _MOST_SHIFT_PX * scale:
        return 0.0, 0.0
    edge = int(np.ceil(_MOST_SHIFT_PX * scale))
    inner = (slice(edge, -edge), slice(edge, -edge))
    before, after = (
        np.minimum(np.abs(picture[inner] - usual[inner]), _FAR).mean()
        for picture in (mean, _shifted(mean, (right, down)))
    )
    return (float(right), float(down)) if after < _BETTER * before else (0.0, 0.0)


def _shifted(picture: NDArray[np.float32], shift: tuple[float, float]) -> NDArray[np.float32]:
    matrix = np.array([[1.0, 0.0, shift[0]], [0.0, 1.0, shift[1]]])
    return cv2.warpAffine(
        picture, matrix, picture.shape[1::-1], flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
    ).astype(np.float32)


def _gone(differs: Mask, mean: NDArray[np.float32], usual: NDArray[np.float32]) -> Mask:
    """Regions that differ in most pictures and stand in the clip, with their rims.

    What stands somewhere has edges round it; where it does not stand the room goes on. Who stands in the recording, and
    holds still, keeps his place this way, with what he hides of his chair: a region with edges in the clip has not gone
    where it is one of several near each other that have more of them in the recording.
    """
    out = np.zeros(differs.shape, dtype=np.bool_)
    opened = cv2.morphologyEx(differs.astype(np.uint8), cv2.MORPH_OPEN, np.ones((3, 3), np.uint8))
    _, labels, stats, _ = cv2.connectedComponentsWithStats(opened, connectivity=8)
    is_large = stats[:, cv2.CC_STAT_AREA] >= _LEAST_THING_PX * differs.size / (640 * 480)
    is_large[0] = False  # what is no region
    if not is_large.any():
        return out
    large = is_large[labels]
    reach = round(0.5 * _APART_PX * differs.shape[1] / 640)
    _, groups = cv2.connectedComponents(cv2.dilate(large.astype(np.uint8), np.ones((2 * reach + 1,) * 2)))
    then, now = (_edges(picture) for picture in (mean, usual))

    def rim_of(regions: Mask) -> Mask:
        return cv2.morphologyEx(regions.astype(np.uint8), cv2.MORPH_GRADIENT, np.ones((5, 5), np.uint8)) > 0

    for i in np.flatnonzero(is_large):
        region = labels == i
        rim = rim_of(region)
        if not rim.any():  # the whole picture: there is no room left to compare with
            continue
        if then[rim].mean() > _STRONGER * now[rim].mean():
            together = rim_of(large & (groups == groups[region][0]))
            if then[together].mean() > now[together].mean():
                out |= cv2.dilate(region.astype(np.uint8), np.ones((2 * _RIM_PX + 1,) * 2, np.uint8)) > 0
    return out


def _edges(picture: NDArray[np.float32]) -> NDArray[np.float32]:
    """Steepness of the brightness by itself, (H, W): the same in a shadow."""
    grey = np.log(_brightness(picture) + np.float32(_DARK))
    return np.hypot(cv2.Sobel(grey, cv2.CV_32F, 1, 0), cv2.Sobel(grey, cv2.CV_32F, 0, 1))
