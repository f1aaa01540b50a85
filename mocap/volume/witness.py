"""Where persons can be in a picture, told by what the other cameras show."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from mocap.data import CameraRig, VoxelGrid
from mocap.volume.carve import Carver
from mocap.volume.components import connected_components
from mocap.volume.residuals import silhouette
from mocap.volume.surface import surface_voxels

Mask = NDArray[np.bool_]
Voxels = NDArray[np.int32]

_SHADOW_M = 0.06  # a shadow on the floor is no volume
_PERSON_LITRES = 8.0
_PERSON_TOP_M = 0.5
_KNEE_M = 0.45  # feet stand still: what reaches below the knee reaches the floor
_FOOT_M = 0.16  # height of a foot
_FOOT_REACH_M = 0.14  # from the lower leg to the toe
_CUT_MARGIN_PX = 3  # a cut may be off by so much


class Witness:
    """The cameras of a rig on one grid, asked what the others let one camera see.

    Not to be shared between threads.
    """

    def __init__(self, rig: CameraRig, grid: VoxelGrid) -> None:
        self._rig, self._grid = rig, grid
        self._carver = Carver(rig, grid)
        self._tolerance = 1 if len(rig) >= 5 else 0  # cameras that may miss a part; four cannot afford it

    def regions(self, active: Sequence[Mask]) -> list[Mask]:
        """Where persons can be in each picture at any time, (H, W) bool per camera.

        active : (H, W) bool per camera, where something was at some time, shadows included. Feet that stand still
        may be missing.
        """
        voxels = self._carver.carve(active, n_faulty_views=self._tolerance)
        voxels = voxels[self._grid.centers(voxels)[:, 2] > _SHADOW_M]
        return self._seen(self._to_the_floor(self._persons(voxels)))

    def corrected(self, cuts: Sequence[Mask]) -> list[tuple[Mask, Mask]]:
        """What is allowed and what is likely in each picture of one instant, (H, W) bool each; see refine_mask.

        cuts : (H, W) bool per camera; some may be far too large, and one camera in three too small.
        """
        wide = self._carver.carve(cuts, n_faulty_views=2 * self._tolerance)
        tight = self._carver.carve(cuts, n_faulty_views=self._tolerance)
        disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * _CUT_MARGIN_PX + 1,) * 2)
        out = []
        for may, must, cut in zip(
            self._seen(self._persons(wide)), self._seen(self._persons(tight)), cuts, strict=True
        ):
            allowed = cv2.dilate(may.astype(np.uint8), disc) > 0
            core = (
                cv2.erode(must.astype(np.uint8), cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (15, 15))) > 0
            )
            out.append((allowed, allowed & (cut | core)))
        return out

    def _seen(self, voxels: Voxels) -> list[Mask]:
        points = self._grid.centers(voxels[surface_voxels(voxels, self._grid)])
        return [silhouette(camera, points, self._grid.voxel_size_m) for camera in self._rig]

    def _persons(self, voxels: Voxels) -> Voxels:
        """The components that can be persons."""
        labels, n = connected_components(voxels, self._grid)
        litres = np.bincount(labels, minlength=n) * self._grid.voxel_size_m**3 * 1000.0
        top = np.zeros(n)
        np.maximum.at(top, labels, self._grid.centers(voxels)[:, 2])
        return voxels[((litres >= _PERSON_LITRES) & (top >= _PERSON_TOP_M))[labels]]

    def _to_the_floor(self, voxels: Voxels) -> Voxels:
        """The voxels with legs and feet below what reaches below the knee."""
        side = self._grid.voxel_size_m
        full = self._grid.dense(voxels).astype(np.uint8)
        knee, foot, reach = (max(1, round(length / side)) for length in (_KNEE_M, _FOOT_M, _FOOT_REACH_M))
        leg = cv2.dilate(full[:, :, :knee].any(axis=2).astype(np.uint8), np.ones((3, 3), np.uint8))
        full[:, :, :knee] |= leg[:, :, None]
        disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * reach + 1, 2 * reach + 1))
        full[:, :, :foot] |= cv2.dilate(leg, disc)[:, :, None]
        return np.flatnonzero(full.ravel()).astype(np.int32)
