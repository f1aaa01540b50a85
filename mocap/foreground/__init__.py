"""Background model, segmentation with shadow test, mask clean-up."""

from mocap.foreground.model import Background, learn_background, median_background
from mocap.foreground.segment import ForegroundMask, ForegroundSettings, Segmenter, clean_mask

__all__ = [
    "Background",
    "ForegroundMask",
    "ForegroundSettings",
    "Segmenter",
    "clean_mask",
    "learn_background",
    "median_background",
]
