"""Quality of masks: how good those of each camera are, told without truth, and what to do about bad ones."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from mocap.arrays import Array, Mask

Bits = NDArray[np.uint8]
Triple = tuple[Sequence[Mask], Sequence[Mask], Sequence[Mask]]

# Limits above which a number earns advice.
MAX_FLICKER = 0.02
MAX_SHADOW_SHARE = 0.12
MAX_LEAKAGE = 0.05
MAX_BORDER_SHARE = 0.5
MAX_UNUSABLE_SHARE = 0.1
MAX_RESIDUAL = 0.12
LEAST_FOREGROUND = 1e-4

_STILL_PX = 5  # side of the square that must not change around a pixel that flickers
_SMALL_REGION = 0.1  # of the area of the largest region
_MOVED_PX = 3  # side of the square that change between two frames must hold: an outline's jitter is thinner


@dataclass(frozen=True)
class MaskQuality:
    """Numbers of one camera, means over the frames that were looked at; NaN where they do not apply.

    foreground_share, shadow_share : shares of the picture.
    flicker : pixels that differ from the frame before and from the frame after while all of the 5 x 5 square about
        them is the same in both of these, as a share of the foreground. An outline that moves does not do that.
    leakage : share of the foreground in regions smaller than a tenth of the picture's largest region.
    border_share : share of the frames with foreground in which it touches the border of the picture.
    unusable_share : share of the frames in which the foreground fills most of the picture.
    residual : median share of the mask outside the hull of the other cameras.
    advice : one sentence per number that is too large, with a remedy.
    """

    camera: str
    foreground_share: float
    shadow_share: float
    flicker: float
    leakage: float
    border_share: float
    unusable_share: float
    residual: float
    advice: tuple[str, ...]


def mask_quality(
    names: Sequence[str],
    triples: Iterable[Triple],
    *,
    foreground_share: Array | None = None,
    shadow_share: Array | None = None,
    is_usable: Mask | None = None,
    uncovered: Array | None = None,
) -> list[MaskQuality]:
    """Quality of the masks of every camera, in the order of `names`.

    triples : frames to look at, each as the masks of the frame before, of the frame itself and of the frame after, one
    (H, W) bool per camera; see `triples_of`. None of them leaves flicker, leakage and border NaN.
    foreground_share, shadow_share : (T, C) shares of the picture; the former is taken from the triples when absent.
    is_usable : (T, C).  uncovered : (T, C) share of each mask outside the hull of the other cameras; NaN = not known.
    Raises ValueError for masks or columns that do not match the names.
    """
    _check_columns(
        len(names),
        foreground_share=foreground_share,
        shadow_share=shadow_share,
        is_usable=is_usable,
        uncovered=uncovered,
    )
    sums = _sums_of(triples, len(names))
    return [
        _judged(
            name,
            sums[c],
            sums[c].share if foreground_share is None else _mean(foreground_share[:, c]),
            _mean(None if shadow_share is None else shadow_share[:, c]),
            _mean(None if is_usable is None else 1.0 - is_usable[:, c]),
            _median(None if uncovered is None else uncovered[:, c]),
        )
        for c, name in enumerate(names)
    ]


def _check_columns(n: int, **tables: NDArray[Any] | None) -> None:
    """ValueError for a table that has not one column for each of n cameras."""
    for key, table in tables.items():
        if table is not None and (table.ndim != 2 or table.shape[1] != n):
            raise ValueError(f"{key}: expected shape (T, {n}), got {table.shape}")


def _sums_of(triples: Iterable[Triple], n: int) -> list[_Sums]:
    """Counts of n cameras over the triples."""
    sums = [_Sums() for _ in range(n)]
    for triple in triples:
        for masks in triple:
            if len(masks) != n:
                raise ValueError(f"triples: expected {n} masks per frame, got {len(masks)}")
        for c in range(n):
            sums[c].add(triple[0][c], triple[1][c], triple[2][c])
    return sums


def triples_of(frames: Iterable[Sequence[Mask]]) -> Iterator[Triple]:
    """Each frame but the first and the last with its neighbours."""
    before: Sequence[Mask] | None = None
    now: Sequence[Mask] | None = None
    for after in frames:
        if before is not None and now is not None:
            yield before, now, after
        before, now = now, after


class _Sums:
    """Counts of one camera over the frames."""

    def __init__(self) -> None:
        self.n_frames = self.n_pixels = self.n_foreground = 0
        self.n_flicker = self.n_small = self.n_seen = self.n_border = 0

    def add(self, before: Mask, now: Mask, after: Mask) -> None:
        if before.shape != now.shape or after.shape != now.shape:
            raise ValueError(
                f"triples: expected three masks of shape {now.shape}, got {before.shape}, {after.shape}"
            )
        window = _window_of(before | now | after)
        a, b, c = (np.ascontiguousarray(m[window]).view(np.uint8) for m in (before, now, after))
        self.n_flicker += _n_flickering(a, b, c)
        foreground = cv2.countNonZero(b)
        self.n_frames += 1
        self.n_pixels += now.size
        self.n_foreground += foreground
        if foreground:
            area = cv2.connectedComponentsWithStats(b, connectivity=8)[2][1:, cv2.CC_STAT_AREA]
            self.n_small += int(area[area < _SMALL_REGION * area.max()].sum())
            self.n_seen += 1
            edges = (now[0], now[-1], now[:, 0], now[:, -1])
            self.n_border += any(edge.any() for edge in edges)

    @property
    def share(self) -> float:
        return _ratio(self.n_foreground, self.n_pixels)


def _n_flickering(before: Bits, now: Bits, after: Bits) -> int:
    """How many pixels of masks (H, W) uint8 of 0 and 1 flicker, as `MaskQuality` has it."""
    square = np.ones((_STILL_PX, _STILL_PX), dtype=np.uint8)
    stays_in, stays_out = cv2.erode(before & after, square), 1 - cv2.dilate(before | after, square)
    flickers = (stays_in & (1 - now)) | (stays_out & now)
    if not flickers.any():
        return 0
    change = cv2.morphologyEx(before ^ after, cv2.MORPH_OPEN, np.ones((_MOVED_PX, _MOVED_PX), dtype=np.uint8))
    # A thin part between its places hangs on what moves with it, through pixels that are too near to change to count.
    n, pieces = cv2.connectedComponents((before ^ now) & (1 - (before ^ after)), connectivity=8)
    is_moving = np.zeros(n, dtype=np.bool_)
    is_moving[pieces[cv2.dilate(change, np.ones((3, 3), dtype=np.uint8)) > 0]] = True
    return int(np.count_nonzero((flickers > 0) & ~is_moving[pieces]))


def _window_of(mask: Mask) -> tuple[slice, slice]:
    """Where a mask (H, W) is set, with room about it for the square that must not change."""
    x, y, w, h = cv2.boundingRect(mask.view(np.uint8))
    return slice(max(y - _STILL_PX, 0), y + h + _STILL_PX), slice(max(x - _STILL_PX, 0), x + w + _STILL_PX)


def _judged(
    name: str, sums: _Sums, foreground: float, shadow: float, unusable: float, residual: float
) -> MaskQuality:
    flicker = _ratio(sums.n_flicker, sums.n_foreground)
    leakage = _ratio(sums.n_small, sums.n_foreground)
    border = _ratio(sums.n_border, sums.n_seen)
    advice = []

    def advise(is_bad: bool, what: str, remedy: str) -> None:
        if is_bad:
            advice.append(f"camera {name}: {what}. Remedy: {remedy}")

    advise(
        unusable > MAX_UNUSABLE_SHARE,
        f"the foreground fills most of the picture in {unusable:.0%} of the frames; the background does not fit",
        "record background/ with the same light and camera settings, or give masks/",
    )
    advise(
        foreground < LEAST_FOREGROUND,
        "no foreground in any frame",
        "check that the clip belongs to this session and that persons come into its picture",
    )
    advise(
        flicker > MAX_FLICKER,
        f"flicker {flicker:.1%}: parts of the mask go on and off from frame to frame",
        "lock exposure, focus and white balance, film the empty room for longer, or raise the light",
    )
    advise(
        shadow > MAX_SHADOW_SHARE,
        f"shadows cover {shadow:.0%} of the picture",
        "soften the light or light from more sides; dark shadows are taken for a person",
    )
    advise(
        leakage > MAX_LEAKAGE,
        f"leakage {leakage:.1%}: foreground in small pieces apart from the persons",
        "if something else moves there (a curtain, a screen), leave it out with roi/",
    )
    advise(
        border > MAX_BORDER_SHARE,
        f"a person is cut off by the border of the picture in {border:.0%} of the frames",
        "move the camera back or turn it; what it does not see it cannot carve",
    )
    advise(
        residual > MAX_RESIDUAL,
        f"{residual:.0%} of its silhouette lie outside the volume that the other cameras see",
        "check its calibration and its synchronisation, and look for shadows in its silhouettes",
    )
    return MaskQuality(name, foreground, shadow, flicker, leakage, border, unusable, residual, tuple(advice))


def _ratio(part: int, whole: int) -> float:
    return part / whole if whole else float("nan")


def _mean(values: NDArray[np.generic] | None) -> float:
    known = _known(values)
    return float(known.mean()) if known.size else float("nan")


def _median(values: NDArray[np.generic] | None) -> float:
    known = _known(values)
    return float(np.median(known)) if known.size else float("nan")


def _known(values: NDArray[np.generic] | None) -> Array:
    if values is None:
        return np.zeros(0)
    plain = np.asarray(values, dtype=np.float64)
    return plain[np.isfinite(plain)]
