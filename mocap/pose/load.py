"""What goes with a person's trunk, a rucksack, a wide skirt or a box before it: what hulls hold there beside all flesh.

A limb that is looked for there finds it better explained than the air in which the limb is. So it becomes flesh of the
trunk while the person is followed again.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation, distance_transform_edt, label

from mocap.body import Body, cones_of, joint_transforms, landmarks_of
from mocap.body.flesh import lattice_in_cones
from mocap.body.model import Cones
from mocap.pose.limbs import arms_of, moved_to
from mocap.pose.method import LoadSettings
from mocap.pose.volume import VolumeObservation

Array = NDArray[np.float64]
Cells = NDArray[np.bool_]


def find_load(
    observation: VolumeObservation, frames: NDArray[np.int64], states: Array, numbers: LoadSettings
) -> Cones | None:
    """Flesh for what a person wears or holds: balls in the frame of the upper trunk, of the root's part.

    frames : (T,).  states : (T, D), the poses in which the person was followed, with some limbs lost in the load
    perhaps. None when there is nothing worth it, or when the person moves too little to tell.
    """
    body, grid = observation.tools.body, observation.tools.grid
    rows = np.unique(np.linspace(0, len(frames) - 1, numbers.n_frames).astype(int))
    joint, is_trunk = upper_trunk(body), body.cones.part == 0
    R, t = (transforms[:, joint] for transforms in joint_transforms(body, states[rows]))
    if not _moves(t[:, :2], R[:, :2, 0], numbers):
        return None
    half = round(numbers.reach_m / numbers.cell_m)
    axis = (np.arange(2 * half) - half + 0.5) * numbers.cell_m
    cells = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1)
    least_m = (numbers.beyond_m, numbers.deep * body.height_m)
    judged = np.repeat([numbers.judged_share, numbers.judged_before], half)[:, None, None]
    beside, far = votes = [_Votes(cells.shape[:3], judged, numbers) for _ in least_m]
    for i, row in enumerate(rows):
        hull = observation.hull_of(int(frames[row]))
        if hull is None or not len(hull.voxels):
            continue
        places = cells.reshape(-1, 3) @ R[i].T + t[i]
        is_filled = hull.holds(grid.voxels_of(places)).reshape(cells.shape[:3])
        start, end = ((ends - t[i]) @ R[i] for ends in cones_of(body, states[row]))
        for vote, off_m in zip(votes, least_m, strict=True):
            grown = body.cones.radii + off_m
            near, _ = lattice_in_cones(
                cells[0, 0, 0], numbers.cell_m, cells.shape[:3], start, end, grown, body.round_ends
            )
            is_left = is_filled & ~near[is_trunk].any(axis=0)
            is_limb = near[~is_trunk].any(axis=0)
            is_limb[half:] |= is_limb[half:, ::-1]  # before the trunk both arms may hold what one holds
            vote.add(is_left & ~is_limb, is_left & is_limb)
    core = _largest(far.is_won)
    if core.sum() * numbers.cell_m**3 < numbers.least * body.height_m**3:
        return None
    rim = binary_dilation(core, iterations=round(np.ptp(least_m) / numbers.cell_m) + 1)
    centers, radii = _balls(beside.is_won & rim, cells.reshape(-1, 3), numbers)
    if not len(radii):
        return None
    place = np.full(len(radii), joint, dtype=np.int64)
    half_axis = np.array([0.0, 0.0, 0.5 * numbers.cell_m])  # a cone has a direction
    return Cones(centers - half_axis, centers + half_axis, np.stack([radii, radii], axis=1), place, 0 * place)


def laden(body: Body, load: Cones) -> Body:
    """The body with what its owner wears."""
    own = body.cones
    cones = Cones(
        start=np.concatenate([own.start, load.start]),
        end=np.concatenate([own.end, load.end]),
        radii=np.concatenate([own.radii, load.radii]),
        joint=np.concatenate([own.joint, load.joint]),
        part=np.concatenate([own.part, load.part]),
    )
    return replace(body, cones=cones)


def bare(body: Body, load: Cones) -> Body:
    """A laden body without what its owner wears."""
    own = slice(len(body.cones.joint) - len(load.joint))
    start, end, radii = (a[own] for a in (body.cones.start, body.cones.end, body.cones.radii))
    return replace(body, cones=Cones(start, end, radii, body.cones.joint[own], body.cones.part[own]))


def arms_alike(body: Body, state: Array) -> list[Array]:
    """Two states (D,), in which one arm, and the other, is where its fellow would be on its side; none for a body that
    has not two arms."""
    arms = arms_of(body)
    if arms is None:
        return []
    R, t = (transforms[0, upper_trunk(body)] for transforms in joint_transforms(body, state[None]))
    places = (landmarks_of(body, state[None])[0] - t) @ R * (1.0, -1.0, 1.0) @ R.T + t  # mirrored
    return [
        moved_to(body, state, arm.landmarks, places[fellow.landmarks], arm.columns)
        for arm, fellow in (arms, arms[::-1])
    ]


def upper_trunk(body: Body) -> int:
    """The joint that bears the upper trunk: the nearest under the head's that carries flesh of the root's part."""
    j = int(body.landmark_joint[body.landmarks.index("head")])
    while j > 0 and not np.any((body.cones.joint == j) & (body.cones.part == 0)):
        j = int(body.parent[j])
    return j


class _Votes:
    """In how many frames cells around the trunk hold something that is no flesh.

    Where a limb explains what is there, it says nothing: it may be lost there.  judged : the least share of the
    frames that must say something of a cell; broadcasts to the cells.
    """

    def __init__(self, shape: tuple[int, ...], judged: Array, numbers: LoadSettings) -> None:
        self._numbers, self._judged = numbers, judged
        self._n_frames = 0
        self._n_filled, self._n_limbs = np.zeros((2, *shape), dtype=np.int64)

    def add(self, is_filled: Cells, is_limb: Cells) -> None:
        """Take in a frame: cells that are filled beside all flesh, and cells that limbs explain."""
        self._n_frames += 1
        self._n_filled += is_filled
        self._n_limbs += is_limb

    @property
    def is_won(self) -> Cells:
        """Cells that are filled in most of the frames that say something of them, where enough do."""
        n_judged = self._n_frames - self._n_limbs
        is_known = n_judged >= self._judged * self._n_frames
        return is_known & (self._n_filled > self._numbers.share * n_judged)


def _moves(places: Array, fronts: Array, numbers: LoadSettings) -> bool:
    """Whether a trunk walks or turns enough.

    places : (N, 2) m, and fronts : (N, 2) directions to the front, both seen from above.
    """
    turned_rad = np.ptp(np.unwrap(np.arctan2(fronts[:, 1], fronts[:, 0])))
    walked_m = np.linalg.norm(np.ptp(places, axis=0))
    return bool(walked_m > numbers.walked_m or turned_rad > numbers.turned_rad)


def _largest(cells: Cells) -> Cells:
    """The largest connected piece."""
    labels, n = label(cells)
    if not n:
        return cells
    return np.asarray(labels == 1 + np.bincount(labels.ravel())[1:].argmax())


def _balls(filled: Cells, centers: Array, numbers: LoadSettings) -> tuple[Array, Array]:
    """Balls that fill cells: centres (K, 3) m in the trunk's frame, and radii (K,) m; the largest first.

    centers : (N, 3) m, of all cells.
    """
    radii = np.asarray(distance_transform_edt(filled), dtype=np.float64).ravel() * numbers.cell_m
    left, balls = radii.copy(), list[int]()
    for _ in range(numbers.n_balls):
        k = int(left.argmax())
        if left[k] < numbers.least_radius_m:
            break
        balls.append(k)
        left[np.linalg.norm(centers - centers[k], axis=1) <= radii[k]] = 0.0
    return centers[balls], radii[balls]
