"""Residuals: distances of the flesh to hull surface and outlines, and their Levenberg-Marquardt."""

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
from mocap.likelihood.residuals.total import SumProblem

__all__ = [
    "BodyFit",
    "HullSurface",
    "OutlineFitSettings",
    "OutlineProblem",
    "Outlines",
    "PinholeView",
    "SumProblem",
    "SurfaceFitSettings",
    "SurfaceProblem",
    "hull_surface",
    "person_outlines",
    "pinhole_view",
]
