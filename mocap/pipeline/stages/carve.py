"""Carving: from masks to coloured hulls in the store."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import asdict

import numpy as np
from numpy.typing import NDArray

from mocap.data import Hull, VoxelGrid
from mocap.errors import MocapError
from mocap.foreground.pixels import sample_silhouettes
from mocap.io.session import Session
from mocap.io.store import StageStore
from mocap.io.video import FrameReader
from mocap.pipeline.config import Config
from mocap.pipeline.stages.report import Progress, StageReport
from mocap.pipeline.stages.segment import read_masks
from mocap.volume import (
    CameraFault,
    Carver,
    ConsistencyMonitor,
    choose_grid,
    colour_hull,
    find_camera_faults,
    surface_voxels,
    usable_cameras,
)

_EMPTY_SHARE = 0.1
_MIN_CAMERAS = 3
_REMEDIES = {
    "moved": "calibrate it again from that frame on, or leave these frames out",
    "lag": "shift its clip by that many frames",
    "rate": "record all cameras at one rate, or resample its clip",
    "frozen": "leave these frames out with --frames",
    "black": "leave these frames out with --frames",
    "blind": "look at its silhouettes in the report",
    "misfit": "look at its silhouettes in the report",
    "scene": "look at the silhouettes in the report; split the recording there",
}


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


def faulty_views(session: Session, config: Config, n_excluded: int = 0) -> int:
    """The tolerance k: with `auto` one camera of six or more may be wrong when masks were computed.

    Four cameras cannot afford it: a hull of three views is half as large again. A camera that is left out has used
    up one: hulls of six good cameras without tolerance overlap the truth better (IoU 0.68 to 0.82 on the fault
    scenes) than those of six with one tolerated (0.49 to 0.59).
    """
    k = config.volume.n_faulty_views
    if k == "auto":
        k = 1 if len(session.rig) >= 6 and not session.mask_sources else 0
    return max(k - n_excluded, 0)


def carve_stage(session: Session, config: Config, store: StageStore, key: str, *, progress: Progress) -> None:
    """Coloured hulls of every frame into the store.

    Store: per frame `voxels` (N,) int32, `is_surface` (N,) bool, `n_views` (N,) uint8, `rgb` (N, 3) uint8, `used` (C,)
    bool, the cameras that took part, and `pixel_camera`, `pixel_uv`, `pixel_rgb` of `SilhouettePixels`; grid and camera
    faults in the attributes.
    With volume.on_bad_camera=exclude, cameras that turn out to be bad make the stage begin again without them.
    Source: CF 2.2.4.
    """
    try:
        carving = _Carving(session, config)
        k = faulty_views(session, config)
        if not 0 <= k < len(session.rig):
            raise ValueError(f"n_faulty_views is {k}, the rig has {len(session.rig)} cameras")
    except ValueError as error:
        raise MocapError(
            f"the volume cannot be carved: {error}",
            remedy="use larger voxels (volume.voxel_size_m), a smaller room (room_bounds_m) or fewer faulty views",
        ) from error
    try:
        _carve_frames(carving, store, key, (), is_first=True, progress=progress)
    except _CarveAgain as again:
        _carve_frames(carving, store, key, again.faults, is_first=False, progress=progress)


class _CarveAgain(Exception):
    """The cameras that turned out to be bad; leaves no product behind."""

    def __init__(self, faults: tuple[CameraFault, ...]) -> None:
        super().__init__("carve without bad cameras")
        self.faults = faults


class _Carving:
    """Grid and carvers of a session, one carver for each set of cameras that is used."""

    def __init__(self, session: Session, config: Config) -> None:
        self.session, self.config = session, config
        self.grid = grid_of(session, config)
        self.rig = session.rig
        self._carvers: dict[tuple[str, ...], Carver] = {}
        self.carver(self.rig.names)

    def carver(self, names: tuple[str, ...]) -> Carver:
        if names not in self._carvers:
            self._carvers[names] = Carver(self.rig.subset(names), self.grid)
        return self._carvers[names]

    def hull(
        self,
        masks: Sequence[NDArray[np.bool_]],
        pictures: Sequence[NDArray[np.uint8]] | None,
        used: NDArray[np.bool_],
    ) -> Hull:
        """The hull of one frame from the cameras in use."""
        settings = self.config.volume
        rows = np.flatnonzero(used).tolist()
        carver = self.carver(tuple(self.rig.names[i] for i in rows))
        voxels = carver.carve(
            [masks[i] for i in rows],
            n_faulty_views=faulty_views(self.session, self.config, len(masks) - len(rows)),
            min_views=None if settings.min_views == "auto" else min(settings.min_views, len(rows)),
            outside=settings.outside_view,
        )
        images = None if pictures is None else [pictures[i] for i in rows]
        is_surface = surface_voxels(voxels, self.grid)
        return colour_hull(voxels, is_surface, self.grid, carver.rig, images, settings.visibility)


def _carve_frames(
    carving: _Carving,
    store: StageStore,
    key: str,
    faults: tuple[CameraFault, ...],
    *,
    is_first: bool,
    progress: Progress,
) -> None:
    """One pass over all frames. The first looks for bad cameras; _CarveAgain when some must be left out."""
    session, settings = carving.session, carving.config.volume
    rig, frames = session.rig, session.frames
    attrs: dict[str, object] = {
        "origin_m": carving.grid.origin.tolist(),
        "shape": list(carving.grid.shape),
        "voxel_size_m": carving.grid.voxel_size_m,
        "n_faulty_views": faulty_views(session, carving.config),
        "cameras": list(rig.names),
    }
    monitor = None
    if is_first and settings.on_bad_camera != "ignore":
        monitor = ConsistencyMonitor(rig, carving.grid)
    used = usable_cameras(faults, rig.names, np.array(frames))
    # With fewer cameras left than a hull needs, a bad one is better than none.
    used[used.sum(axis=1) < min(_MIN_CAMERAS, len(rig))] = True
    with store.writer("carve", key, attrs) as out, ExitStack() as stack:
        pictures_of = None
        if session.image_sources:
            pictures_of = iter(stack.enter_context(FrameReader(session.image_sources, rig, frames)))
        for i, (frame, masks) in enumerate(read_masks(store, session)):
            pictures = next(pictures_of)[1] if pictures_of is not None else None
            hull = carving.hull(masks, pictures, used[i])
            if monitor is not None:
                monitor.add(frame, masks, pictures)
            pixels = sample_silhouettes(masks, pictures, used[i])
            out.append(
                frame,
                voxels=hull.voxels,
                is_surface=hull.is_surface,
                n_views=hull.n_views,
                rgb=hull.rgb,
                used=used[i],
                pixel_camera=pixels.camera,
                pixel_uv=pixels.uv,
                pixel_rgb=pixels.rgb,
            )
            progress("carve", i + 1, len(frames))
        if monitor is not None:
            faults = find_camera_faults(monitor.evidence())
            if (
                settings.on_bad_camera == "exclude"
                and not usable_cameras(faults, rig.names, np.array(frames)).all()
            ):
                raise _CarveAgain(faults)
        attrs["camera_faults"] = [asdict(f) for f in faults]


def stored_faults(store: StageStore) -> tuple[CameraFault, ...]:
    """What the carve stage has found wrong with cameras."""
    return tuple(CameraFault(**fault) for fault in store.reader("carve").attrs.get("camera_faults", []))


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
    faults, names = stored_faults(store), list(reader.attrs["cameras"])
    used = np.array([arrays["used"] for _, arrays in reader]) if faults else np.ones((0, 0), dtype=np.bool_)
    for fault in faults:
        inside = (reader.frames >= fault.first_frame) & (reader.frames <= fault.last_frame)
        is_out = fault.camera in names and not used[inside, names.index(fault.camera)].any()
        what = "; it is left out of the volume there" if is_out else ""
        warnings.append(f"{fault.message}{what}. Remedy: {_REMEDIES[fault.kind]}")
    litres = sizes * grid.voxel_size_m**3 * 1000.0
    return StageReport(
        tuple(warnings),
        {
            "mean_volume_litres": round(float(litres.mean()), 1) if sizes.size else 0.0,
            "n_faulty_views": int(reader.attrs["n_faulty_views"]),
            "grid": "x".join(map(str, grid.shape)),
            "camera_faults": len(faults),
        },
    )
