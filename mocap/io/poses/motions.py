"""Named points of a file as motions of our landmarks, z up."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mocap.data import ALL_LANDMARKS, LANDMARKS, Motion
from mocap.errors import MocapError
from mocap.io.formats.table import PoseFile, PoseTable
from mocap.io.poses.maps import SideMap, automatic, plain, skeletons_known
from mocap.io.units import METRES_PER_UNIT

Array = NDArray[np.float64]

# Up axis of a file -> rows of the rotation to our z-up world. y up is the inverse of what our writers do.
_WORLD_FROM = {
    "z": [[1, 0, 0], [0, 1, 0], [0, 0, 1]],
    "-z": [[1, 0, 0], [0, -1, 0], [0, 0, -1]],
    "y": [[0, 0, 1], [1, 0, 0], [0, 1, 0]],
    "-y": [[0, 0, 1], [-1, 0, 0], [0, -1, 0]],
    "x": [[0, 1, 0], [0, 0, 1], [1, 0, 0]],
    "-x": [[0, 1, 0], [0, 0, -1], [-1, 0, 0]],
}


# Nobody is recorded over more than a thousand kilometres.
MOST_M = 1e6


@dataclass(frozen=True, eq=False)
class Reading:
    """Motions of a file, still in its unit.

    motions : one per person, z up, in `unit` (None = nobody has said which).  unit_from : "file" or "user".
    landmarks : the ones that the file has.  skeleton : how its names were understood.
    """

    motions: tuple[Motion, ...]
    format: str
    fps: float | None
    unit: str | None
    unit_from: str
    up: str
    skeleton: str
    landmarks: tuple[str, ...]
    notes: tuple[str, ...]

    def in_metres(self, unit: str) -> Reading:
        """The same with lengths in metres, understood as `unit`; MocapError for places that no recording reaches."""
        factor = METRES_PER_UNIT[unit]
        far = max((float(np.nanmax(np.abs(m.landmarks), initial=0.0)) for m in self.motions), default=0.0)
        if far * factor > MOST_M:
            raise MocapError(
                f"a landmark lies at {far:.3g} {unit}; no recording reaches that far",
                remedy="say the unit of the file, or export it again",
            )
        if factor == 1.0:
            return replace(self, unit=unit)
        motions = tuple(
            replace(m, landmarks=factor * m.landmarks, std=None if m.std is None else factor * m.std)
            for m in self.motions
        )
        return replace(self, motions=motions, unit=unit)


def read_motions(poses: PoseFile, side: SideMap | None = None) -> Reading:
    """The motions in a file of poses; what `side` says counts more than what the file says.

    Raises MocapError when no skeleton is recognised, a named point is not in the file, or a person is there twice.
    """
    side = SideMap() if side is None else side
    sources, skeleton, notes = _sources(poses, side)
    up = side.up or poses.up
    R = np.array(_WORLD_FROM[up], dtype=np.float64)
    if side.up is None and poses.world_from_file is not None:
        R = poses.world_from_file
    fps = side.fps or poses.fps
    people = filter(lambda table: len(table.frames), poses.people)
    return Reading(
        motions=tuple(_motion(table, sources, R, side.fps, fps) for table in people),
        format=poses.format,
        fps=fps,
        unit=side.unit or poses.unit,
        unit_from="user" if side.unit else "file",
        up=up,
        skeleton=skeleton,
        landmarks=tuple(n for n in LANDMARKS if n in sources),
        notes=(*poses.notes, *notes),
    )


def _sources(poses: PoseFile, side: SideMap) -> tuple[dict[str, tuple[str, ...]], str, list[str]]:
    """Landmark -> names of points, how the skeleton is called, and what is to be known of it."""
    if side.landmarks:
        return _named(poses, side), "as the map says", []
    names = poses.people[0].names if poses.people else LANDMARKS
    found = automatic(names)
    if found is None:
        raise MocapError(
            f"the names of the points are of no known skeleton: {_some(names)}",
            path=poses.path,
            remedy=f"say which are our landmarks with --map FILE; known are {', '.join(skeletons_known())}",
        )
    skeleton, sources = found
    return sources, skeleton.name, [f"{skeleton.name}: {skeleton.note}"] if skeleton.note else []


def _named(poses: PoseFile, side: SideMap) -> dict[str, tuple[str, ...]]:
    names = poses.people[0].names if poses.people else LANDMARKS
    at = {plain(n): n for n in names}
    sources = {}
    for landmark, wanted in side.landmarks.items():
        missing = [n for n in wanted if plain(n) not in at]
        if missing:
            raise MocapError(
                f"the map takes {landmark} from {missing[0]!r}, which the file does not have; it has "
                f"{_some(names)}",
                path=poses.path,
                remedy="correct the names in the map",
            )
        sources[landmark] = tuple(at[plain(n)] for n in wanted)
    return sources


def _motion(
    table: PoseTable,
    sources: dict[str, tuple[str, ...]],
    R: Array,
    fps_of_user: float | None,
    fps: float | None,
) -> Motion:
    T = len(table.frames)
    names = LANDMARKS if set(sources) <= set(LANDMARKS) else ALL_LANDMARKS
    landmarks = np.full((T, len(names), 3), np.nan)
    xyz = np.where(np.isfinite(table.xyz), table.xyz, np.nan)
    columns_of = {names.index(k): [table.names.index(n) for n in found] for k, found in sources.items()}
    for m, columns in columns_of.items():
        # A mean of what is left would jump when one of the points is lost: NaN carries through.
        landmarks[:, m] = xyz[:, columns].mean(axis=1) @ R.T
    std = None if table.std is None else _std_of(table.std, columns_of, R, len(names))
    observed = None if table.observed is None else _all_observed(table.observed, columns_of, len(names))
    time_s = table.time_s
    if fps_of_user is not None or not np.isfinite(time_s).all():
        time_s = table.frames / fps if fps else np.full(T, np.nan)
    return Motion(table.person, table.frames, time_s, landmarks, std, observed)


def _std_of(std: Array, columns_of: dict[int, list[int]], R: Array, n_landmarks: int) -> Array:
    """Deviations (T, M, 3) of the landmarks that are one point; those of a mean are not known: NaN."""
    out = np.full((len(std), n_landmarks, 3), np.nan)
    for m, columns in columns_of.items():
        if len(columns) == 1:
            out[:, m] = std[:, columns[0]] @ np.abs(R).T
    return out


def _all_observed(
    observed: NDArray[np.bool_], columns_of: dict[int, list[int]], n_landmarks: int
) -> NDArray[np.bool_]:
    """Whether all points of a landmark were seen, (T, M)."""
    out = np.zeros((len(observed), n_landmarks), dtype=np.bool_)
    for m, columns in columns_of.items():
        out[:, m] = observed[:, columns].all(axis=1)
    return out


def _some(names: tuple[str, ...]) -> str:
    return ", ".join(names[:20]) + (" ..." if len(names) > 20 else "")
