"""Scores of a run against the truth of its session, as run.json and the report hold them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from mocap.compare.hulls import volume_overlap
from mocap.compare.scores import evaluate
from mocap.data import Motion, Tracks
from mocap.io.session import Session
from mocap.io.store import StageStore


def score_run(
    session: Session,
    motions: Sequence[Motion],
    tracks: Tracks | None,
    *,
    hulls: StageStore | None,
    epsilon_mm: float = 100.0,
) -> dict[str, Any] | None:
    """All scores of a run, or None when the session holds no truth files.

    motions, tracks : what the run found.  hulls : the store with its hulls, None = it made none, and the volume is not
    scored.
    """
    truth = session.true_motions
    if truth is None or session.truth_dir is None:
        return None
    return evaluate(
        motions,
        truth,
        tracks,
        session.true_tracks,
        None if hulls is None else volume_overlap(session.truth_dir, hulls),
        epsilon_mm,
        frames=list(session.frames),
    )
