"""Fiducial markers in pictures: of which family they are, whether black and white are exchanged, or left and right."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from mocap.arrays import Array, Indices

Grey = NDArray[np.uint8]


def _of_size(bits: int) -> tuple[int, ...]:
    """OpenCV's dictionaries of markers of so many bits along a side, each the beginning of the next."""
    return tuple(int(getattr(cv2.aruco, f"DICT_{bits}X{bits}_{n}")) for n in (50, 100, 250, 1000))


# Of `mocap board`: markers of 5 x 5 bits, readable down to some 20 px.
OURS = "5x5"
TAGS = "AprilTag 36h11"
FAMILIES: dict[str, tuple[int, ...]] = {
    OURS: (cv2.aruco.DICT_5X5_1000,),
    "4x4": _of_size(4),
    "6x6": _of_size(6),
    "7x7": _of_size(7),
    TAGS: (cv2.aruco.DICT_APRILTAG_36h11,),
    "ArUco original": (cv2.aruco.DICT_ARUCO_ORIGINAL,),
}
# Different markers of one family in one picture that are no accident: the noise of a room passes for one now and then.
LEAST_MARKERS = 4


@dataclass(frozen=True, eq=False)
class Fiducials:
    """Markers that a picture shows.

    family : one of FAMILIES.  is_negative : black and white are exchanged.  numbers (N,), corners (N, 4, 2) px, of a
    mirror image in that image.
    """

    family: str
    is_negative: bool
    numbers: Indices
    corners: Array


def dictionary_of(family: str, n_markers: int) -> Any:
    """OpenCV's smallest dictionary of a family that holds so many markers: it forgives the most misread bits."""
    dictionaries = [cv2.aruco.getPredefinedDictionary(number) for number in FAMILIES[family]]
    return next((d for d in dictionaries if len(d.bytesList) >= n_markers), dictionaries[-1])


def fiducials_in(grey: Grey, n_markers: int = 250) -> Fiducials | None:
    """Markers numbered below n_markers in a picture (H, W), of the family of which it shows most, four at least.

    The picture is looked at as it is, then as a negative, then both in a mirror; None when nothing is found.
    """
    parameters = cv2.aruco.DetectorParameters()
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
    detector = cv2.aruco.ArucoDetector([dictionary_of(family, n_markers) for family in FAMILIES], parameters)
    for is_mirrored, is_negative in product((False, True), repeat=2):
        picture = np.ascontiguousarray(grey[:, ::-1]) if is_mirrored else grey
        corners, numbers, _, families = detector.detectMarkersMultiDict(
            255 - picture if is_negative else picture
        )
        if numbers is None or not len(numbers):
            continue
        quads = np.array([np.reshape(quad, (4, 2)) for quad in corners], dtype=np.float64)
        for row in np.argsort(-np.bincount(np.ravel(families), minlength=len(FAMILIES)), kind="stable"):
            of_family = np.flatnonzero((np.ravel(families) == row) & (np.ravel(numbers) < n_markers))
            # A number that is seen twice is nobody's.
            found, first, times = np.unique(
                np.ravel(numbers)[of_family], return_index=True, return_counts=True
            )
            once = times == 1
            if once.sum() >= LEAST_MARKERS:
                return Fiducials(
                    tuple(FAMILIES)[row],
                    is_negative,
                    found[once].astype(np.int64),
                    quads[of_family[first[once]]],
                )
    return None
