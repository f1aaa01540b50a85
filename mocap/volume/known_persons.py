"""Known persons: what is right with silhouettes where keypoints say who is there.

Where cameras agree on the points of a person, one whose silhouette lacks a part of him does not see that nobody is
there: something stands before him, or he looks like the wall behind him. And where silhouettes of known persons cross
elsewhere, nobody has to be.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mocap.arrays import Array, Mask
from mocap.data import Camera, CameraRig, VoxelGrid
from mocap.data.keypoints import KEYPOINTS
from mocap.data.voxels import Voxels

_STEP_M = 0.02  # between the places at which a part of a body is looked for in silhouettes
# How far from a silhouette a keypoint's error takes a place that is in it: nine of ten points on which views agree are
# off by less.
_BESIDE_M = 0.06
# So much of a person must be in some silhouette: of somebody else it is little.
_SHOWN_SHARE = 0.5
_CROSSING = 2  # persons whose silhouettes can cross elsewhere than in one of them
# A piece of room that silhouettes of known persons let stand is nobody's at this distance from all of them; their
# silhouettes reach as far beyond the flesh as keypoints err, with hair and clothes.
_NOBODY_M = 0.15
_FRINGE_M = 0.15
# Of distances from silhouettes that tell whether keypoints are of the same moment: whoever is further is elsewhere.
_FAR_M, _STRIDE_PX = 0.3, 4
# Radii of flesh around the lines between keypoints; that of limbs reaches back to what is seen, _BESIDE_M and a step.
_LIMB_M, _TRUNK_M, _HEAD_M = 0.08, 0.14, 0.12


def _parts() -> list[tuple[tuple[str, ...], tuple[str, ...], float]]:
    """From the middle of some keypoints to the middle of others, with the radius of the flesh, m."""
    limbs = ("shoulder", "elbow"), ("elbow", "wrist"), ("hip", "knee"), ("knee", "ankle"), ("ankle", "toe")
    sides = [[f"{side}_{name}" for side in ("left", "right")] for name in ("shoulder", "hip", "ear")]
    shoulders, hips, ears = (tuple(pair) for pair in sides)
    return [
        *(((f"{s}_{a}",), (f"{s}_{b}",), _LIMB_M) for s in ("left", "right") for a, b in limbs),
        *(((f"{s}_shoulder",), (f"{s}_hip",), _LIMB_M) for s in ("left", "right")),
        (shoulders, hips, _TRUNK_M),
        (shoulders, ears, _HEAD_M),
    ]


_PARTS = [
    ([KEYPOINTS.index(k) for k in a], [KEYPOINTS.index(k) for k in b], radius) for a, b, radius in _parts()
]


def flesh_along(person: Array) -> tuple[Array, Array]:
    """Balls of flesh along the bones of a person: centres (S, 3) m and radii (S,) m.

    person : (K, 3) m in the order of KEYPOINTS, NaN = not known; a part whose ends are not known has none.
    """
    centres, radii = [np.zeros((0, 3))], [np.zeros(0)]
    for first, last, radius in _PARTS:
        a, b = person[first].mean(axis=0), person[last].mean(axis=0)
        length = float(np.linalg.norm(b - a))
        if np.isfinite(length):
            along = np.linspace(0.0, 1.0, 2 + int(length / _STEP_M))[:, None]
            centres.append(a + along * (b - a))
            radii.append(np.full(len(along), radius))
    return np.concatenate(centres), np.concatenate(radii)


def missing_parts(masks: Sequence[Mask], rig: CameraRig, points: Array) -> list[Mask | None]:
    """Of every camera the pixels (H, W) bool where its silhouettes lack a part of a known person; None = of nobody.

    masks : (H, W) bool per camera.  points : (P, K, 3) m in the order of KEYPOINTS, NaN = not known. A person most of
    whom no silhouette shows is left out: keypoints and silhouettes are of different moments, or rooms.
    """
    missing: list[Mask | None] = [None] * len(masks)
    beside_px = [_distance_px(mask) for mask in masks] if len(points) else []
    for person in points:
        balls = [Balls.seen(camera, *flesh_along(person)) for camera in rig]
        lacks = np.array([own.lie_beside(far) for own, far in zip(balls, beside_px, strict=True)])
        is_inside = np.array([own.is_inside for own in balls])
        is_shown = (is_inside & ~lacks).any(axis=0)
        if is_shown.sum() < _SHOWN_SHARE * is_inside.any(axis=0).sum():
            continue
        for c, (own, row) in enumerate(zip(balls, lacks, strict=True)):
            if row.any():
                missing[c] = own.drawn(masks[c].shape, row, missing[c])
    return missing


def completed(masks: Sequence[Mask], rig: CameraRig, points: Array) -> list[Mask]:
    """The silhouettes with what they lack of known persons; the arguments are those of `missing_parts`."""
    return [
        mask if lacks is None else mask | lacks
        for mask, lacks in zip(masks, missing_parts(masks, rig, points), strict=True)
    ]


def nobodys(voxels: Voxels, grid: VoxelGrid, rig: CameraRig, points: Array) -> NDArray[np.bool_]:
    """Which voxels (N,) lie far from all known persons, although every camera sees one of those there, (N,) bool.

    One person's silhouettes cross nowhere else than in that person: with less than two known nothing is nobody's.
    """
    out = np.zeros(len(voxels), dtype=np.bool_)
    known = [flesh_along(person) for person in points]
    if len(known) < _CROSSING or not len(voxels):
        return out
    centres, radii = (np.concatenate(parts) for parts in zip(*known, strict=True))
    at = grid.centers(voxels)
    far = np.ones(len(at), dtype=np.bool_)
    for radius in np.unique(radii):
        reach = radius + _NOBODY_M
        far &= np.isinf(cKDTree(centres[radii == radius]).query(at, distance_upper_bound=reach)[0])
    left = np.flatnonzero(far)
    for camera in rig:
        balls = Balls.seen(camera, centres, radii + _FRINGE_M)
        seen = balls.drawn(camera.size[::-1], balls.is_inside)
        where, _ = camera.project(at[left])
        inside = camera.contains(where)
        column, row = np.floor(where[inside] + 0.5).astype(np.int64).T
        is_seen = np.ones(len(left), dtype=np.bool_)
        is_seen[inside] = seen[np.minimum(row, camera.size[1] - 1), np.minimum(column, camera.size[0] - 1)]
        left = left[is_seen]
    out[left] = True
    return out


@dataclass(frozen=True, eq=False)
class BesideSilhouettes:
    """Distances from the silhouettes of one frame, kept small.  px : (h, w) per camera, of every _STRIDE_PX-th pixel;
    None = no silhouette, of which nothing is said."""

    rig: CameraRig
    px: tuple[Array | None, ...]

    @classmethod
    def of(cls, masks: Sequence[Mask], rig: CameraRig) -> BesideSilhouettes:
        """masks : (H, W) bool per camera."""
        small = [mask[::_STRIDE_PX, ::_STRIDE_PX] for mask in masks]
        return cls(rig, tuple(_STRIDE_PX * _distance_px(m) if m.any() else None for m in small))

    def mean_m(self, points: Array) -> float:
        """How far points (P, K, 3) m of known persons lie beside them, m, in the mean over points and cameras, each at
        most _FAR_M; NaN where none is seen."""
        flat = points.reshape(-1, 3)
        flat, found = flat[np.isfinite(flat).all(axis=1)], [np.zeros(0)]
        for camera, px in zip(self.rig, self.px, strict=True):
            if px is not None:
                own = Balls.seen(camera, flat, np.zeros(len(flat)))
                v, u = (own.at[own.is_inside] // _STRIDE_PX).T[::-1]
                found.append(np.minimum(px[v, u] / own.per_m[own.is_inside], _FAR_M))
        beside = np.concatenate(found)
        return float(beside.mean()) if len(beside) else float("nan")


@dataclass(frozen=True, eq=False)
class Balls:
    """Balls in a picture.  at : (S, 2) nearest pixels.  size : (S,) px, their radii.  per_m : (S,) pixels per metre.
    is_inside : (S,) whether their centres are in the picture."""

    at: NDArray[np.int64]
    size: NDArray[np.int64]
    per_m: Array
    is_inside: NDArray[np.bool_]

    @classmethod
    def seen(cls, camera: Camera, centres: Array, radii: Array) -> Balls:
        """Balls as a camera sees them.  centres : (S, 3) m.  radii : (S,) m."""
        if not len(centres):
            none = np.zeros(0, dtype=np.int64)
            return cls(none.reshape(0, 2), none, np.zeros(0), none.astype(np.bool_))
        uv, depth = camera.project(centres)
        is_inside = camera.contains(uv)
        per_m = camera.K[0, 0] / np.maximum(depth, 0.1)
        last = np.array(camera.size) - 1
        at = np.clip(np.floor(np.where(is_inside[:, None], uv, 0.0) + 0.5), 0, last).astype(np.int64)
        return cls(at, np.rint(radii * per_m).astype(np.int64), per_m, is_inside)

    def lie_beside(self, beside_px: Array) -> NDArray[np.bool_]:
        """Which of them, (S,), lie in the picture and beside the silhouette.  beside_px : (H, W) distance from it."""
        return self.is_inside & (beside_px[self.at[:, 1], self.at[:, 0]] > _BESIDE_M * self.per_m)

    def drawn(self, shape: tuple[int, ...], which: NDArray[np.bool_], on: Mask | None = None) -> Mask:
        """Discs (H, W) bool of some of them (S,), beside what is drawn already."""
        canvas = np.zeros(shape, dtype=np.uint8) if on is None else on.view(np.uint8)
        for (u, v), radius in zip(self.at[which].tolist(), self.size[which].tolist(), strict=True):
            cv2.circle(canvas, (u, v), radius, 1, -1)
        return canvas.view(np.bool_)


def _distance_px(mask: Mask) -> Array:
    """Distance (H, W) of every pixel from a silhouette, px; infinite where there is none."""
    if not mask.any():
        return np.full(mask.shape, np.inf)
    return np.asarray(cv2.distanceTransform((~mask).astype(np.uint8), cv2.DIST_L2, 3))
