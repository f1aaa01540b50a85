"""Things that were tracked as persons: a box or a chair where the empty scene had nothing.

A volume does not say what it is of, and people keep still as well. But nobody keeps as still as a thing, no pose of a
body explains one, and a thing has no head.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mocap.pose.method import ThingSettings

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Look:
    """What was tracked as a person, in one frame.

    centers : (N, 3) m, of its voxels.  surface : (M,) numbers of those of them that are on its surface and have
    colours.  rgb : (M, 3) grey levels, theirs.
    """

    centers: Array
    surface: NDArray[np.int32]
    rgb: NDArray[np.uint8]


def is_like_nobody(xyz: Array, misfit: Array, numbers: ThingSettings) -> bool:
    """Whether somebody who was followed stays in one place all the time, and has no pose that explains his volumes.

    xyz : (T, 3) m, his track.  misfit : (F,) nats, of all parts together, in the frames in which he was seen.
    """
    if not len(misfit):
        return False
    away_m = np.linalg.norm(xyz[:, :2] - np.median(xyz[:, :2], axis=0), axis=1)
    stays = np.quantile(away_m, numbers.stays_share) < numbers.stays_m
    return bool(stays and np.median(misfit) > numbers.misfit_nats)


def colour_change(looks: Sequence[Look], seen_share: float) -> float | None:
    """How much the colours of a surface change over several looks, grey levels; None where none of it stays.

    Of every voxel that is on the surface in `seen_share` of the looks the median distance from its usual colour, in the
    mean over channels and voxels: who passes before a thing hides it in some of the looks only.
    """
    n = len(looks)
    if n == 0:
        return None
    voxels, at = np.unique(np.concatenate([look.surface for look in looks]), return_inverse=True)
    colours = np.full((len(voxels), n, 3), np.nan, dtype=np.float32)
    when = np.repeat(np.arange(n), [len(look.surface) for look in looks])
    colours[at.reshape(-1), when] = np.concatenate([look.rgb for look in looks])
    lasting = colours[np.isfinite(colours[:, :, 0]).sum(axis=1) >= max(2.0, seen_share * n)]
    if not len(lasting):
        return None
    off = np.abs(lasting - np.nanmedian(lasting, axis=1, keepdims=True)).mean(axis=2)
    return float(np.nanmedian(off, axis=1).mean())


def has_head(centers: Array, voxel_size_m: float, numbers: ThingSettings) -> bool:
    """Whether the top of a volume is as narrow as a head, and as high as that of somebody who sits.

    centers : (N, 3) m, of its voxels.
    """
    if not len(centers):
        return False
    z = centers[:, 2]
    top_m = z.max() + voxel_size_m / 2
    under = (np.abs(z - (top_m - depth_m)) < numbers.head_slab_m / 2 for depth_m in numbers.head_depths_m)
    section_m2 = max(int(slab.sum()) for slab in under) * voxel_size_m**3 / numbers.head_slab_m
    return bool(top_m > numbers.head_top_m and section_m2 < numbers.head_m2)


def is_thing(looks: Sequence[Look], voxel_size_m: float, numbers: ThingSettings) -> bool:
    """Whether what keeps still has no head, and keeps its colours as nobody does who breathes and looks about."""
    n_heads = sum(has_head(look.centers, voxel_size_m, numbers) for look in looks)
    change = colour_change(looks, numbers.seen_share)
    return 2 * n_heads < len(looks) and change is not None and change < numbers.colour_levels


@dataclass(frozen=True, eq=False)
class _Moment:
    """As in `ThingWatch.see`.  look : None between looks."""

    time_s: float
    xyz: Array
    misfit: float | None
    look: Look | None


class ThingWatch:
    """Somebody who is seen without end: a thing from when all of the last `watched_s` seconds say so.

    Then no pose is looked for in it any more, and it stays a thing until it stands elsewhere for half of that time.
    """

    def __init__(self, voxel_size_m: float, numbers: ThingSettings) -> None:
        self._voxel_size_m, self._numbers = voxel_size_m, numbers
        self._moments: deque[_Moment] = deque()
        self._looked_s = -np.inf
        self._place: Array | None = None

    @property
    def is_thing(self) -> bool:
        return self._place is not None

    def see(self, time_s: float, xyz: Array, misfit: float | None, look: Callable[[], Look]) -> None:
        """What is seen of it now.  xyz : (3,) m, its track.  misfit : nats, of all parts; None = there is no pose.

        look : looks at it; asked now and then.
        """
        numbers, moments = self._numbers, self._moments
        is_due = not self.is_thing and time_s - self._looked_s >= numbers.watched_s / numbers.n_looks
        moments.append(_Moment(time_s, xyz, misfit, look() if is_due else None))
        while time_s - moments[0].time_s > numbers.watched_s:
            moments.popleft()
        if self._place is not None:
            if np.median(np.linalg.norm(self._track()[:, :2] - self._place, axis=1)) > numbers.stays_m:
                self._place = None
                moments.clear()
        elif is_due:
            self._looked_s = time_s
            if self._seems_thing():
                self._place = np.median(self._track()[:, :2], axis=0)

    def _track(self) -> Array:
        return np.array([moment.xyz for moment in self._moments])

    def _seems_thing(self) -> bool:
        numbers, moments = self._numbers, self._moments
        looks = [moment.look for moment in moments if moment.look is not None]
        misfit = np.array([moment.misfit for moment in moments if moment.misfit is not None])
        is_long = moments[-1].time_s - moments[0].time_s > 0.9 * numbers.watched_s
        is_known = 2 * len(looks) >= numbers.n_looks and 2 * len(misfit) >= len(moments)
        return (
            is_long
            and is_known
            and is_like_nobody(self._track(), misfit, numbers)
            and is_thing(looks, self._voxel_size_m, numbers)
        )
