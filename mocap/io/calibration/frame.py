"""From a file's world to ours: metres, z up, the floor at z = 0, cameras that can be."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mocap.data import Camera, CameraRig
from mocap.errors import MocapError
from mocap.io.calibration.record import MOST_PX, CalibrationFile, RawCamera, RawRig, bad
from mocap.io.units import METRES_PER_UNIT, Z_UP_FROM

Array = NDArray[np.float64]

# Largest distance between two cameras of a rig that films people.
PLAUSIBLE_SPAN_M = (0.3, 100.0)
# A camera standing on the floor of a roughly levelled rig may come out a little below it.
FLOOR_TOLERANCE_M = 0.3
# Focal length as a share of the longer side of the picture: the widest fisheye lenses have 0.15, a telephoto lens of
# 800 mm on a small chip has 150.
FOCAL_SHARE = (0.02, 1000.0)
# Six printed decimals make R wrong by 1e-6; beyond 1e-2 it is another matrix, not a rounded rotation.
# Below 1e-9 the matrix is left alone, so that our own files come back bit for bit.
_ROTATION_EXACT, _ROTATION_NOTE, _ROTATION_LIMIT = 1e-9, 1e-6, 1e-2


def in_our_frame(
    raw: RawRig, path: Path, units: str | None, up: str | None, check_world: bool
) -> CalibrationFile:
    """The cameras of a file in metres, z up, with what was converted and what is doubtful.

    units, up : of the user, None = what the file says.  check_world : whether the floor must lie at z = 0.
    Raises MocapError for zero cameras, doubled names, cameras that cannot be, implausible distances.
    """
    _check_names(raw, path)
    notes, warnings = list(raw.notes), list(raw.warnings)
    unit = _chosen_unit(raw, units, notes, warnings)
    guessed = frozenset(c.name for c in raw.cameras if c.size is None)
    if guessed:
        warnings.append(
            f"no picture size in the file for {_some(sorted(guessed))}; twice the principal point assumed"
        )
    cameras = [_checked_camera(c, path, METRES_PER_UNIT[unit], notes, warnings) for c in raw.cameras]
    _check_distances(cameras, path, unit, units is None and not raw.is_unit_sure)
    cameras = _z_up(cameras, up, raw.up, notes, warnings)
    if check_world:
        _check_floor(cameras, path, warnings)
    return CalibrationFile(
        CameraRig(tuple(cameras)),
        path,
        raw.format,
        unit,
        tuple(notes),
        raw.rms_px,
        tuple(warnings),
        guessed,
    )


def _check_names(raw: RawRig, path: Path) -> None:
    if not raw.cameras:
        raise MocapError(
            "the calibration holds no camera",
            path=path,
            remedy="calibrate at least two cameras, or name the right file with --calibration",
        )
    names = [c.name for c in raw.cameras]
    if doubled := sorted({n for n in names if names.count(n) > 1}):
        raise bad(
            path,
            f"camera name {', '.join(doubled)} is used more than once",
            camera=doubled[0],
            remedy="give every camera its own `name`",
        )


def _chosen_unit(raw: RawRig, units: str | None, notes: list[str], warnings: list[str]) -> str:
    file_units = raw.units or "m"
    chosen = units or file_units
    if units is not None and raw.is_unit_sure and units != file_units:
        warnings.append(f"units {units} were asked for although the file says {file_units}")
    if chosen != "m":
        notes.append(f"translations converted from {chosen} to m")
    elif units is None and not raw.is_unit_sure:
        notes.append("the file names no unit; metres assumed because the camera distances are plausible")
    return chosen


def _z_up(
    cameras: list[Camera], up: str | None, up_of_file: str | None, notes: list[str], warnings: list[str]
) -> list[Camera]:
    """The cameras in a world whose z points up."""
    axis = up or up_of_file or "z"
    if axis == "z" and up is None and up_of_file is None and _is_upside_down(cameras):
        axis = "-z"
        warnings.append("the z axis of the file points down; the world was turned by 180 degrees about x")
    elif axis != "z":
        notes.append(f"world turned so that {axis} of the file points up (our z)")
    if axis == "z":
        return cameras
    A = Z_UP_FROM[axis]
    return [Camera(c.name, c.size, c.K, c.dist, c.R @ A.T, c.t, c.is_fisheye) for c in cameras]


def _checked_camera(raw: RawCamera, path: Path, scale: float, notes: list[str], doubts: list[str]) -> Camera:
    K = _checked_matrix(raw, path, notes, doubts)
    R = _checked_rotation(raw, path, notes)
    size = raw.size or (round(2 * float(K[0, 2])), round(2 * float(K[1, 2])))
    if min(size) < 1 or max(size) > MOST_PX:
        raise bad(path, "no picture size and none can be guessed", camera=raw.name)
    shares = np.array([K[0, 0], K[1, 1]]) / max(size)
    if shares.min() < FOCAL_SHARE[0] or shares.max() > FOCAL_SHARE[1]:
        raise bad(
            path,
            f"focal lengths of {K[0, 0]:.4g} and {K[1, 1]:.4g} px do not go with pictures of "
            f"{size[0]} x {size[1]}",
            camera=raw.name,
            remedy="give focal lengths in pixels of these pictures",
        )
    if not (0 <= K[0, 2] <= size[0] and 0 <= K[1, 2] <= size[1]):
        doubts.append(
            f"camera {raw.name}: principal point ({K[0, 2]:.0f}, {K[1, 2]:.0f}) lies outside the picture of "
            f"{size[0]} x {size[1]}; are width and height swapped?"
        )
    try:
        return Camera(raw.name, size, K, raw.dist, R, raw.t * scale, raw.is_fisheye)
    except ValueError as error:
        raise bad(path, str(error), camera=raw.name) from error


def _checked_matrix(raw: RawCamera, path: Path, notes: list[str], doubts: list[str]) -> Array:
    K = raw.K.copy()
    if abs(np.linalg.det(K)) < 1e-9 or min(K[0, 0], K[1, 1]) <= 0:
        raise bad(path, "the camera matrix is singular or has a focal length <= 0", camera=raw.name)
    if np.abs(K[2] - [0, 0, 1]).max() > 1e-9 or K[1, 0] != 0:
        raise bad(
            path,
            "the camera matrix is not of the form [[fx, s, cx], [0, fy, cy], [0, 0, 1]]",
            camera=raw.name,
        )
    if K[0, 1] != 0:
        # OpenCV projects without skew; keeping it in K would make two modules disagree.
        (doubts if abs(K[0, 1]) > 0.5 else notes).append(f"camera {raw.name}: skew {K[0, 1]:.3g} px dropped")
        K[0, 1] = 0.0
    return K


def _checked_rotation(raw: RawCamera, path: Path, notes: list[str]) -> Array:
    # Far from a rotation: the products below would overflow.
    if np.abs(raw.R).max() > 10:
        raise bad(path, f"R is not a rotation: it holds {np.abs(raw.R).max():.3g}", camera=raw.name)
    U, singular, Vt = np.linalg.svd(raw.R)
    deviation = float(np.abs(raw.R @ raw.R.T - np.eye(3)).max())
    if np.linalg.det(raw.R) <= 0:
        raise bad(
            path,
            f"R is not a rotation but mirrored (det {np.linalg.det(raw.R):.3f})",
            camera=raw.name,
            remedy="use a right-handed world (swapping two axes mirrors it) and world-to-camera rotations",
        )
    if deviation > _ROTATION_LIMIT:
        raise bad(
            path,
            f"R is not a rotation (R R^T is off by {deviation:.3g}, singular values {np.round(singular, 4)})",
            camera=raw.name,
        )
    R = raw.R
    if deviation > _ROTATION_EXACT:
        R = U @ Vt
        if deviation > _ROTATION_NOTE:
            notes.append(f"camera {raw.name}: rotation was off by {deviation:.1e} and made orthonormal")
    return R


def _check_distances(cameras: list[Camera], path: Path, unit: str, is_assumed: bool) -> None:
    centers = np.array([c.center for c in cameras])
    low, high = PLAUSIBLE_SPAN_M
    if len(cameras) == 1:
        span, what = float(np.linalg.norm(centers[0])), "its distance from the origin"
        low = 0.0
    else:
        span = float(np.linalg.norm(centers[:, None] - centers[None], axis=-1).max())
        what = "the largest distance between two cameras"
    if low <= span <= high:
        return
    in_file = span / METRES_PER_UNIT[unit]
    fitting = [u for u, scale in METRES_PER_UNIT.items() if u != unit and low <= in_file * scale <= high]
    hint = " or ".join(f"{u} ({in_file * METRES_PER_UNIT[u]:.3g} m)" for u in fitting)
    raise bad(
        path,
        f"{what} is {in_file:.4g} in the file, which {'taken as' if is_assumed else 'in'} {unit} "
        f"is {span:.4g} m; people are filmed with {PLAUSIBLE_SPAN_M[0]:g} to {high:g} m",
        remedy="say the unit of the file: calibration_units in session.toml, or --units of `mocap convert-calibration`"
        + (f"; {hint} would fit" if hint else ", or calibrate again"),
    )


def _is_upside_down(cameras: list[Camera]) -> bool:
    """All cameras under the floor and all pictures showing +z downwards: the file's z points down."""
    return all(c.center[2] < 0 for c in cameras) and float(np.mean([-c.R[1, 2] for c in cameras])) < -0.1


