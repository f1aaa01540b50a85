"""Whether depth maps lie on the pictures of their camera: what moves before the room is in the silhouettes there.

A map that is mirrored or turned fits the floor as well as a right one; who walks about does not.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from mocap.arrays import Array, Mask

DepthMap = NDArray[np.float32]

_STRIDE_PX = 4
_BEFORE_M = 0.3  # who stands before a wall; ten deviations of a reading 4 m away
_LEAST_PIXELS = 500  # of somebody, in all frames together, every fourth along rows and columns
# Of maps that lie on their pictures 3 % of what moves is beside the silhouettes' hulls, of others more than a third.
_BESIDE_SHARE = 0.15
_ELSEWHERE_SHARE = 0.5
_BETTER = 0.5  # another way to lay them must bring that down to this share
# What is wrong -> along which axes of the map, rows and columns, it is turned about.
_TURNS = {
    "mirrored, left for right": (1,),
    "mirrored, top for bottom": (0,),
    "turned by half a turn": (0, 1),
}


@dataclass(frozen=True)
class DepthTurn:
    """How maps lie on the pictures.  beside_share : of what moves in them, beside the silhouettes.  turn : what
    explains that, "" = nothing that is known.  explained_share : what is beside them then."""

    beside_share: float
    turn: str = ""
    explained_share: float = float("nan")

    @property
    def agrees(self) -> bool:
        """Whether nothing is said against the maps."""
        return not self.turn and self.beside_share <= _ELSEWHERE_SHARE


def find_turn(maps: Sequence[DepthMap], hulls: Sequence[Array]) -> DepthTurn | None:
    """How maps lie on pictures, None where hardly anything moves in them.

    maps : (H, W) float32 m, 0 = no reading, of some frames of a camera.  hulls : corners (P, 2) px of the silhouettes
    in the same frames, (0, 2) where nobody is seen: such a frame says nothing.
    """
    pairs = [
        (near, _drawn(hull, near.shape)) for near, hull in zip(_moving(maps), hulls, strict=True) if len(hull)
    ]
    if sum(np.count_nonzero(near) for near, _ in pairs) < _LEAST_PIXELS:
        return None

    def beside(axes: tuple[int, ...]) -> float:
        inside = sum(np.count_nonzero(np.flip(near, axes) & seen) for near, seen in pairs)
        return 1.0 - inside / sum(np.count_nonzero(near) for near, _ in pairs)

    own = beside(())
    others = {turn: beside(axes) for turn, axes in _TURNS.items()}
    best = min(others, key=others.__getitem__)
    if own <= _BESIDE_SHARE or others[best] > _BETTER * own:
        return DepthTurn(own)
    return DepthTurn(own, best, others[best])


def _moving(maps: Sequence[DepthMap]) -> list[Mask]:
    """Where a reading lies well before the farthest but one of its pixel: somebody, or something that was moved."""
    small = np.stack([one[::_STRIDE_PX, ::_STRIDE_PX] for one in maps])
    room = np.sort(small, axis=0)[-2] if len(small) > 1 else small[0]
    return list((small > 0) & (small < room - _BEFORE_M))


def _drawn(hull: Array, shape: tuple[int, ...]) -> Mask:
    canvas = np.zeros(shape, dtype=np.uint8)
    cv2.fillConvexPoly(canvas, np.rint(hull / _STRIDE_PX).astype(np.int32), 1)
    return canvas.view(np.bool_)
