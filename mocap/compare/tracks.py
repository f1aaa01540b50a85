"""Tracks of the two sides, and the comparison of tracks alone where a side has no poses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from mocap.compare.clock import shift_in_frames, shift_notes
from mocap.compare.detail import detailed_scores
from mocap.compare.options import CompareOptions
from mocap.compare.scores import evaluate
from mocap.compare.side import Side, frames_of_run
from mocap.data import LANDMARKS, Tracks
from mocap.errors import MocapError
from mocap.io.poses import Reading
from mocap.io.tables import read_tracks_csv

_TRUNK = ("pelvis", "neck", "left_hip", "right_hip", "left_shoulder", "right_shoulder")


def tracks_of(estimate: Side, truth: Side) -> tuple[Tracks | None, Tracks | None, str | None]:
    """Tracks of both sides; of tracks.csv where both have it, else the middle of the trunk, which a note says."""
    have_tables = estimate.tracks is not None and truth.tracks is not None
    are_ours = estimate.folder is not None and truth.folder is not None
    if have_tables or are_ours:
        return estimate.tracks, truth.tracks, None
    names = [n for n in _TRUNK if estimate.knows(n) and truth.knows(n)]
    if not names:
        return None, None, None
    note = f"tracks are the mean of {', '.join(names)}: one side has no tracks.csv"
    return _middle(estimate, names), _middle(truth, names), note


def _middle(side: Side, names: Sequence[str]) -> Tracks:
    columns = [LANDMARKS.index(n) for n in names]
    rows = []
    for m in side.motions:
        middle = m.landmarks[:, columns].mean(axis=1)
        for i in np.flatnonzero(np.isfinite(middle).all(axis=1)):
            rows.append((int(m.frames[i]), m.person, float(m.time_s[i]), *middle[i]))
    rows.sort()
    table = np.array(rows, dtype=np.float64).reshape(-1, 6)
    return Tracks(table[:, 0].astype(np.int64), table[:, 1].astype(np.int64), table[:, 2], table[:, 3:])


def lacks_poses(estimate: Path, truth: Path) -> bool:
    """Whether both are folders with tracks.csv and one of them has no landmarks.csv."""
    folders = [f for f in (_folder(estimate, is_truth=False), _folder(truth, is_truth=True)) if f is not None]
    return len(folders) == 2 and not all((f / "landmarks.csv").exists() for f in folders)


def _folder(path: Path, *, is_truth: bool) -> Path | None:
    """The folder with tracks.csv; of a session its truth. Poses without tracks are for the other comparison."""
    if not path.is_dir():
        return None
    own, below = path, path / "truth"
    for folder in (below, own) if is_truth else (own, below):
        if (folder / "landmarks.csv").exists() and not (folder / "tracks.csv").exists():
            return None
        if (folder / "tracks.csv").exists():
            return folder
    return None


def score_tracks(estimate: Path, truth: Path, options: CompareOptions) -> tuple[dict[str, Any], Side, Side]:
    """Scores of the tracks alone, with the keys of `compare`; what needs poses is None.

    Frames are those that the run worked on (run.json), or else all from the first to the last of either table.
    Raises MocapError when the two have no frame in common.
    """
    folder, true_folder = _folder(estimate, is_truth=False), _folder(truth, is_truth=True)
    if folder is None or true_folder is None:
        raise ValueError(f"estimate {estimate} and truth {truth} must be folders with tracks.csv")
    tracks, true_tracks = (read_tracks_csv(f / "tracks.csv") for f in (folder, true_folder))
    fps = _rate(true_tracks) or _rate(tracks)
    shift = shift_in_frames(options, fps, remedy="use --frame-offset")
    tracks = replace(tracks, frame=tracks.frame + shift)
    frames = _frames_to_score(folder, tracks, true_tracks, shift)
    scores = evaluate((), (), tracks, true_tracks, None, options.epsilon_mm, frames=frames)
    scores |= detailed_scores((), fps, options.epsilon_mm, actions=[], learn_share=options.learn_share)
    poor = "run" if not (folder / "landmarks.csv").exists() else "truth"
    notes = [f"only tracks are scored: the {poor} has no landmarks.csv", *shift_notes(shift)]
    if options.actions_path is not None or options.cameras_path is not None:
        notes.append("--actions and --cameras need poses and are left out")
    scores |= {"lost_limbs": None, "landmarks_left_out": [], "notes": notes, "warnings": []}
    scores["tracks_only"] = True
    return (
        scores,
        _side("estimate", estimate, folder, tracks),
        _side("truth", truth, true_folder, true_tracks),
    )


def _frames_to_score(folder: Path, tracks: Tracks, truth: Tracks, shift: int) -> list[int]:
    worked_on = frames_of_run(folder)
    every = np.concatenate([tracks.frame, truth.frame])
    if worked_on is not None:
        frames = [f + shift for f in worked_on]
    else:
        frames = list(range(int(every.min()), int(every.max()) + 1)) if len(every) else []
    if len(truth) and not np.isin(truth.frame, frames).any():
        raise MocapError(
            f"estimate and truth have no frame in common: the truth has {truth.frame.min()} to {truth.frame.max()}, "
            f"the run worked on {min(frames, default=0)} to {max(frames, default=0)}",
            remedy="shift the estimate with --frame-offset N",
        )
    return frames


def _side(name: str, path: Path, folder: Path, tracks: Tracks) -> Side:
    reading = Reading((), "tracks.csv", _rate(tracks), "m", "file", "z", "", (), ())
    return Side(name, path, reading, tracks, folder=folder)


def _rate(tracks: Tracks) -> float | None:
    """Frames per second by the two columns; None with fewer than two frames."""
    frames, first = np.unique(tracks.frame, return_index=True)
    if len(frames) < 2:
        return None
    seconds = float(tracks.time_s[first[-1]] - tracks.time_s[first[0]])
    return float(frames[-1] - frames[0]) / seconds if seconds > 0 else None
