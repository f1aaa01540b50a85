"""One side of a comparison: a run, a session's truth or a file of another tool, read into metres and z up."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mocap.compare.units import length_unit
from mocap.data import ALL_LANDMARKS, FURTHER_LANDMARKS, LANDMARKS, Motion, Tracks
from mocap.errors import MocapError
from mocap.files import load_json
from mocap.io.formats import PoseFile, read_poses
from mocap.io.formats.csv import read_csv
from mocap.io.formats.panoptic import panoptic_folder
from mocap.io.poses import Reading, SideMap, read_motions
from mocap.io.tables import FEET_AND_HANDS, read_feet_and_hands_csv, read_tracks_csv

# A day and a half at 1000 frames per second: what goes beyond is no record of a run.
_MOST_FRAMES = 10**8


@dataclass(frozen=True, eq=False)
class Side:
    """One side, in metres and z up.

    frames : frames that were worked on, None = those with a pose.  folder : of a run, or of a session's truth.
    """

    name: str
    path: Path
    reading: Reading
    tracks: Tracks | None = None
    frames: tuple[int, ...] | None = None
    folder: Path | None = None

    @property
    def motions(self) -> tuple[Motion, ...]:
        return self.reading.motions

    @property
    def pose_frames(self) -> NDArray[np.int64]:
        """Frames in which somebody has a pose, ascending."""
        if not self.motions:
            return np.zeros(0, dtype=np.int64)
        return np.unique(np.concatenate([m.frames for m in self.motions]))

    def knows(self, landmark: str) -> bool:
        """Whether the landmark is known of anybody in any frame."""
        m = LANDMARKS.index(landmark)
        return any(bool(np.isfinite(motion.landmarks[:, m]).any()) for motion in self.motions)

    @property
    def known_landmarks(self) -> set[str]:
        """Landmarks of the file that are known at all."""
        return {n for n in self.reading.landmarks if self.knows(n)}

    def with_motions(self, motions: Sequence[Motion]) -> Side:
        """The same side with other motions."""
        return replace(self, reading=replace(self.reading, motions=tuple(motions)))


def read_truth(path: Path, options: SideMap) -> Side:
    """The truth: a session with truth/, a folder of ours, or a file. Raises MocapError for a session without truth."""
    if path.is_dir():
        for folder in (path / "truth", path):
            if (folder / "landmarks.csv").exists():
                return _own_folder("truth", path, folder, options)
        if panoptic_folder(path) is None:
            raise MocapError(
                "the session has no truth to compare with",
                path=path / "truth" / "landmarks.csv",
                remedy="evaluate only sessions with truth/landmarks.csv (and tracks.csv), as `mocap synth` writes "
                "them, or give a file of poses as the truth",
            )
    return Side("truth", path, read_motions(read_poses(path), options))


def read_estimate(path: Path, options: SideMap) -> Side:
    """The estimate: the output folder of a run, or a file. Raises MocapError for a folder without results."""
    if path.is_dir() or not path.suffix:
        for folder in (path, path / "truth"):
            if (folder / "landmarks.csv").exists():
                side = _own_folder("estimate", path, folder, options)
                return replace(side, frames=frames_of_run(folder))
        if not path.is_dir() or panoptic_folder(path) is None:
            raise MocapError(
                "the folder holds no result of a run",
                path=path / "landmarks.csv",
                remedy="run `mocap run SESSION -o OUT` first, or give a file of poses as the estimate",
            )
    return Side("estimate", path, read_motions(read_poses(path), options))


def _own_folder(name: str, path: Path, folder: Path, options: SideMap) -> Side:
    tracks = folder / "tracks.csv"
    poses: PoseFile = read_csv(folder / "landmarks.csv")
    if (folder / FEET_AND_HANDS).exists():
        poses = with_feet_and_hands(poses, folder / FEET_AND_HANDS)
    return Side(
        name,
        path,
        read_motions(poses, options),
        read_tracks_csv(tracks) if tracks.exists() else None,
        folder=folder,
    )


def with_feet_and_hands(poses: PoseFile, path: Path) -> PoseFile:
    """The persons of a truth with their landmarks of feet and hands, which stand in a table of their own."""
    more = {own.person: own for own in read_feet_and_hands_csv(path)}
    people = []
    for table in poses.people:
        own = more.get(table.person)
        if own is not None and table.names == LANDMARKS:
            xyz = np.full((len(table.frames), len(FURTHER_LANDMARKS), 3), np.nan)
            _, here, there = np.intersect1d(table.frames, own.frames, return_indices=True)
            xyz[here] = own.xyz[there]
            xyz = np.concatenate([table.xyz, xyz], axis=1)
            table = replace(table, names=ALL_LANDMARKS, xyz=xyz, std=None, observed=None)
        people.append(table)
    return replace(poses, people=tuple(people))


def frames_of_run(out: Path) -> tuple[int, ...] | None:
    """Frames that a run worked on, by its run.json; None for landmarks.csv from elsewhere."""
    try:
        start, stop = (int(n) for n in load_json(out / "run.json")["frames"])
    except (MocapError, ValueError, KeyError, TypeError, OverflowError):
        return None
    return tuple(range(start, stop)) if stop - start <= _MOST_FRAMES else None


def in_metres(side: Side) -> tuple[Side, str | None, str | None]:
    """The side in metres, a note when its unit was guessed, a warning when a body of its size does not exist."""
    reading = side.reading
    sizes = {length_unit(m.landmarks) for m in reading.motions} - {"unknown"}
    looks = sizes.pop() if len(sizes) == 1 else "unknown"
    unit = reading.unit
    note = warning = None
    if unit is None:
        unit = "m" if looks == "unknown" else looks
        how = "by the size of the body" if looks != "unknown" else "for want of a better guess"
        note = f"{side.name}: taken as {unit} {how}; the file does not say (--{side.name}-unit)"
    elif looks not in ("unknown", unit):
        who = "the file says" if reading.unit_from == "file" else "you say"
        warning = (
            f"unit mistake: the {side.name} looks like {looks} read as {unit}; a body of that size does not exist "
            f"({who} {unit}). Remedy: --{side.name}-unit {looks}"
        )
    return replace(side, reading=reading.in_metres(unit)), note, warning


def common_landmarks(estimate: Side, truth: Side) -> tuple[Side, Side, list[str]]:
    """Both sides with the landmarks that both know at all; the others, the third value, are unknown, not missed.

    Raises MocapError when they have no landmark in common.
    """
    known, true_known = estimate.known_landmarks, truth.known_landmarks
    if not estimate.motions or not truth.motions:
        return estimate, truth, []
    common = known & true_known
    if not common:
        raise MocapError(
            f"estimate and truth have no landmark in common: {', '.join(sorted(known)) or 'none'} against "
            f"{', '.join(sorted(true_known)) or 'none'}",
            remedy="say with --map FILE which points are which landmarks",
        )
    left_out = [n for n in LANDMARKS if n not in common]
    columns = [LANDMARKS.index(n) for n in left_out]
    return _without(estimate, columns), _without(truth, columns), left_out


def _without(side: Side, columns: Sequence[int]) -> Side:
    if not columns:
        return side
    motions = []
    for m in side.motions:
        landmarks = m.landmarks.copy()
        landmarks[:, columns] = np.nan
        motions.append(replace(m, landmarks=landmarks))
    return side.with_motions(motions)


def description(side: Side) -> dict[str, Any]:
    """How a side was read, ready for JSON: the object under `estimate` and `truth` of the scores."""
    reading = side.reading
    frames, n_persons = side.pose_frames, len(side.motions)
    if not side.motions and side.tracks is not None:
        frames, n_persons = np.unique(side.tracks.frame), len(side.tracks.persons)
    return {
        "path": str(side.path),
        "format": reading.format,
        "unit": reading.unit,
        "up": reading.up,
        "fps": None if reading.fps is None else round(reading.fps, 3),
        "skeleton": reading.skeleton,
        "landmarks": list(reading.landmarks),
        "persons": n_persons,
        "frames": len(frames),
        "first_frame": int(frames[0]) if len(frames) else None,
        "last_frame": int(frames[-1]) if len(frames) else None,
    }
