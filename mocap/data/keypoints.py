"""2D keypoints of a session: named points of persons, as a pose network or a person found them in single pictures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mocap.arrays import Array, Indices

_MIDDLE = ("nose", "head", "neck", "pelvis")
_PAIRED = ("eye", "ear", "shoulder", "elbow", "wrist", "hand", "hip", "knee", "ankle", "heel", "toe")
# Every keypoint that has a place on the body; what a tool calls them stands in `mocap.io.keypoints.names`.
KEYPOINTS: tuple[str, ...] = (*_MIDDLE, *(f"{side}_{name}" for name in _PAIRED for side in ("left", "right")))
N_KEYPOINTS = len(KEYPOINTS)
# The keypoints (P, K, 3) m of nobody.
NOBODY: Array = np.zeros((0, N_KEYPOINTS, 3))


def _mirror(name: str) -> str:
    other = {"left": "right", "right": "left"}
    side, _, rest = name.partition("_")
    return f"{other[side]}_{rest}" if side in other else name


# Row of the keypoint on the other side of the body, (K,); of the middle ones their own.
MIRRORED: Indices = np.array([KEYPOINTS.index(_mirror(name)) for name in KEYPOINTS], dtype=np.int64)


@dataclass(frozen=True, eq=False)
class Figures:
    """Persons as single pictures show them: one figure is the keypoints of one person in one picture.

    uv : (N, K, 2) px, NaN = not found, in the order of KEYPOINTS.  confidence : (N, K) from 0 to 1.  camera : (N,)
    index in the rig.
    """

    uv: Array
    confidence: Array
    camera: Indices

    def __post_init__(self) -> None:
        n = len(self.camera)
        for name, shape in (("uv", (n, N_KEYPOINTS, 2)), ("confidence", (n, N_KEYPOINTS))):
            if getattr(self, name).shape != shape:
                raise ValueError(f"{name} has shape {getattr(self, name).shape}, expected {shape}")

    def __len__(self) -> int:
        return len(self.camera)

    def rows(self, which: NDArray[np.bool_] | Indices) -> Figures:
        """Some of the figures."""
        return Figures(self.uv[which], self.confidence[which], self.camera[which])


def no_figures() -> Figures:
    """The figures of a frame in which nobody was found."""
    return Figures(np.zeros((0, N_KEYPOINTS, 2)), np.zeros((0, N_KEYPOINTS)), np.zeros(0, dtype=np.int64))


def joined(figures: Sequence[Figures]) -> Figures:
    """The figures of several pictures of one frame."""
    some = [f for f in figures if len(f)]
    if not some:
        return no_figures()
    return Figures(
        np.concatenate([f.uv for f in some]),
        np.concatenate([f.confidence for f in some]),
        np.concatenate([f.camera for f in some]),
    )