def _check_floor(cameras: list[Camera], path: Path, warnings: list[str]) -> None:
    lowest = min(cameras, key=lambda c: c.center[2])
    if lowest.center[2] < -FLOOR_TOLERANCE_M:
        raise _below_the_floor(cameras, lowest, path)
    if lowest.center[2] < 0:
        warnings.append(f"camera {lowest.name} lies {-lowest.center[2]:.2f} m below the floor z = 0")
    if len(cameras) > 1 and all(-c.R[1, 2] < -0.3 for c in cameras):
        warnings.append("all pictures show the world upside down: is the z axis of the calibration right?")


def _below_the_floor(cameras: list[Camera], lowest: Camera, path: Path) -> MocapError:
    below = [c.name for c in cameras if c.center[2] < -FLOOR_TOLERANCE_M]
    # The direction that pictures show as "up", averaged; it tells which axis the author meant.
    up = -np.sum([c.R[1] for c in cameras], axis=0)
    i = int(np.argmax(np.abs(up)))
    axis = ("" if up[i] > 0 else "-") + "xyz"[i]
    remedy = "put the origin of the calibration on the floor with z up"
    if axis != "z":
        remedy += f'; or, as the pictures show {axis} as up, say calibration_up = "{axis}" in session.toml'
    return bad(
        path,
        f"{_some(below)} {'lie' if len(below) > 1 else 'lies'} below the floor z = 0 "
        f"(camera {lowest.name} at z = {lowest.center[2]:.2f} m)",
        camera=lowest.name,
        remedy=remedy,
    )


def _some(names: Sequence[str], limit: int = 8) -> str:
    more = f" and {len(names) - limit} more" if len(names) > limit else ""
    return ", ".join(names[:limit]) + more
