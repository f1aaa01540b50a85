"""From the configuration to the method's settings: files are read here, and what does not fit is said by its key."""

from __future__ import annotations

from mocap.body import Body, BodyModel, load_body_model, load_hierarchy, load_limbs, scale_body
from mocap.body.markers import Markers, load_marker_set, place_markers
from mocap.data import StateLayout, VoxelGrid
from mocap.data.hierarchy import Hierarchy, levels_on, limbs_on
from mocap.errors import MocapError, did_you_mean
from mocap.filters import FILTERS, FilterBudget
from mocap.filters.limb_settings import LimbSettings, own_data_limits
from mocap.io.session import Session
from mocap.likelihood.voxels import VoxelLikelihoodSettings
from mocap.pipeline.config import Config, LikelihoodConfig, MarkersConfig, PoseConfig
from mocap.pose.marker import MarkerTools
from mocap.pose.method import Method
from mocap.pose.settings import MarkerSettings, PoseSettings
from mocap.pose.volume import VolumeTools, volume_tools


def filter_budget(pose: PoseConfig, layout: StateLayout) -> FilterBudget:
    """What the configured filter may spend on a frame, with the scalable body and the limbs that it uses.

    Raises MocapError when the hierarchy or the limbs cannot be read or do not fit the body. The filter's name is known
    to exist: `check_filter`.
    """
    kind = FILTERS[pose.filter]
    return FilterBudget(
        pose.filter,
        n_particles=pose.n_particles,
        n_layers=pose.n_layers,
        survival_rate=pose.survival_rate,
        resampling=pose.resampling,
        hierarchy=_hierarchy(pose, layout) if kind.uses_hierarchy else None,
        level_particles=pose.level_particles if kind.uses_hierarchy else (),
        level_layers=pose.level_layers,
        structural_rate=pose.structural_rate,
        crossing=pose.crossing,
        limbs=_limbs(pose, layout) if kind.uses_limbs else LimbSettings(),
    )


def check_filter(pose: PoseConfig, section: str, *, factorised: bool) -> None:
    """MocapError for an unknown filter, and for one that needs a likelihood of every part where `section` asks for a
    global one."""
    if pose.filter not in FILTERS:
        raise MocapError(
            f"configuration: pose.filter: there is no filter named {pose.filter!r}"
            + did_you_mean(pose.filter, FILTERS),
            remedy=f"use one of {', '.join(FILTERS)}",
        )
    if FILTERS[pose.filter].is_part_by_part and not factorised:
        raise MocapError(
            f"configuration: the filter {pose.filter} places the body part by part and needs a likelihood of "
            "every part",
            remedy=f"set {section}.factorised to true, or take another filter",
        )


def _hierarchy(pose: PoseConfig, layout: StateLayout) -> Hierarchy:
    hierarchy = load_hierarchy(pose.hierarchy)
    try:
        levels = levels_on(hierarchy, layout)
    except ValueError as error:
        raise MocapError(
            f"configuration: pose.hierarchy: {error}", remedy="take a hierarchy made for this body"
        ) from error
    if pose.level_particles and len(pose.level_particles) != len(levels.levels):
        raise MocapError(
            f"configuration: pose.level_particles has {len(pose.level_particles)} numbers, the hierarchy "
            f"{hierarchy.name} has {len(levels.levels)} levels",
            remedy="give one number for each level, or none at all",
        )
    return hierarchy


def _limbs(pose: PoseConfig, layout: StateLayout) -> LimbSettings:
    limbs = load_limbs(pose.limbs)
    try:
        limbs_on(limbs, layout)
    except ValueError as error:
        raise MocapError(
            f"configuration: pose.limbs: {error}", remedy="take limbs made for this body"
        ) from error
    return own_data_limits(limbs) if pose.limb_evidence == "own" else LimbSettings(limbs)


def pose_settings(pose: PoseConfig, method: Method, layout: StateLayout) -> PoseSettings:
    """The method's settings for a body.  Raises MocapError as `filter_budget` does."""
    return PoseSettings(
        filter=filter_budget(pose, layout),
        noise_scale=pose.noise_scale,
        follow_track=pose.follow_track,
        surface_sigma_voxels=pose.surface_sigma_voxels,
        table_density=pose.table_density,
        refine=pose.refine,
        surface_weight=pose.surface_weight,
        outline_weight=pose.outline_weight,
        posture_nats=pose.posture_nats,
        colour_weight=pose.colour_weight,
        texture_weight=pose.texture_weight,
        texture_every_frames=pose.texture_every_frames,
        feedback_share=pose.feedback_share,
        look_again=pose.look_again,
        search_every_frames=pose.search_every_frames,
        repair=pose.repair,
        jump_nats=pose.jump_nats,
        estimate=pose.estimate,
        smooth_lag_frames=pose.smooth_lag_frames,
        n_start_frames=pose.n_start_frames,
        n_first_poses=pose.n_first_poses,
        method=method,
    )


def likelihood_settings(config: LikelihoodConfig) -> VoxelLikelihoodSettings:
    """The voxel likelihood's settings."""
    return VoxelLikelihoodSettings(
        variance_out=config.variance_out,
        variance_double=config.variance_double,
        variance_empty=config.variance_empty,
        variance_surface=config.variance_surface,
        factorised=config.factorised,
        kind=config.kind,
        n_points=config.n_points,
        device="cuda" if config.device == "cuda" else "cpu",
    )


def marker_settings(config: MarkersConfig) -> MarkerSettings:
    """How poses are judged by detections."""
    return MarkerSettings(
        gate_px=config.gate_px,
        reprojection_weight=config.reprojection_weight,
        sigma=config.sigma,
        factorised=config.factorised,
        noise_px=config.noise_px,
        n_hypotheses=config.n_hypotheses,
        fit_frames=config.fit_frames,
        smooth=config.smooth,
    )


def stated_height_m(config: Config, model: BodyModel, session: Session) -> float | None:
    """The height that the settings, else the body file, else the session state; None = it is to be measured."""
    return config.body.height_m or model.height_m or session.person_height_m


def make_tools(
    grid: VoxelGrid,
    fps: float,
    height_m: float,
    body_model: str,
    pose: PoseConfig,
    likelihood: LikelihoodConfig,
    n_threads: int,
    method: Method | None = None,
) -> VolumeTools:
    """Body, look-up table and settings of one person who is followed in volumes.

    body_model : a preset or a body file.  method : None = the numbers that come with the package.
    """
    body = scale_body(load_body_model(body_model), height_m)
    settings = pose_settings(pose, method or Method(), body.layout)
    return volume_tools(body, grid, fps, settings, likelihood_settings(likelihood), n_threads)


def make_marker_tools(config: Config, fps: float, height_m: float) -> MarkerTools:
    """Body, markers and settings of one person of some height who wears markers."""
    body = scale_body(load_body_model(config.body_model("markers")), height_m)
    return marker_tools(body, place_markers(load_marker_set(config.body.marker_set), body), fps, config)


def marker_tools(body: Body, markers: Markers, fps: float, config: Config) -> MarkerTools:
    """Settings of a body that wears markers."""
    settings = pose_settings(config.pose, config.method, body.layout)
    return MarkerTools(body, fps, settings, 1, markers, marker_settings(config.markers))
