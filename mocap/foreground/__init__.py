"""Background model, segmentation with shadow test, mask clean-up, refinement, quality of masks."""

from mocap.foreground.fit import Fit, fit_background, unfitted
from mocap.foreground.model import (
    COVERED_WORTH_A_WORD,
    EMPTY_REDUCTION,
    Background,
    empty_picture,
    learn_background,
    median_background,
)
from mocap.foreground.quality import MaskQuality, mask_quality, triples_of
from mocap.foreground.recording import (
    KeyPictures,
    background_of_recording,
    bare_in,
    changes_in,
    first_cuts,
    held_things_in,
    key_pictures,
    off_rim,
    pieces_within,
    reduction_of,
    still_pieces_in,
    stirring_of,
    things_in,
    with_floor,
    with_quiet_floor,
)
from mocap.foreground.refine import refine_mask
from mocap.foreground.segment import ForegroundMask, ForegroundSettings, Segmenter, clean_mask

__all__ = [
    "COVERED_WORTH_A_WORD",
    "EMPTY_REDUCTION",
    "Background",
    "Fit",
    "ForegroundMask",
    "ForegroundSettings",
    "KeyPictures",
    "MaskQuality",
    "Segmenter",
    "background_of_recording",
    "bare_in",
    "changes_in",
    "clean_mask",
    "empty_picture",
    "first_cuts",
    "fit_background",
    "held_things_in",
    "key_pictures",
    "learn_background",
    "mask_quality",
    "median_background",
    "off_rim",
    "pieces_within",
    "reduction_of",
    "refine_mask",
    "still_pieces_in",
    "stirring_of",
    "things_in",
    "triples_of",
    "unfitted",
    "with_floor",
    "with_quiet_floor",
]
