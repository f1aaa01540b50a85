"""Colours: what the pixels of a person say of a pose."""

from mocap.likelihood.colours.appearance import (
    Appearance,
    ColourProblem,
    PixelRays,
    colour_bins_of_pixels,
    luma_and_chroma,
    new_appearance,
)
from mocap.likelihood.colours.rays import person_rays

__all__ = [
    "Appearance",
    "ColourProblem",
    "PixelRays",
    "colour_bins_of_pixels",
    "luma_and_chroma",
    "new_appearance",
    "person_rays",
]
