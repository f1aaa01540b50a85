"""Growth of the cost of carving with voxel size, room, cameras and persons: with the surface, not with the room.

    python -m eval.volume_growth        # about two minutes; Open3D takes part where it is installed

Processor time of one thread per frame, strict carving (no faulty view), the scene of the benchmark. "hierarchical" is
the Carver, "dense table" one pass of numpy over a look-up table of every voxel (given to it for free), "Open3D"
VoxelGrid.carve_silhouette. Writes eval/results/volume_growth.csv and .png.
"""

from __future__ import annotations

import statistics
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from eval.bench.scene import person_mask, ring
from eval.whole import save_figure, write_csv
from mocap.data import CameraRig, VoxelGrid
from mocap.volume import Carver

RESULTS = Path(__file__).with_name("results")
PLACES = ((0.0, 0.0, 0.3), (-1.0, 0.5, 2.0), (0.9, -0.7, 4.1))  # x m, y m, heading rad of the persons
MAX_TABLE_ENTRIES = 130_000_000  # of the dense table; beyond it is left out
MAX_OPEN3D_VOXELS = 6_000_000
MIN_VIEWS = 4


@dataclass(frozen=True)
class Setting:
    """One point of the plot."""

    axis: str
    voxel_size_m: float = 0.02
    room_m: tuple[float, float, float] = (5.0, 4.0, 2.2)
    n_cameras: int = 7
    n_persons: int = 1


SETTINGS = (
    *(Setting("voxel", voxel_size_m=v) for v in (0.05, 0.03, 0.02, 0.015)),
    *(
        Setting("room", room_m=r)
        for r in ((3.0, 3.0, 2.2), (5.0, 4.0, 2.2), (6.0, 6.0, 2.4), (9.0, 8.0, 3.0))
    ),
    *(Setting("cameras", n_cameras=n) for n in (4, 7, 10)),
    *(Setting("persons", n_persons=n) for n in (1, 2, 3)),
)


def measure(setting: Setting) -> dict[str, Any]:
    """One row of the table; a method that did not take part is empty."""
    rig = ring(setting.n_cameras)
    half = np.array(setting.room_m) / 2
    lower = np.array([-half[0], -half[1], 0.0])
    grid = VoxelGrid.from_bounds(lower, lower + setting.room_m, setting.voxel_size_m)
    masks = []
    for camera in rig:
        people = [person_mask(camera, np.array(p[:2]), p[2]) for p in PLACES[: setting.n_persons]]
        masks.append(np.logical_or.reduce(people))
    started = time.thread_time()
    carver = Carver(rig, grid)
    bounds_s = time.thread_time() - started
    started = time.thread_time()
    voxels = carver.carve(masks, n_faulty_views=0)
    first_s = time.thread_time() - started
    ours = _seconds(lambda: carver.carve(masks, n_faulty_views=0), 15)
    tolerant = _seconds(lambda: carver.carve(masks, n_faulty_views=1), 15)
    dense = None
    if grid.n_voxels * len(rig) <= MAX_TABLE_ENTRIES:
        table = _table(carver, grid)
        assert np.array_equal(_dense_pass(table, masks), voxels)
        dense = _seconds(lambda: _dense_pass(table, masks), 2)
    open3d = _open3d_seconds(rig, grid, masks) if grid.n_voxels <= MAX_OPEN3D_VOXELS else None
    return {
        "axis": setting.axis,
        "voxel_mm": round(setting.voxel_size_m * 1000),
        "room_m3": round(float(np.prod(setting.room_m)), 1),
        "cameras": setting.n_cameras,
        "persons": setting.n_persons,
        "grid_voxels": grid.n_voxels,
        "hull_voxels": len(voxels),
        "hierarchical_ms": _ms(ours),
        "one_faulty_view_ms": _ms(tolerant),
        "dense_table_ms": _ms(dense),
        "open3d_ms": _ms(open3d),
        "bounds_ms": _ms(bounds_s),
        "first_frame_ms": _ms(first_s),
        "table_mb": round(carver.table_mb, 1),
    }


def _seconds(function: Callable[[], object], n: int) -> float:
    function()
    times = []
    for _ in range(n):
        started = time.thread_time()
        function()
        times.append(time.thread_time() - started)
    return statistics.median(times)


