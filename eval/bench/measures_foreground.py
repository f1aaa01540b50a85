"""Segmentation of 640 x 480 pictures against OpenCV's MOG2 with shadows, one thread."""

from __future__ import annotations

from itertools import cycle
from typing import Any

import numpy as np

from eval.bench.measures_volume import scene
from eval.bench.registry import interleaved_medians, measure


def _pictures() -> tuple[Any, list[Any]]:
    s = scene()
    rng = np.random.default_rng(3)
    noise = [rng.normal(0.0, 2.0, s.empty[0].shape) for _ in range(12)]
    empty = [np.clip(s.empty[0] + n, 0, 255).astype(np.uint8) for n in noise]
    return empty, [frame[0] for frame in s.images]


def _segment_next() -> Any:
    from mocap.foreground import Segmenter, learn_background

    empty, pictures = _pictures()
    segmenter = Segmenter(learn_background(empty))
    frames = cycle(pictures)
    return lambda: segmenter.segment(next(frames))


@measure("segmentation_ms", unit="ms", better="lower")
def segmentation_ms() -> float:
    """One picture, clean-up and adaptation included."""
    return interleaved_medians([_segment_next()], 60)[0] * 1e3


@measure("segmentation_over_mog2", unit="x", better="higher")
def segmentation_over_mog2() -> float:
    """How many times faster than MOG2 with its shadow test alone, without any clean-up of its mask."""
    import cv2

    empty, pictures = _pictures()
    subtractor: Any = cv2.createBackgroundSubtractorMOG2(detectShadows=True)
    for picture in empty:
        subtractor.apply(picture)
    frames = cycle(pictures)
    ours, theirs = interleaved_medians([_segment_next(), lambda: subtractor.apply(next(frames))], 40)
    return theirs / ours


@measure("segmentation_empty_ms", unit="ms", better="lower")
def segmentation_empty_ms() -> float:
    """One picture of the empty room: search, gain and adaptation."""
    from mocap.foreground import Segmenter, learn_background

    empty, _ = _pictures()
    segmenter = Segmenter(learn_background(empty))
    frames = cycle(empty)
    return interleaved_medians([lambda: segmenter.segment(next(frames))], 60)[0] * 1e3


@measure("mask_quality_ms", unit="ms", better="lower")
def mask_quality_ms() -> float:
    """Quality numbers of one camera from one frame and its neighbours."""
    from mocap.foreground import mask_quality

    before, now, after = (frame[:1] for frame in scene().masks[:3])
    triple = (before, now, after)
    return interleaved_medians([lambda: mask_quality(["cam_0"], [triple])], 40)[0] * 1e3


@measure("learn_background_ms", unit="ms", better="lower")
def learn_background_ms() -> float:
    """Background of one camera from twelve pictures."""
    from mocap.foreground import learn_background

    empty, _ = _pictures()
    return interleaved_medians([lambda: learn_background(empty)], 3)[0] * 1e3
