"""Markers: scores for filters, a fit for the refinement, and one over many frames."""

from mocap.likelihood.markers.bundle import Bundle, BundleSettings, bundle, bundle_markers
from mocap.likelihood.markers.fit import MarkerFitProblem, MarkerFitSettings, Matches
from mocap.likelihood.markers.scores import MarkerLikelihoodSettings, MarkerProblem, marker_scores_numpy
from mocap.likelihood.markers.views import MarkerObservation, MarkerViews, marker_views, observe, undistort

__all__ = [
    "Bundle",
    "BundleSettings",
    "MarkerFitProblem",
    "MarkerFitSettings",
    "MarkerLikelihoodSettings",
    "MarkerObservation",
    "MarkerProblem",
    "MarkerViews",
    "Matches",
    "bundle",
    "bundle_markers",
    "marker_scores_numpy",
    "marker_views",
    "observe",
    "undistort",
]
