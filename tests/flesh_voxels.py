"""A body as voxels: what a perfect hull of a person would be."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mocap.body import Body, LookUpTable, build_look_up_table, cones_of, load_body_model, scale_body
from mocap.body.flesh import cone_distances
from mocap.data import VoxelGrid
from mocap.pose.volume import PersonHull
from mocap.volume import surface_voxels


@dataclass(frozen=True, eq=False)
class Flesh:
    """A body, its look-up table, and the means to turn a state into a person's voxels."""

    body: Body
    table: LookUpTable
    grid: VoxelGrid

    def hull(
        self, state: NDArray[np.float64], *, without: tuple[int, ...] = (), margin_m: float = 0.0
    ) -> PersonHull:
        """Voxels whose centre lies in the flesh of a state (D,), or nearer than the margin."""
        return rasterise(self.body, self.grid, state, without=without, margin_m=margin_m)


def rasterise(
    body: Body,
    grid: VoxelGrid,
    state: NDArray[np.float64],
    *,
    without: tuple[int, ...] = (),
    margin_m: float = 0.0,
) -> PersonHull:
    """Voxels of a grid whose centre lies in the flesh of a state (D,) or nearer than the margin.

    A carved hull contains the body: a margin of one voxel is what it looks like with many cameras.
    without : parts left out.
    """
    start, end = cones_of(body, state)
    radii = body.cones.radii
    keep = ~np.isin(body.cones.part, without)
    found = []
    for k in np.flatnonzero(keep):
        reach = radii[k].max() + grid.voxel_size_m + margin_m
        low = np.floor((np.minimum(start[k], end[k]) - reach - grid.origin) / grid.voxel_size_m).astype(int)
        high = np.ceil((np.maximum(start[k], end[k]) + reach - grid.origin) / grid.voxel_size_m).astype(int)
        low, high = np.maximum(low, 0), np.minimum(high, grid.shape)
        subs = np.stack(np.meshgrid(*map(np.arange, low, high), indexing="ij"), axis=-1).reshape(-1, 3)
        voxels = grid.linear(subs)
        inside = cone_distances(
            grid.centers(voxels), start[k : k + 1], end[k : k + 1], radii[k : k + 1], body.round_ends
        )
        found.append(voxels[inside[:, 0] <= margin_m])
    voxels = np.unique(np.concatenate(found)).astype(np.int32)
    return PersonHull(voxels, surface_voxels(voxels, grid))


def make_flesh(name: str, height_m: float, voxel_size_m: float) -> Flesh:
    body = scale_body(load_body_model(name), height_m)
    grid = VoxelGrid.from_bounds(np.array([-1.6, -1.5, 0.0]), np.array([1.7, 1.4, 2.2]), voxel_size_m)
    return Flesh(body, build_look_up_table(body, voxel_size_m), grid)
