"""`mocap eval` where a side has tracks and no poses: who was where, and nothing else."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from mocap.data import Tracks
from mocap.errors import MocapError
from mocap.io.poses import Reading
from mocap.io.tables import read_tracks_csv
from mocap.metrics import detailed_scores, evaluate
from mocap.pipeline.scoring import frames_of_run

if TYPE_CHECKING:
    from mocap.pipeline.comparison import CompareOptions, Side


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
    from mocap.pipeline.comparison import Side

    folder, true_folder = _folder(estimate, is_truth=False), _folder(truth, is_truth=True)
    if folder is None or true_folder is None:
        raise ValueError(f"estimate {estimate} and truth {truth} must be folders with tracks.csv")
    found, goal = (read_tracks_csv(f / "tracks.csv") for f in (folder, true_folder))
    fps = _rate(goal) or _rate(found)
    shift = options.frame_offset
    if options.time_offset_s:
        if fps is None:
            raise MocapError(
                "a time offset needs a frame rate, and neither tracks.csv tells one",
                remedy="use --frame-offset",
            )
        shift += round(options.time_offset_s * fps)
    found = replace(found, frame=found.frame + shift)
    worked_on = frames_of_run(folder)
    every = np.concatenate([found.frame, goal.frame])
    if worked_on is not None:
        frames = [f + shift for f in worked_on]
    else:
        frames = list(range(int(every.min()), int(every.max()) + 1)) if len(every) else []
    if len(goal) and not np.isin(goal.frame, frames).any():
        raise MocapError(
            f"estimate and truth have no frame in common: the truth has {goal.frame.min()} to {goal.frame.max()}, "
            f"the run worked on {min(frames, default=0)} to {max(frames, default=0)}",
            remedy="shift the estimate with --frame-offset N",
        )
    poor = "run" if not (folder / "landmarks.csv").exists() else "truth"
    notes = [f"only tracks are scored: the {poor} has no landmarks.csv"]
    if shift:
        notes.append(f"{shift:+d} frames added to the estimate's frame numbers")
    if options.actions_path is not None or options.cameras_path is not None:
        notes.append("--actions and --cameras need poses and are left out")
    scores = evaluate((), (), found, goal, None, options.epsilon_mm, frames=frames)
    scores |= detailed_scores((), fps, options.epsilon_mm, actions=[], learn_share=options.learn_share)
    scores |= {"lost_limbs": None, "landmarks_left_out": [], "notes": notes, "warnings": []}
    scores["tracks_only"] = True
    sides = []
    for name, path, where, tracks in (
        ("estimate", estimate, folder, found),
        ("truth", truth, true_folder, goal),
    ):
        reading = Reading((), "tracks.csv", _rate(tracks), "m", "file", "z", "", (), ())
        sides.append(Side(name, path, reading, tracks, folder=where))
    return scores, sides[0], sides[1]


def _rate(tracks: Tracks) -> float | None:
    """Frames per second by the two columns; None with fewer than two frames."""
    frames, first = np.unique(tracks.frame, return_index=True)
    if len(frames) < 2:
        return None
    seconds = float(tracks.time_s[first[-1]] - tracks.time_s[first[0]])
    return float(frames[-1] - frames[0]) / seconds if seconds > 0 else None
