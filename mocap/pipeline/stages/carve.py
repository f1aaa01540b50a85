"""Carving: from masks to coloured hulls in the store."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mocap.data import Hull, VoxelGrid
from mocap.errors import MocapError
from mocap.io.session import Session
from mocap.io.store import StageStore
from mocap.io.video import FrameReader
from mocap.pipeline.config import Config
from mocap.pipeline.stages.report import Progress, StageReport
from mocap.pipeline.stages.segment import read_masks
from mocap.volume import Carver, choose_grid, colour_hull, surface_voxels

_EMPTY_SHARE = 0.1


def grid_of(session: Session, config: Config) -> VoxelGrid:
    """The voxel grid: configured bounds, else the session's, else the cameras' common view."""
    bounds = config.volume.room_bounds_m or session.room_bounds_m
    try:
        return choose_grid(session.rig, config.volume.voxel_size_m, bounds_m=bounds)
    except ValueError as error:
        raise MocapError(
            f"no voxel grid: {error}",
            path=session.calibration_path,
            remedy="set room_bounds_m in session.toml, or check the calibration with `mocap check`",
        ) from error


def faulty_views(session: Session, config: Config) -> int:
    """The tolerance k: with `auto` one camera of six or more may be wrong when masks were computed.

    Four cameras cannot afford it: a hull of three views is half as large again.
    """
    if config.volume.n_faulty_views != "auto":
        return config.volume.n_faulty_views
    return 1 if len(session.rig) >= 6 and not session.mask_sources else 0


def carve_stage(session: Session, config: Config, store: StageStore, key: str, *, progress: Progress) -> None:
    """Coloured hulls of every frame into the store.

    Store: per frame `voxels` (N,) int32, `is_surface` (N,) bool, `n_views` (N,) uint8, `rgb` (N, 3) uint8; the grid
    in the attributes.
    Source: CF 2.2.4.
    """
    grid = grid_of(session, config)
    k = faulty_views(session, config)
    min_views = None if config.volume.min_views == "auto" else config.volume.min_views
    try:
        carver = Carver(session.rig, grid)
        if not 0 <= k < len(session.rig):
            raise ValueError(f"n_faulty_views is {k}, the rig has {len(session.rig)} cameras")
    except ValueError as error:
        raise MocapError(
            f"the volume cannot be carved: {error}",
            remedy="use larger voxels (volume.voxel_size_m), a smaller room (room_bounds_m) or fewer faulty views",
        ) from error
    attrs = {
        "origin_m": grid.origin.tolist(),
        "shape": list(grid.shape),
        "voxel_size_m": grid.voxel_size_m,
        "n_faulty_views": k,
    }
    n = len(session.frames)
    with store.writer("carve", key, attrs) as out:
        images_of = (
            FrameReader(session.image_sources, session.rig, session.frames) if session.image_sources else None
        )
        try:
            images = iter(images_of) if images_of is not None else None
            for i, (frame, masks) in enumerate(read_masks(store, session)):
                picture = next(images)[1] if images is not None else None
                voxels = carver.carve(masks, n_faulty_views=k, min_views=min_views)
                hull = colour_hull(voxels, surface_voxels(voxels, grid), grid, session.rig, picture)
                out.append(
                    frame, voxels=hull.voxels, is_surface=hull.is_surface, n_views=hull.n_views, rgb=hull.rgb
                )
                progress("carve", i + 1, n)
        finally:
            if images_of is not None:
                images_of.close()


def stored_grid(store: StageStore) -> VoxelGrid:
    """The grid that the hulls in the store live on."""
    attrs = store.reader("carve").attrs
    return VoxelGrid(np.array(attrs["origin_m"]), tuple(attrs["shape"]), attrs["voxel_size_m"])


def hull_from_arrays(grid: VoxelGrid, arrays: dict[str, NDArray[np.generic]]) -> Hull:
    """One frame of the `carve` product as a Hull."""
    return Hull(
        grid,
        arrays["voxels"].astype(np.int32, copy=False),
        arrays["is_surface"].astype(np.bool_, copy=False),
        arrays["n_views"].astype(np.uint8, copy=False),
        arrays["rgb"].astype(np.uint8, copy=False),
    )


def carve_report(store: StageStore) -> StageReport:
    """Warnings about empty hulls, and their mean volume."""
    grid = stored_grid(store)
    reader = store.reader("carve")
    sizes = np.array([len(arrays["voxels"]) for _, arrays in reader])
    empty = float((sizes == 0).mean()) if sizes.size else 1.0
    warnings = []
    if empty == 1.0:
        warnings.append(
            "the volume is empty in every frame: nobody stands where enough cameras see him. Remedy: look at the "
            "silhouettes in the report, check the calibration with `mocap check`, raise volume.n_faulty_views"
        )
    elif empty > _EMPTY_SHARE:
        warnings.append(f"the volume is empty in {empty:.0%} of the frames")
    litres = sizes * grid.voxel_size_m**3 * 1000.0
    return StageReport(
        tuple(warnings),
        {
            "mean_volume_litres": round(float(litres.mean()), 1) if sizes.size else 0.0,
            "n_faulty_views": int(reader.attrs["n_faulty_views"]),
            "grid": "x".join(map(str, grid.shape)),
        },
    )
