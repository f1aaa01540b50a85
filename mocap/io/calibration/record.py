"""A calibration as its file has it, and as it is handed on; the numbers of a file checked one by one."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mocap.data import CameraRig
from mocap.errors import MocapError
from mocap.geometry.rigid import matrix_from_rotation_vector

Array = NDArray[np.float64]

# The largest pictures of today's cameras are 20,000 pixels wide.
MOST_PX = 100_000
# Millimetres in a thousand kilometres; entries of a matrix stay far below.
MOST = 1e9
# Lenses of long focal length have coefficients of some ten thousand at high powers of a small radius.
MOST_DISTORTION = 1e6
# A rotation vector of more than some turns is no vector but a mistake.
MOST_TURN_RAD = 100.0
MOST_LETTERS = 100


@dataclass(frozen=True, eq=False)
class CalibrationFile:
    """What a calibration file said, converted to metres, z up, world to camera.

    units : unit of the translations in the file.  notes : conversions that were made.  warnings : doubts.
    rms_px : reprojection error that the file itself claims, px, or None.
    guessed_sizes : cameras whose picture size the file does not give; twice the principal point was taken.
    """

    rig: CameraRig
    path: Path
    format: str
    units: str
    notes: tuple[str, ...] = ()
    rms_px: float | None = None
    warnings: tuple[str, ...] = ()
    guessed_sizes: frozenset[str] = frozenset()


@dataclass(frozen=True, eq=False)
class RawCamera:
    """One camera as the file has it: own unit, own world axes, nothing checked but the shapes."""

    name: str
    size: tuple[int, int] | None
    K: Array
    dist: Array
    R: Array
    t: Array
    is_fisheye: bool = False


@dataclass(frozen=True, eq=False)
class RawRig:
    """All cameras of a file.

    units, up : None = the file does not say.  is_unit_sure : False = the unit is only the custom of the format.
    """

    cameras: tuple[RawCamera, ...]
    format: str
    units: str | None = None
    is_unit_sure: bool = True
    up: str | None = None
    rms_px: float | None = None
    notes: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()


def bad(path: Path, message: str, *, camera: str | None = None, remedy: str = "") -> MocapError:
    """The error of a calibration that makes no sense."""
    return MocapError(
        f"bad calibration: {message}",
        path=path,
        camera=camera,
        remedy=remedy or "correct the file or calibrate again",
    )


def numbers(path: Path, camera: str | None, key: str, value: Any, shape: tuple[int, ...]) -> Array:
    """A table of finite numbers of this shape; column vectors and flat matrices are taken too."""
    try:
        found = np.array(value, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise bad(path, f"{key} is not a table of numbers", camera=camera) from error
    # Column vectors and flat matrices are both common: only the count must be right.
    if found.size != int(np.prod(shape)):
        raise bad(path, f"{key} has {found.size} numbers, expected {int(np.prod(shape))}", camera=camera)
    if not np.isfinite(found).all():
        raise bad(path, f"{key} holds a number that is not finite", camera=camera)
    if np.abs(found).max() > MOST:
        raise bad(path, f"{key} holds {np.abs(found).max():.3g}, which no camera has", camera=camera)
    return found.reshape(shape)


def distortion(path: Path, camera: str, value: Any, is_fisheye: bool) -> Array:
    """Distortion numbers in the order and the count of OpenCV: 4 of a fisheye, else 4, 5, 8, 12 or 14."""
    try:
        flat = np.array(value, dtype=np.float64).ravel()
    except (TypeError, ValueError) as error:
        raise bad(path, "the distortion is not a list of numbers", camera=camera) from error
    if not np.isfinite(flat).all():
        raise bad(path, "the distortion holds a number that is not finite", camera=camera)
    if np.abs(flat).max(initial=0.0) > MOST_DISTORTION:
        raise bad(path, f"the distortion holds {np.abs(flat).max():.3g}, which no lens has", camera=camera)
    if is_fisheye:
        if len(flat) < 4 or np.any(flat[4:]):
            raise bad(path, f"a fisheye camera has 4 distortion numbers, not {len(flat)}", camera=camera)
        return flat[:4]
    if len(flat) in {1, 2, 3}:
        return np.concatenate([flat, np.zeros(4 - len(flat))])
    if len(flat) not in {4, 5, 8, 12, 14}:
        raise bad(path, f"{len(flat)} distortion numbers; OpenCV knows 4, 5, 8, 12 or 14", camera=camera)
    return flat


def picture_size(path: Path, camera: str, value: Any) -> tuple[int, int]:
    """(width, height) px."""
    w, h = numbers(path, camera, "size", value, (2,))
    if not (1 <= w <= MOST_PX and 1 <= h <= MOST_PX) or w % 1 or h % 1:
        raise bad(
            path,
            f"picture size {w:g} x {h:g} is not two whole numbers from 1 to {MOST_PX:g}",
            camera=camera,
        )
    return int(w), int(h)


def rotation(path: Path, camera: str, value: Any) -> Array:
    """A 3 x 3 matrix from a matrix or a Rodrigues vector, as given (not yet made orthonormal)."""
    try:
        n_numbers = np.array(value, dtype=np.float64).size
    except (TypeError, ValueError) as error:
        raise bad(path, "rotation is not a table of numbers", camera=camera) from error
    if n_numbers != 3:
        return numbers(path, camera, "rotation", value, (3, 3))
    vector = numbers(path, camera, "rotation", value, (3,))
    if np.linalg.norm(vector) > MOST_TURN_RAD:
        raise bad(path, f"rotation turns by {np.linalg.norm(vector):.3g} rad", camera=camera)
    return matrix_from_rotation_vector(vector)


def camera_name(path: Path, value: Any) -> str:
    """The name of a camera: text or a whole number, not empty, on one line; it becomes part of file names."""
    name = str(value) if isinstance(value, str | int) else ""
    if not name.strip() or not name.isprintable() or len(name) > MOST_LETTERS:
        raise bad(
            path,
            f"{str(value)[:40]!r} cannot be the name of a camera",
            remedy="give every camera a name of letters and digits",
        )
    return name
