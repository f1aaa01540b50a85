"""Scores of a run against the truth of its session, as run.json and the report hold them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from mocap.compare.hulls import volume_overlap
from mocap.compare.scores import evaluate
from mocap.data import Motion, Tracks
from mocap.io.store import StageStore
from mocap.io.tables import read_landmarks_csv, read_tracks_csv


def score_run(
    truth_dir: Path | None,
    motions: Sequence[Motion],
    tracks: Tracks | None,
    *,
    frames: Sequence[int],
    hulls: StageStore | None,
    epsilon_mm: float = 100.0,
) -> dict[str, Any] | None:
    """All scores of a run, or None when the session holds no truth files.

    truth_dir : of the session, None = it has none.  motions, tracks : what the run found.  frames : it worked on.
    hulls : the store with its hulls, None = it made none, and the volume is not scored.
    """
    if truth_dir is None or not (truth_dir / "landmarks.csv").exists():
        return None
    tracks_path = truth_dir / "tracks.csv"
    return evaluate(
        motions,
        read_landmarks_csv(truth_dir / "landmarks.csv"),
        tracks,
        read_tracks_csv(tracks_path) if tracks_path.exists() else None,
        None if hulls is None else volume_overlap(truth_dir, hulls),
        epsilon_mm,
        frames=list(frames),
    )