def _ms(seconds: float | None) -> float | str:
    return "" if seconds is None else round(seconds * 1e3, 3)


def _table(carver: Carver, grid: VoxelGrid) -> NDArray[np.int32]:
    parts = [
        carver.pixels(np.arange(i, min(i + 500_000, grid.n_voxels), dtype=np.int32)).T
        for i in range(0, grid.n_voxels, 500_000)
    ]
    return np.concatenate(parts, axis=1)


def _dense_pass(table: NDArray[np.int32], masks: Sequence[NDArray[np.bool_]]) -> NDArray[np.int64]:
    misses = np.zeros(table.shape[1], dtype=np.uint8)
    seen = np.zeros(table.shape[1], dtype=np.uint8)
    for row, mask in zip(table, masks, strict=True):
        inside = row >= 0
        seen += inside
        misses += inside & ~mask.ravel().take(row, mode="clip")
    return np.flatnonzero((seen >= min(MIN_VIEWS, len(masks))) & (misses == 0))


def _open3d_seconds(rig: CameraRig, grid: VoxelGrid, masks: Sequence[NDArray[np.bool_]]) -> float | None:
    try:
        import open3d
    except (ImportError, OSError):
        return None
    parameters = []
    for camera in rig:
        one = open3d.camera.PinholeCameraParameters()
        one.intrinsic = open3d.camera.PinholeCameraIntrinsic(*camera.size, camera.K)
        extrinsic = np.eye(4)
        extrinsic[:3, :3], extrinsic[:3, 3] = camera.R, camera.t
        one.extrinsic = extrinsic
        parameters.append(one)
    pictures = [open3d.geometry.Image(mask.astype(np.float32)) for mask in masks]
    started = time.thread_time()
    volume = open3d.geometry.VoxelGrid.create_dense(
        grid.origin, np.zeros(3), grid.voxel_size_m, *(grid.upper - grid.origin)
    )
    for one, picture in zip(parameters, pictures, strict=True):
        volume.carve_silhouette(picture, one, keep_voxels_outside_image=False)
    return time.thread_time() - started


def plot(rows: Sequence[dict[str, Any]], path: Path) -> None:
    """Cost over each axis, every method that took part."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    keys = {"voxel": "voxel_mm", "room": "room_m3", "cameras": "cameras", "persons": "persons"}
    labels = {"voxel": "voxel, mm", "room": "room, m³", "cameras": "cameras", "persons": "persons"}
    methods = (
        ("hierarchical_ms", "hierarchical", "#0072b2", "o-"),
        ("one_faulty_view_ms", "hierarchical, one faulty view", "#56b4e9", "o--"),
        ("dense_table_ms", "dense table, numpy", "#e69f00", "s-"),
        ("open3d_ms", "Open3D", "#999999", "^-"),
    )
    figure, axes = plt.subplots(1, 4, figsize=(13, 3.6), sharey=True, constrained_layout=True)
    for ax, axis in zip(axes, keys, strict=True):
        own = [r for r in rows if r["axis"] == axis]
        for column, name, colour, style in methods:
            points = [(float(r[keys[axis]]), float(r[column])) for r in own if r[column] != ""]
            if points:
                ax.plot(*zip(*points, strict=True), style, color=colour, label=name, markersize=4)
        ax.set_yscale("log")
        ax.set_xlabel(labels[axis])
        ax.grid(True, alpha=0.3)
        if axis == "voxel":
            ax.invert_xaxis()
        if axis in ("cameras", "persons"):
            ax.set_xticks([r[keys[axis]] for r in own])
    axes[0].set_ylabel("one frame, ms")
    axes[1].legend(fontsize=8, loc="center right")
    save_figure(figure, path, dpi=90)
    plt.close(figure)


def main() -> int:
    cv2.setNumThreads(1)
    rows = []
    for setting in SETTINGS:
        rows.append(measure(setting))
        print({k: v for k, v in rows[-1].items() if v != ""}, flush=True)
    write_csv(RESULTS / "volume_growth.csv", list(rows[0]), rows)
    plot(rows, RESULTS / "volume_growth.png")
    return 0


if __name__ == "__main__":
    sys.exit(main())
