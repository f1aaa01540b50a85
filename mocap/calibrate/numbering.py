"""Which end of a checkerboard is which, and how the cameras stand to each other before anything is adjusted.

A detector numbers a checkerboard from either end. The numbering that all frames agree on is found by the relative pose
of every pair of cameras. Boards with numbers have one reading; the same search then only gives the relative poses.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import combinations

import cv2
import numpy as np

from mocap.arrays import Array
from mocap.calibrate.board import Board
from mocap.calibrate.bundle import inverse
from mocap.calibrate.detect import Sighting
from mocap.calibrate.lens import Lens, undistorted
from mocap.calibrate.views import BoardViews
from mocap.errors import MocapError
from mocap.io.checkerboard import numberings

_MIN_COMMON = 3  # frames that must agree on how two cameras stand to each other
_MAX_TURN_RAD = 0.15  # by which such frames may differ
_MAX_SHIFT = 0.08  # the same, as a share of the distance to the board
# (frame, camera) -> for each reading of the corners these, and the pose of the board, (4, 4).
_Options = Mapping[tuple[int, str], list[tuple[Sighting, Array]]]


def agree(
    views: BoardViews, lenses: Mapping[str, Lens]
) -> tuple[dict[int, dict[str, Sighting]], dict[str, Array]]:
    """Sightings of every frame numbered alike by all cameras; views that fit no numbering are left out.

    Also gives camera -> its pose in the frame of the first camera, (4, 4).  Raises MocapError for a camera that has too
    few views at the same time as the others.
    """
    options = {
        (frame, name): [
            (reading, board_pose(reading, lenses[name])) for reading in readings(views.board, sighting)
        ]
        for frame, seen in views.seen.items()
        for name, sighting in seen.items()
    }
    relative = _relative_poses(views, options)
    numbered = {
        frame: _numbered_alike([name for name in views.names if name in seen], frame, options, relative)
        for frame, seen in views.seen.items()
        if seen
    }
    return numbered, relative


def readings(board: Board, sighting: Sighting) -> list[Sighting]:
    """The ways to number what was seen."""
    if board.has_numbers:
        return [sighting]
    options = numberings(sighting.uv, (board.columns, board.rows))
    return [Sighting(sighting.points, uv) for uv in options]


def board_pose(sighting: Sighting, lens: Lens) -> Array:
    """Pose (4, 4) of what was seen, to the camera; places in a plane or not."""
    is_flat = np.ptp(sighting.points[:, 2]) < 1e-9
    flags = cv2.SOLVEPNP_IPPE if is_flat else cv2.SOLVEPNP_SQPNP
    uv = undistorted(lens, sighting.uv)
    _, rotation, translation = cv2.solvePnP(sighting.points, uv, lens.K, None, flags=flags)
    T = np.eye(4)
    T[:3, :3] = cv2.Rodrigues(rotation)[0]
    T[:3, 3] = translation.ravel()
    return T


def _numbered_alike(
    names: Sequence[str], frame: int, options: _Options, relative: Mapping[str, Array]
) -> dict[str, Sighting]:
    """Sightings of one frame by the numbering that fits the first camera best; views that fit none are left out."""
    first = names[0]
    sighting, T_first = options[frame, first][0]
    kept = {first: sighting}
    for name in names[1:]:
        T_first_name = inverse(relative[first]) @ relative[name]
        distance = float(np.linalg.norm(T_first[:3, 3]))
        fits = [_difference(T_first, T_first_name @ T, distance) for _, T in options[frame, name]]
        best = int(np.argmin([turn + shift for turn, shift in fits]))
        if fits[best][0] < 2 * _MAX_TURN_RAD and fits[best][1] < 2 * _MAX_SHIFT:
            kept[name] = options[frame, name][best][0]
    return kept


def _relative_poses(views: BoardViews, options: _Options) -> dict[str, Array]:
    """Camera -> its pose in the frame of the first camera, along the pairs that most frames agree on."""
    edges = _edges(views, options)
    placed = {views.names[0]: np.eye(4)}
    while len(placed) < len(views.names):
        reach = [(edge, n) for edge, (n, _) in edges.items() if edge[0] in placed and edge[1] not in placed]
        if not reach:
            lost = next(name for name in views.names if name not in placed)
            remedy = (
                "show the board to two cameras at once, moving and turning it; clips must be synchronised"
            )
            if mirrored := views.only_mirrored():
                remedy += (
                    f"; what {', '.join(mirrored)} saw is the mirror image of the board: unless it is printed on both "
                    "sides, the clip is mirrored (as for a selfie), and must be turned back"
                )
            raise MocapError(
                "the camera has too few views of the board at the same time as the others",
                camera=lost,
                remedy=remedy,
            )
        (a, b), _ = max(reach, key=lambda found: found[1])
        placed[b] = placed[a] @ edges[a, b][1]
    return placed


def _edges(views: BoardViews, options: _Options) -> dict[tuple[str, str], tuple[int, Array]]:
    """(a, b) -> how many frames agree on the pose of b in a's frame, and that pose."""
    edges: dict[tuple[str, str], tuple[int, Array]] = {}
    for a, b in combinations(views.names, 2):
        common = [frame for frame, seen in views.seen.items() if a in seen and b in seen]
        found = _pair([_candidate(options[frame, a], options[frame, b]) for frame in common])
        if found is not None:
            edges[a, b] = found
            edges[b, a] = found[0], inverse(found[1])
    return edges


def _candidate(
    of_a: Sequence[tuple[Sighting, Array]], of_b: Sequence[tuple[Sighting, Array]]
) -> tuple[float, list[Array]]:
    """Distance of camera a to the board, m, and the pose of b in a's frame for each reading of b."""
    T_a = of_a[0][1]
    return float(np.linalg.norm(T_a[:3, 3])), [T_a @ inverse(T) for _, T in of_b]


def _pair(candidates: Sequence[tuple[float, Sequence[Array]]]) -> tuple[int, Array] | None:
    """The relative pose that most frames agree on, and how many do; None if too few.

    candidates : of every frame the distance to the board, m, and the relative pose for each reading.
    """
    best: tuple[int, float, Array] | None = None
    for T in (T for _, own in candidates for T in own):
        n, spread = _agreement(T, candidates)
        if best is None or (n, -spread) > (best[0], -best[1]):
            best = n, spread, T
    if best is None or best[0] < _MIN_COMMON or best[0] <= len(candidates) / 2:
        return None
    return best[0], best[2]


def _agreement(T: Array, candidates: Sequence[tuple[float, Sequence[Array]]]) -> tuple[int, float]:
    """How many frames agree with a relative pose, and by how much these differ from it in all."""
    n, spread = 0, 0.0
    for distance, others in candidates:
        turn, shift = min((_difference(T, other, distance) for other in others), key=sum)
        if turn < _MAX_TURN_RAD and shift < _MAX_SHIFT:
            n, spread = n + 1, spread + turn + shift
    return n, spread


def _difference(A: Array, B: Array, distance: float) -> tuple[float, float]:
    """Angle between two poses, rad, and how far they are apart as a share of a distance."""
    cosine = (np.trace(A[:3, :3].T @ B[:3, :3]) - 1) / 2
    shift = np.linalg.norm(A[:3, 3] - B[:3, 3]) / distance
    return float(np.arccos(np.clip(cosine, -1, 1))), float(shift)
