"""Where persons can be in a picture, told by what the other cameras show."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from mocap.data import CameraRig, VoxelGrid
from mocap.volume.carve import Carver, default_min_views
from mocap.volume.components import connected_components
from mocap.volume.lost_legs import lost_legs
from mocap.volume.residuals import silhouette
from mocap.volume.surface import surface_voxels

Mask = NDArray[np.bool_]
Voxels = NDArray[np.int32]

_SHADOW_M = 0.06  # a shadow on the floor is no volume
_PERSON_LITRES = 8.0
_PERSON_TOP_M = 0.5
# Still shanks of who stands have 3 each, as cameras see them that take them for a thing, a chair 72 (decision 116).
_THING_LITRES = 10.0
_HAND_LITRES = 0.5  # somebody moves there, and be it a hand: a body that stirs little is no thing then
_BODY_REACH_M = 0.3  # seen from above, from what hangs in the air to what carries it: from a hand to a trunk
_KNEE_M = 0.45  # feet stand still: what reaches below the knee reaches the floor
_CUT_KNEE_M = 0.6  # a lower leg that stands still is missing in all cuts alike, knee and all
_FOOT_M = 0.16  # height of a foot
_FOOT_REACH_M = 0.14  # from the lower leg to the toe
_CUT_REACH_M = 0.1  # the same from a hull of cuts, which is fatter
_HEAD_M = 0.25  # from the shoulders to the crown: a head that is held still is missing too
_HEAD_OVER_M = 0.8  # of somebody who crouches
_HEAD_REACH_M = 0.25  # around the highest place of a person nothing else is a head
_HEAD_SLACK_M = 0.15  # how far below the highest place its neighbours may belong to it
_CUT_MARGIN_PX = 3  # a cut may be off by so much
_THING_RIM_PX = 5  # beside what is told to keep still, which is smaller than the thing
_CORE_PX = 7  # what lies further inside is likely
_SURE_PX = 11  # and what lies still further inside of what nearly all cameras say is certain
_OWN_PX = 4  # and what a camera has cut itself and others bear out is, whatever its colours
# Of the cameras, that may miss a part: trousers as dark as the floor were in five cuts of eight (decision 83,
# `python -m eval.no_empty_clip`, scene in_place_alike).
_MINORITY = 0.375
_FEW = 0.125  # that may miss what is certain: none of seven, one of eight
_NECK_M = 0.05  # around the highest place a head begins


class Guess(NamedTuple):
    """What the others say about one picture, (H, W) bool each; see refine_mask."""

    allowed: Mask
    likely: Mask
    sure: Mask


class Witness:
    """The cameras of a rig on one grid, asked what the others let one camera see.

    active : (H, W) bool per camera, where something was at some time, shadows included. Feet that stand still may be
    missing.
    Not to be shared between threads.
    """

    def __init__(self, rig: CameraRig, grid: VoxelGrid, active: Sequence[Mask]) -> None:
        self._rig, self.grid = rig, grid
        self._carver = Carver(rig, grid)
        self._tolerance = 1 if len(rig) >= 5 else 0  # cameras that may miss a part; four cannot afford it
        voxels = self._carver.carve(active, n_faulty_views=self._tolerance)
        persons = self._persons(voxels[grid.centers(voxels)[:, 2] > _SHADOW_M])
        if not self._tolerance:
            # Furniture may hide somebody's legs from one of them: where the others see something move, they are.
            others = self._carver.carve(active, n_faulty_views=1)
            persons = np.union1d(persons, np.intersect1d(self._lost_legs(persons), others)).astype(np.int32)
        self._ever = self._to_the_floor(persons, _KNEE_M, _FOOT_REACH_M)

    def regions(self) -> list[Mask]:
        """Where persons can be in each picture at any time, (H, W) bool per camera."""
        return self._seen(self._ever)

    def corrected(self, cuts: Sequence[Mask], bare: Sequence[Mask]) -> list[Guess]:
        """What is allowed, likely and sure in each picture of one instant.

        cuts : (H, W) bool per camera; some may be far too large, and three cameras in eight too small.
        bare : (H, W) bool per camera, where it shows the room as it knows it: most others are not believed against it,
        nearly all are. What three of four cameras have in their cuts is nobody's for a large part.
        """
        wide = self._persons(self._carver.carve(cuts, n_faulty_views=2 * self._tolerance))
        n_cameras = len(self._rig)
        minority = int(_MINORITY * n_cameras)
        nearly_all = self._where_somebody_was(cuts, self._tolerance)
        most = np.union1d(
            nearly_all,
            # At the edge of the room, where few see him, as many votes are asked for: there are no three that may err.
            self._where_somebody_was(cuts, minority, min_votes=n_cameras - minority),
        ).astype(np.int32)
        agreed = self._where_somebody_was(cuts, int(_FEW * n_cameras))
        told = zip(
            self._told(nearly_all, wide), self._told(most, wide), self._seen(agreed), cuts, bare, strict=True
        )
        out = []
        for (may, borne_out), (may_too, borne_too), certain, cut, room in told:
            allowed = may | (may_too & ~room)
            likely = cut | _inside(borne_out, _CORE_PX) | (_inside(borne_too, _CORE_PX) & ~room)
            sure = _inside(certain, _SURE_PX) | _inside(cut & borne_out & ~room, _OWN_PX)
            out.append(Guess(allowed, allowed & likely, allowed & sure))
        return out

    def _told(self, voxels: Voxels, wide: Voxels) -> list[tuple[Mask, Mask]]:
        """What is allowed in each picture where a hull is believed, and the hull.  wide : voxels that are allowed
        besides."""
        possible = np.union1d(wide, self._whole(voxels)).astype(np.int32)
        return [
            (_wider(may, _CUT_MARGIN_PX), hull)
            for may, hull in zip(self._seen(possible), self._seen(voxels), strict=True)
        ]

    def _where_somebody_was(
        self, cuts: Sequence[Mask], n_faulty_views: int, min_votes: int | None = None
    ) -> Voxels:
        """The persons of a hull of cuts, as far as somebody was there at some time; see Carver.carve."""
        voxels = self._carver.carve(cuts, n_faulty_views=n_faulty_views, min_votes=min_votes)
        return self._persons(np.intersect1d(voxels, self._ever, assume_unique=True).astype(np.int32))

    def agreed(self, masks: Sequence[Mask]) -> list[Mask]:
        """What nearly all cameras have in their masks, (H, W) bool per camera, as each of them sees it: all but one of
        five that look there and more, of fewer all. Four outvote one; three may take a table at the border of the room
        for a person."""
        votes = default_min_views(len(self._rig))
        return self._seen(self._carver.carve(masks, n_faulty_views=self._tolerance, min_votes=votes))

    def in_some(self, masks: Sequence[Mask], n_cameras: int) -> list[Mask]:
        """What at least so many cameras have in their masks, (H, W) bool per camera, as each sees it, but for shoes and
        what is no larger than legs."""
        n_others = len(self._rig) - n_cameras
        voxels = self._carver.carve(masks, n_faulty_views=n_others, min_votes=n_cameras)
        voxels = voxels[self.grid.centers(voxels)[:, 2] > _FOOT_M]
        labels, n = connected_components(voxels, self.grid)
        return self._seen(voxels[(self._litres(labels, n) >= _THING_LITRES)[labels]])

    def columns(self, cuts: Sequence[Mask]) -> list[Mask]:
        """What stands straight under somebody's legs in the cuts of one instant, (H, W) bool per camera: he hides the
        floor there, whether the cuts have his feet or not.
        """
        person = self._persons(self._carver.carve(cuts, n_faulty_views=self._tolerance))
        return self._seen(self._to_the_floor(person, _CUT_KNEE_M, 0.0))

    def carrying(self, cuts: Sequence[Mask], things: Sequence[Mask], *, hands_only: bool) -> list[Mask]:
        """Whoever hangs in the air once things are gone, with what holds him up, (H, W) bool per camera.

        A person of whom a hand alone is left, or all but his legs, has had his body taken for a thing; who walks round
        a thing, or sits on it, has his feet on the floor, and what is left of the legs of a chair stands there as well.
        cuts, things : (H, W) bool per camera, of one instant.  hands_only : nobody of whom as much as a person is left;
        furniture before him may have hidden his legs.
        """
        whole = self._carver.carve(cuts, n_faulty_views=self._tolerance)
        # Things lack the rim of what they are, which would go on to hold him up.
        rest = [cut & ~_wider(thing, _THING_RIM_PX) for cut, thing in zip(cuts, things, strict=True)]
        left = np.intersect1d(whole, self._carver.carve(rest, n_faulty_views=self._tolerance))
        labels, n = connected_components(whole, self.grid)
        piece_of = np.full(np.prod(self.grid.shape), -1, dtype=np.int32)
        piece_of[whole] = labels
        part, n_parts = connected_components(left, self.grid)
        lowest = np.full(n_parts, np.inf)
        np.minimum.at(lowest, part, self.grid.centers(left)[:, 2])
        is_in_air = (lowest > _FOOT_M)[part]
        hangs = self._litres(piece_of[left[is_in_air]], n) >= _HAND_LITRES
        is_person = np.isin(left, self._persons(left), assume_unique=True)
        hangs[piece_of[left[is_person & (hands_only | ~is_in_air)]]] = False
        columns = self.grid.dense(left[is_in_air & hangs[piece_of[left]]]).any(axis=2).astype(np.uint8)
        near = cv2.dilate(columns, _disc(round(_BODY_REACH_M / self.grid.voxel_size_m))) > 0
        return self._seen(
            np.flatnonzero((self.grid.dense(whole) & near[:, :, None]).ravel()).astype(np.int32)
        )

    def _seen(self, voxels: Voxels) -> list[Mask]:
        points = self.grid.centers(voxels[surface_voxels(voxels, self.grid)])
        return [silhouette(camera, points, self.grid.voxel_size_m) for camera in self._rig]

    def _persons(self, voxels: Voxels) -> Voxels:
        """The components that can be persons."""
        labels, n = connected_components(voxels, self.grid)
        top = np.zeros(n)
        np.maximum.at(top, labels, self.grid.centers(voxels)[:, 2])
        return voxels[((self._litres(labels, n) >= _PERSON_LITRES) & (top >= _PERSON_TOP_M))[labels]]

    def _litres(self, labels: NDArray[np.int32], n: int) -> NDArray[np.float64]:
        """The volume of each of n components, (n,)."""
        return np.asarray(np.bincount(labels, minlength=n) * self.grid.voxel_size_m**3 * 1000.0)

    def _whole(self, voxels: Voxels) -> Voxels:
        """The voxels with legs and heads, where those can be missing."""
        standing = np.union1d(voxels, self._lost_legs(voxels)).astype(np.int32)
        return self._to_the_crown(self._to_the_floor(standing, _CUT_KNEE_M, _CUT_REACH_M))

    def _lost_legs(self, voxels: Voxels) -> Voxels:
        """Where legs can be below everybody who hangs in the air."""
        labels, n = connected_components(voxels, self.grid)
        legs = [lost_legs(voxels[labels == k], self.grid) for k in range(n)]
        return np.unique(np.concatenate([voxels[:0], *legs]))

    def _to_the_floor(self, voxels: Voxels, knee_m: float, reach_m: float) -> Voxels:
        """The voxels with legs and feet below what reaches below the knee."""
        side = self.grid.voxel_size_m
        full = self.grid.dense(voxels).astype(np.uint8)
        knee, foot, reach = (round(length / side) for length in (knee_m, _FOOT_M, reach_m))
        leg = cv2.dilate(full[:, :, :knee].any(axis=2).astype(np.uint8), np.ones((3, 3), np.uint8))
        full[:, :, :knee] |= leg[:, :, None]
        full[:, :, :foot] |= cv2.dilate(leg, _disc(reach))[:, :, None]
        return np.flatnonzero(full.ravel()).astype(np.int32)

    def _to_the_crown(self, voxels: Voxels) -> Voxels:
        """The voxels with room for a head on the highest place of each person."""
        side, full = self.grid.voxel_size_m, self.grid.dense(voxels).astype(np.uint8)
        n = full.shape[2]
        top = np.where(full.any(axis=2), n - full[:, :, ::-1].argmax(axis=2), 0).astype(np.float32)
        highest = cv2.dilate(top, _disc(round(_HEAD_REACH_M / side)))
        is_top = (top > _HEAD_OVER_M / side) & (top >= highest - _HEAD_SLACK_M / side)
        below = cv2.dilate(np.where(is_top, top, 0).astype(np.float32), _disc(round(_NECK_M / side)))[
            :, :, None
        ]
        z = np.arange(n)
        full |= ((below > 0) & (z >= below - 3) & (z < below + _HEAD_M / side)).view(np.uint8)
        return np.flatnonzero(full.ravel()).astype(np.int32)


def _wider(mask: Mask, px: int) -> Mask:
    """The mask with a rim of so many pixels around it."""
    return cv2.dilate(mask.astype(np.uint8), _disc(px)) > 0


def _inside(mask: Mask, px: int) -> Mask:
    """The mask without a rim of so many pixels."""
    return cv2.erode(mask.astype(np.uint8), _disc(px)) > 0


def _disc(radius: int) -> NDArray[np.uint8]:
    return cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * radius + 1, 2 * radius + 1))
