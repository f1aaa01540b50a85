"""Background model, segmentation with shadow test, mask clean-up, refinement, quality of masks."""

from mocap.foreground.model import Background, learn_background, median_background
from mocap.foreground.quality import MaskQuality, mask_quality, triples_of
from mocap.foreground.refine import refine_mask
from mocap.foreground.segment import ForegroundMask, ForegroundSettings, Segmenter, clean_mask

__all__ = [
    "Background",
    "ForegroundMask",
    "ForegroundSettings",
    "MaskQuality",
    "Segmenter",
    "clean_mask",
    "learn_background",
    "mask_quality",
    "median_background",
    "refine_mask",
    "triples_of",
]
