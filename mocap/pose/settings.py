"""Settings of the pose method: the filter with its budget, switches and weights, and the method's numbers."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

from mocap.filters import FilterBudget
from mocap.pose.method import Method


@dataclass(frozen=True)
class PoseSettings:
    """What the pose method takes: the filter with its budget, switches and weights (the `[pose]` section of the
    configuration says what each does), and the numbers of the method."""

    filter: FilterBudget
    noise_scale: float = 1.0
    follow_track: bool = True
    surface_sigma_voxels: float = 1.0
    table_density: float = 1.0
    refine: bool = True
    surface_weight: float = 1.0
    outline_weight: float = 8.0
    posture_nats: float = 2.0
    colour_weight: float = 200.0
    texture_weight: float = 0.0
    texture_every_frames: int = 1
    feedback_share: float = 0.5
    look_again: bool = True
    search_every_frames: int | Literal["auto"] = 1
    repair: bool = True
    jump_nats: float = 0.0
    estimate: str = "mean"
    smooth_lag_frames: int = 0
    n_start_frames: int = 3
    n_first_poses: int = 8
    method: Method = field(default_factory=Method)


@dataclass(frozen=True)
class MarkerSettings:
    """How poses are judged by marker detections: the `[markers]` section of the configuration says what each does."""

    gate_px: float = 12.0
    reprojection_weight: float = 1.0
    sigma: float = 1.0
    factorised: bool = True
    noise_px: float = 2.0
    n_hypotheses: int = 3
    fit_frames: int = 30
    smooth: bool = True
