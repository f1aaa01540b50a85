"""From hulls to what a tracker sees, and back: coarser voxels, components, colours, and owners of the hull's voxels."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mocap.data import CameraRig, Hull, VoxelGrid
from mocap.pipeline.config import TrackingConfig
from mocap.tracking import FrameVoxels, TrackerSettings, person_tree, published_settings
from mocap.volume import coarsen, connected_components, surface_voxels

Indices = NDArray[np.int64]

_LYING_S = 2.0  # a coat that is thrown off moves for less


@dataclass(frozen=True, eq=False)
class TrackerInput:
    """One frame for the tracker.

    voxels : what the tracker sees.  row_of : (N,) int64, its row for every voxel of the hull, -1 = none.
    """

    voxels: FrameVoxels
    row_of: Indices

    def owners(self, voxels_of: dict[int, Indices]) -> NDArray[np.uint32]:
        """Owner of every voxel of the hull, (N,), 0 = nobody.  voxels_of : number > 0 -> rows of its voxels."""
        owner = np.zeros(len(self.voxels) + 1, dtype=np.uint32)  # the last one is that of row -1
        for number, rows in voxels_of.items():
            owner[rows] = number
        return owner[self.row_of]


def tracker_input(frame: int, hull: Hull, voxel_size_m: float | None = None) -> TrackerInput:
    """What a tracker sees of a hull: components, surface and colours, on voxels of voxel_size_m.

    voxel_size_m : None or the hull's own = its own voxels; a smaller one is an error, a larger one coarsens the hull.
    """
    grid, voxels = hull.grid, hull.voxels
    has_colour = hull.n_views > 0
    if voxel_size_m is None or abs(voxel_size_m - grid.voxel_size_m) < 1e-9:
        labels, _ = connected_components(voxels, grid)
        seen = FrameVoxels.of_grid(frame, grid, voxels, labels, hull.is_surface, hull.rgb, has_colour)
        return TrackerInput(seen, np.arange(len(voxels)))
    coarse = coarsen(voxels, grid, voxel_size_m, hull.rgb, has_colour)
    labels, _ = connected_components(coarse.voxels, coarse.grid)
    is_surface = surface_voxels(coarse.voxels, coarse.grid)
    seen = FrameVoxels.of_grid(
        frame, coarse.grid, coarse.voxels, labels, is_surface, coarse.rgb, coarse.has_colour & is_surface
    )
    return TrackerInput(seen, coarse.row_of)


def tracker_settings(
    config: TrackingConfig,
    grid: VoxelGrid,
    fps: float,
    n_frames: int | None = None,
    *,
    is_room_known: bool = False,
    rig: CameraRig | None = None,
) -> TrackerSettings:
    """The tracker's settings from the configuration.

    grid : of the hulls.  n_frames : length of the clip; a person of a clip shorter than twice confirm_frames needs
    fewer sightings.  is_room_known : masks are of what was not in the empty scene.
    rig : as of TrackerSettings; the trackers as published ask no camera.
    """
    confirm, lying = config.confirm_frames, max(1, round(_LYING_S * fps))
    if n_frames is not None:
        confirm, lying = (max(1, min(n, n_frames // 2)) for n in (confirm, lying))
    voxel_size_m = max(config.voxel_size_m or grid.voxel_size_m, grid.voxel_size_m)
    values: dict[str, Any] = {
        "n_samples": config.n_samples,
        "colour": config.colour,
        "fps": fps,
        "expected_persons": config.expected_persons,
        "confirm_frames": confirm,
        "lost_frames": config.lost_frames,
        "lying_frames": lying if is_room_known else None,
        "person_tree": person_tree(config.person_tree),
    }
    if config.published:
        return published_settings(config.tracker, voxel_size_m, **values)
    return TrackerSettings(voxel_size_m, tracker=config.tracker, reid_s=config.reid_s, rig=rig, **values)


def every_frame(frames: NDArray[np.int64], values: NDArray[np.float64]) -> NDArray[np.float64]:
    """values (T, ...) of ascending frames (T,) with a row for every frame from the first to the last; new ones are NaN.

    Who leaves and comes back has no rows in between, but in an animation time must not be cut out.
    """
    if len(frames) == 0:
        return values
    out = np.full((int(frames[-1] - frames[0]) + 1, *values.shape[1:]), np.nan)
    out[frames - frames[0]] = values
    return out
