"""Scores that need the hulls of a run: overlap with the true volume, and whether lost limbs are known to be lost."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mocap.compare.match import associate_persons
from mocap.data import LANDMARKS, Motion, VoxelGrid
from mocap.errors import MocapError
from mocap.io.store import StageStore
from mocap.io.truth import read_true_voxels
from mocap.metrics import (
    LimbScores,
    limb_scores,
    share_in_hull,
    sum_volume_scores,
    volume_scores,
)
from mocap.metrics.volume import VolumeScores
from mocap.products.hulls import stored_grid

Array = NDArray[np.float64]

# Ends of a limb -> the landmark that tells whether the filter saw it: the one at the joint that moves it, or beyond.
LIMBS: dict[tuple[str, str], str] = {
    (f"{side}_{start}", f"{side}_{end}"): f"{side}_{judge}"
    for side in ("left", "right")
    for start, end, judge in (
        ("shoulder", "elbow", "shoulder"),
        ("elbow", "wrist", "wrist"),
        ("hip", "knee", "hip"),
        ("knee", "ankle", "ankle"),
    )
}
_CHAINS = [[LANDMARKS.index(n) for n in ends] for ends in LIMBS]
_JUDGES = [LANDMARKS.index(n) for n in LIMBS.values()]
_LOST, _PRESENT = 0.3, 0.7  # share of the true bone in the hull

# (true landmarks (15, 3) m, whether the estimate says that it observed each (15,))
_Judged = tuple[Array, NDArray[np.bool_]]


def volume_overlap(truth_dir: Path, store: StageStore) -> VolumeScores | None:
    """Overlap of the hulls in the store with truth/voxels.npz, summed over frames; None without them.

    The true voxels are moved onto the hull's grid by their centres; both grids should have the same voxel size.
    """
    path = truth_dir / "voxels.npz"
    if not path.exists():
        return None
    try:
        reader = store.reader("carve")
    except MocapError:
        return None  # a folder of results without its store: everything but the volume is scored
    grid = stored_grid(store)
    truth = read_true_voxels(path)
    if abs(truth.grid.voxel_size_m - grid.voxel_size_m) > 1e-9:
        return None
    scores = []
    for frame, arrays in reader.rows("voxels"):
        if frame >= len(truth):
            break
        on_grid = grid.voxels_of(truth.grid.centers(truth.at(frame)))
        scores.append(volume_scores(arrays["voxels"].astype(np.int64), on_grid[on_grid >= 0]))
    return sum_volume_scores(scores) if scores else None


def lost_limbs(
    estimate: Sequence[Motion],
    truth: Sequence[Motion],
    store: StageStore,
    *,
    frames: Sequence[int] | None = None,
) -> LimbScores | None:
    """How well `observed` tells limbs without data from limbs with data; None without hulls or such statements.

    A limb is lost in truth when less than 30 % of its true bone lies in the hull of its frame, and present above 70 %;
    what is between is not judged. It is said to be lost when its landmark is not observed.
    """
    if not any(m.observed is not None for m in estimate):
        return None
    try:
        reader = store.reader("carve")
    except MocapError:
        return None
    grid = stored_grid(store)
    judged = _judged_by_frame(estimate, truth, frames)
    rows = [
        (_shares_in_hull(landmarks, arrays["voxels"], grid), ~observed[_JUDGES])
        for frame, arrays in reader.rows("voxels")
        for landmarks, observed in judged.get(frame, ())
    ]
    if not rows:
        return None
    share = np.array([shares for shares, _ in rows])
    said = np.array([said for _, said in rows])
    return limb_scores(share < _LOST, said, (share < _LOST) | (share > _PRESENT))


def _shares_in_hull(landmarks: Array, voxels: NDArray[np.integer], grid: VoxelGrid) -> list[float]:
    return [share_in_hull(landmarks[chain], voxels, grid) for chain in _CHAINS]


def _judged_by_frame(
    estimate: Sequence[Motion], truth: Sequence[Motion], frames: Sequence[int] | None
) -> dict[int, list[_Judged]]:
    """Scored frame -> what is judged in it, person by person."""
    scored = None if frames is None else set(frames)
    judged: dict[int, list[_Judged]] = {}
    for e, t in associate_persons(estimate, truth, frames=frames):
        if e is None or e.observed is None:
            continue
        common, of_estimate, of_truth = np.intersect1d(e.frames, t.frames, return_indices=True)
        for frame, i, j in zip(common, of_estimate, of_truth, strict=True):
            if scored is None or int(frame) in scored:
                judged.setdefault(int(frame), []).append((t.landmarks[j], e.observed[i]))
    return judged
