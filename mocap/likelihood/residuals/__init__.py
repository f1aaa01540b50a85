"""Residuals: distances of the flesh to hull surface and outlines, their Levenberg-Marquardt, and texture."""

from mocap.likelihood.residuals.body_fit import BodyFit
from mocap.likelihood.residuals.outlines import (
    OutlineFitSettings,
    OutlineProblem,
    Outlines,
    PinholeView,
    person_outlines,
    pinhole_view,
)
from mocap.likelihood.residuals.surface import HullSurface, SurfaceFitSettings, SurfaceProblem, hull_surface
from mocap.likelihood.residuals.texture import (
    ColourCounts,
    Crops,
    Texture,
    TextureProblem,
    TextureSettings,
    person_crops,
    places_of,
)
from mocap.likelihood.residuals.total import SumProblem

__all__ = [
    "BodyFit",
    "ColourCounts",
    "Crops",
    "HullSurface",
    "OutlineFitSettings",
    "OutlineProblem",
    "Outlines",
    "PinholeView",
    "SumProblem",
    "SurfaceFitSettings",
    "SurfaceProblem",
    "Texture",
    "TextureProblem",
    "TextureSettings",
    "hull_surface",
    "person_crops",
    "person_outlines",
    "pinhole_view",
    "places_of",
]
