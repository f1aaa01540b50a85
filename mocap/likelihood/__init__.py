"""How well a pose explains the data of a frame; all give per-part log-likelihoods."""

from mocap.likelihood.appearance import (
    Appearance,
    ColourProblem,
    PixelRays,
    colour_bins_of_pixels,
    new_appearance,
)
from mocap.likelihood.body_fit import BodyFit
from mocap.likelihood.combine import SumProblem
from mocap.likelihood.fast import fast_part_scores
from mocap.likelihood.marker_bundle import Bundle, BundleSettings, bundle_markers, point_jacobian
from mocap.likelihood.markers import (
    MarkerFitProblem,
    MarkerFitSettings,
    MarkerLikelihoodSettings,
    MarkerObservation,
    MarkerProblem,
    MarkerViews,
    Matches,
    marker_scores_numpy,
    marker_views,
    observe,
    undistort,
)
from mocap.likelihood.outlines import (
    OutlineFitSettings,
    OutlineProblem,
    Outlines,
    PinholeView,
    person_outlines,
    pinhole_view,
)
from mocap.likelihood.pixels import SilhouettePixels, person_rays, sample_silhouettes
from mocap.likelihood.polygons import (
    PolygonLikelihoodSettings,
    PolygonProblem,
    colour_bins,
    part_histograms,
    polygon_scores,
    polygon_scores_numpy,
    random_walk_std,
)
from mocap.likelihood.problem import VoxelProblem
from mocap.likelihood.surface import HullSurface, SurfaceFitSettings, SurfaceProblem, hull_surface
from mocap.likelihood.voxels import (
    PackedVolume,
    PartScores,
    VoxelLikelihoodSettings,
    factorised_log_likelihood,
    global_log_likelihood,
    part_scores,
    part_scores_numpy,
)

__all__ = [
    "Appearance",
    "BodyFit",
    "Bundle",
    "BundleSettings",
    "ColourProblem",
    "HullSurface",
    "MarkerFitProblem",
    "MarkerFitSettings",
    "MarkerLikelihoodSettings",
    "MarkerObservation",
    "MarkerProblem",
    "MarkerViews",
    "Matches",
    "OutlineFitSettings",
    "OutlineProblem",
    "Outlines",
    "PackedVolume",
    "PartScores",
    "PinholeView",
    "PixelRays",
    "PolygonLikelihoodSettings",
    "PolygonProblem",
    "SilhouettePixels",
    "SumProblem",
    "SurfaceFitSettings",
    "SurfaceProblem",
    "VoxelLikelihoodSettings",
    "VoxelProblem",
    "bundle_markers",
    "colour_bins",
    "colour_bins_of_pixels",
    "factorised_log_likelihood",
    "fast_part_scores",
    "global_log_likelihood",
    "hull_surface",
    "marker_scores_numpy",
    "marker_views",
    "new_appearance",
    "observe",
    "part_histograms",
    "part_scores",
    "part_scores_numpy",
    "person_outlines",
    "person_rays",
    "pinhole_view",
    "point_jacobian",
    "polygon_scores",
    "polygon_scores_numpy",
    "random_walk_std",
    "sample_silhouettes",
    "undistort",
]
