"""Hulls, product `carve`: coloured voxels of every frame, and pixels of the silhouettes.

Per frame `voxels` (N,) int32, `is_surface` (N,) bool, `n_views` (N,) uint8, `rgb` (N, 3) uint8, `unknown` (U,) int32,
the voxels around them that too few cameras can judge, `used` (C,) bool, the cameras that took part, and `pixel_camera`,
`pixel_uv`, `pixel_rgb` of `SilhouettePixels`; grid and camera faults in the attributes. In sessions with depth maps
also `measured_row` (S,) int32 and `measured_xyz` (S, 3) float32 m: voxels whose surface was measured, and where.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mocap.data import Hull, VoxelGrid
from mocap.data.pixels import SilhouettePixels
from mocap.data.voxels import Voxels
from mocap.io.store import StageReader, StageStore
from mocap.volume import CameraFault

PRODUCT = "carve"


def hull_row(
    hull: Hull,
    unknown: Voxels,
    used: NDArray[np.bool_],
    pixels: SilhouettePixels,
    measured: NDArray[np.float32] | None = None,
) -> dict[str, NDArray[np.generic]]:
    """The arrays of one frame.  unknown : (U,) int32, ascending.  used : (C,).  measured : (N, 3) m, where the surface
    of each voxel was measured, NaN = not; None = there are no depth maps."""
    row: dict[str, NDArray[np.generic]] = {
        "voxels": hull.voxels,
        "is_surface": hull.is_surface,
        "n_views": hull.n_views,
        "rgb": hull.rgb,
        "unknown": unknown,
        "used": used,
        "pixel_camera": pixels.camera,
        "pixel_uv": pixels.uv,
        "pixel_rgb": pixels.rgb,
    }
    if measured is not None:
        rows = np.flatnonzero(np.isfinite(measured[:, 0])).astype(np.int32)
        row |= {"measured_row": rows, "measured_xyz": measured[rows]}
    return row


def measured_from_arrays(arrays: Mapping[str, NDArray[np.generic]]) -> NDArray[np.float32] | None:
    """Where the surface of each voxel of one frame was measured, (N, 3) m, NaN = not; None without depth maps."""
    if "measured_row" not in arrays:
        return None
    measured = np.full((len(arrays["voxels"]), 3), np.nan, dtype=np.float32)
    measured[arrays["measured_row"].astype(np.int64)] = arrays["measured_xyz"]
    return measured


def hull_attrs(
    grid: VoxelGrid, cameras: Sequence[str], n_faulty_views: int, faults: Sequence[CameraFault]
) -> dict[str, object]:
    """The attributes of the product."""
    return {
        "origin_m": grid.origin.tolist(),
        "shape": list(grid.shape),
        "voxel_size_m": grid.voxel_size_m,
        "n_faulty_views": n_faulty_views,
        "cameras": list(cameras),
        "camera_faults": [asdict(f) for f in faults],
    }


def stored_grid(store: StageStore) -> VoxelGrid:
    """The grid that the hulls in the store live on."""
    return grid_from_attrs(store.reader(PRODUCT).attrs)


def grid_from_attrs(attrs: dict[str, Any]) -> VoxelGrid:
    """The grid out of the attributes of the product."""
    return VoxelGrid(np.array(attrs["origin_m"]), tuple(attrs["shape"]), attrs["voxel_size_m"])


def stored_faults(store: StageStore) -> tuple[CameraFault, ...]:
    """What the carve stage has found wrong with cameras."""
    return tuple(CameraFault(**fault) for fault in store.reader(PRODUCT).attrs.get("camera_faults", []))


def rig_offset_m(store: StageStore) -> float:
    """By how much lines of sight of the cameras that were used miss each other at the people, m; 0 = they agree."""
    reader = store.reader(PRODUCT)
    # A camera whose calibration is wrong is left out of all frames, or of none.
    used = reader.read(int(reader.frames[0]), ["used"])["used"]
    in_use = {"", *(name for name, is_used in zip(reader.attrs["cameras"], used, strict=True) if is_used)}
    harmful = (f for f in stored_faults(store) if f.camera in in_use and not f.is_harmless)
    return max((fault.offset_m for fault in harmful), default=0.0)


def hull_from_arrays(grid: VoxelGrid, arrays: dict[str, NDArray[np.generic]]) -> Hull:
    """One frame of the product as a Hull."""
    return Hull(
        grid,
        arrays["voxels"].astype(np.int32, copy=False),
        arrays["is_surface"].astype(np.bool_, copy=False),
        arrays["n_views"].astype(np.uint8, copy=False),
        arrays["rgb"].astype(np.uint8, copy=False),
    )


def hull_at(reader: StageReader, frame: int) -> Hull:
    """The hull of one frame.  reader : of the product. Raises KeyError for a frame that it does not have."""
    return hull_from_arrays(grid_from_attrs(reader.attrs), reader.read(frame))


def pixels_from_arrays(arrays: Mapping[str, NDArray[np.generic]]) -> SilhouettePixels:
    """The silhouettes' pixels of one frame of the product."""
    return SilhouettePixels(
        arrays["pixel_camera"].astype(np.uint8, copy=False),
        arrays["pixel_uv"].astype(np.int16, copy=False),
        arrays["pixel_rgb"].astype(np.uint8, copy=False),
    )


def read_hulls(store: StageStore) -> Iterator[tuple[int, Hull]]:
    """Frames and their hulls, from the store."""
    reader = store.reader(PRODUCT)
    grid = grid_from_attrs(reader.attrs)
    for frame, arrays in reader:
        yield frame, hull_from_arrays(grid, arrays)
