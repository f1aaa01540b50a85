"""Checks of depth maps: they are numbers, of the camera's pixels, and of the unit that is said."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mocap.data import Camera, CameraRig
from mocap.data.depth import DepthUnits
from mocap.errors import MocapError
from mocap.io.session.reading import depth_of
from mocap.io.session.record import Finding, Session
from mocap.io.video import ClipInfo, DepthReader, list_depth_maps, promised_size, size_error

Array = NDArray[np.float64]

# What cameras and tools store: 0.1 mm (RealSense at its finest), 0.2 mm (5000 to the metre), 0.25 mm, 1 mm, 1 cm, 1 m.
_USUAL_UNITS_MM = (0.1, 0.2, 0.25, 1.0, 10.0, 1000.0)
# A wrong unit is wrong by 2 at least; furniture and persons on the floor bring readings to three quarters of its depth.
_MOST_APART = 1.7
_FLOOR_M = (0.5, 8.0)  # depths of the floor that are looked at: cheap sensors read nothing beyond
_FEW_PIXELS = 200
_STRIDE_PX = 4
# Share of the floor's depth by which most readings may miss it: a turn of 1 degree moves the floor 4 m away by 5 %.
_POOR_SHARE = 0.06
_FEW_READINGS = 0.2
_UPSIDE_DOWN = "the depth maps are upside down: the floor lies where it must when they are turned about"
_TURN_THEM = "write the maps as the pictures are"
_MOST_LOOKS = 10


def depth_info(folder: Path, camera: str, size: tuple[int, int]) -> ClipInfo:
    """Count a camera's depth maps. Raises MocapError for no map, a gap, or another size than (width, height)."""
    files = list_depth_maps(folder, camera)
    found = promised_size(files[0], camera=camera, frame=0)
    if found != size:
        raise MocapError(
            size_error(found, size, files[0], camera, 0).message.replace("the picture", "the depth map"),
            path=files[0],
            camera=camera,
            frame=0,
            remedy="register the maps onto the camera's pictures, or say session.toml: [depth] scale = pixels of a map "
            "per pixel of a picture",
        )
    return ClipInfo(folder, len(files), found, None)


def floor_ratio(depth_m: NDArray[np.float32], camera: Camera) -> tuple[float, float] | None:
    """Readings in units of the depth at which the floor must be: their upper quartile, and how far the middle half of
    them lies apart.  depth_m : (H, W) m, 0 = no reading.  None where too few of them see the floor.

    What stands on the floor is nearer than it, never further.
    """
    uv = np.stack(np.meshgrid(*(np.arange(0, n, _STRIDE_PX) for n in camera.size)), axis=-1).reshape(-1, 2)
    rays = camera.rays(uv.astype(np.float64))
    with np.errstate(divide="ignore", invalid="ignore"):
        expected = -camera.center[2] / rays[:, 2] * (rays @ camera.R[2])
    read = depth_m[uv[:, 1], uv[:, 0]]
    use = (expected > _FLOOR_M[0]) & (expected < _FLOOR_M[1]) & (read > 0)
    if np.count_nonzero(use) < _FEW_PIXELS:
        return None
    low, high = np.quantile(read[use] / expected[use], (0.25, 0.75))
    return float(high), float(high - low)


def _fits_upside_down(depth_m: NDArray[np.float32], camera: Camera) -> bool:
    """Whether the floor lies where it must when the rows of a map are turned about."""
    found = floor_ratio(depth_m[::-1], camera)
    return found is not None and abs(found[0] - 1) <= _POOR_SHARE


def check_unit(folder: Path, camera: Camera, units: DepthUnits, frame: int) -> None:
    """MocapError when the readings of one map cannot have the unit that is said, because the floor lies elsewhere.

    frame : which map. Where hardly any floor is read nothing is said.
    """
    with DepthReader({camera.name: folder}, CameraRig((camera,)), (frame,), units) as reader:
        (_, (depth_m,)), *_ = reader
    found = floor_ratio(depth_m, camera)
    if found is None or 1 / _MOST_APART < found[0] < _MOST_APART:
        return
    if _fits_upside_down(depth_m, camera):
        raise MocapError(_UPSIDE_DOWN, path=folder, camera=camera.name, frame=frame, remedy=_TURN_THEM)
    better = min(_USUAL_UNITS_MM, key=lambda unit: abs(np.log(found[0] * unit / units.unit_mm)))
    is_sure = 1 / _MOST_APART < found[0] * better / units.unit_mm < _MOST_APART
    remedy = (
        f"say session.toml: [depth] unit_mm = {better:g}"
        if is_sure
        else "say their unit in session.toml: [depth] unit_mm"
    )
    raise MocapError(
        f"with {units.unit_mm:g} mm to a number the floor would lie at {100 * found[0]:.0f} % of the distance at which "
        "the calibration has it",
        path=folder,
        camera=camera.name,
        frame=frame,
        remedy=f"{remedy}; if that is right, check the calibration's units",
    )


def depth(session: Session) -> list[Finding]:
    """Whether depth maps can be read, how much of them is readings, and whether the floor lies where it must."""
    out = []
    for name, folder in session.depth_sources.items():
        camera = session.rig[name]
        try:
            maps = _some_maps(session, name)
        except MocapError as error:
            out.append(Finding("error", error.message, name, error.remedy))
            continue
        share = float(np.mean([(m > 0).mean() for m in maps]))
        text = f"depth: {folder.name}/ has readings in {100 * share:.0f} % of its pixels"
        if share < _FEW_READINGS:
            out.append(Finding("warning", text, name, "check exposure and range of the depth camera"))
            continue
        ratios = [found for m in maps if (found := floor_ratio(m, camera)) is not None]
        if not ratios:
            out.append(Finding("ok", f"{text}; it reads no floor, so that its unit cannot be checked", name))
            continue
        middle = float(np.median([r for r, _ in ratios]))
        text += f", and the floor at {100 * middle:.1f} % of its distance"
        if abs(middle - 1) > _POOR_SHARE and all(_fits_upside_down(m, camera) for m in maps):
            out.append(Finding("error", _UPSIDE_DOWN, name, _TURN_THEM))
        elif abs(middle - 1) > _POOR_SHARE:
            remedy = "register depth and pictures again, or calibrate the camera again"
            out.append(Finding("warning", text, name, remedy))
        else:
            out.append(Finding("ok", text, name))
    return out


def _some_maps(session: Session, name: str) -> list[NDArray[np.float32]]:
    """At most _MOST_LOOKS maps of a camera, spread over the clip; the last one is the last of the clip."""
    order = list(session.depth_sources).index(name)
    wanted = np.unique(np.linspace(session.frames[0], session.frames[-1], _MOST_LOOKS).astype(int)).tolist()
    with depth_of(session, wanted) as reader:
        return [maps[order] for _, maps in reader]
