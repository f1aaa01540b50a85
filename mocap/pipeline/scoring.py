"""Scores of a run against the truth of its session."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from mocap.data import VoxelGrid
from mocap.errors import MocapError
from mocap.io.store import StageStore
from mocap.io.tables import read_landmarks_csv, read_tracks_csv
from mocap.metrics import evaluate, sum_volume_scores, volume_scores
from mocap.metrics.volume import VolumeScores
from mocap.pipeline.stages import stored_grid

if TYPE_CHECKING:
    from mocap.pipeline.run import RunResult


def score_run(result: RunResult, store: StageStore, *, epsilon_mm: float = 100.0) -> dict[str, Any] | None:
    """All scores of a run, or None when the session holds no truth files."""
    truth_dir = result.session.truth_dir
    if truth_dir is None or not (truth_dir / "landmarks.csv").exists():
        return None
    tracks_path = truth_dir / "tracks.csv"
    return evaluate(
        result.motions,
        read_landmarks_csv(truth_dir / "landmarks.csv"),
        result.tracks,
        read_tracks_csv(tracks_path) if tracks_path.exists() else None,
        volume_overlap(truth_dir, store) if "carve" in result.numbers else None,
        epsilon_mm,
        frames=list(result.session.frames),
    )


def score_folder(out: Path, session_root: Path, *, epsilon_mm: float = 100.0) -> dict[str, Any]:
    """Scores of a run's output folder against the truth in a session folder; frames as in its run.json."""
    truth_dir = session_root / "truth"
    if not (truth_dir / "landmarks.csv").exists():
        raise MocapError(
            "the session has no truth to compare with",
            path=truth_dir / "landmarks.csv",
            remedy="evaluate only sessions with truth/landmarks.csv (and tracks.csv), as `mocap synth` writes them",
        )
    if not (out / "landmarks.csv").exists():
        raise MocapError(
            "the folder holds no result of a run",
            path=out / "landmarks.csv",
            remedy="run `mocap run SESSION -o OUT` first",
        )
    tracks_path, truth_tracks = out / "tracks.csv", truth_dir / "tracks.csv"
    return evaluate(
        read_landmarks_csv(out / "landmarks.csv"),
        read_landmarks_csv(truth_dir / "landmarks.csv"),
        read_tracks_csv(tracks_path) if tracks_path.exists() else None,
        read_tracks_csv(truth_tracks) if truth_tracks.exists() else None,
        volume_overlap(truth_dir, StageStore(out / "store.zarr")),
        epsilon_mm,
        frames=_frames_of_run(out),
    )


def _frames_of_run(out: Path) -> list[int] | None:
    try:
        start, stop = json.loads((out / "run.json").read_text(encoding="utf-8"))["frames"]
    except (OSError, ValueError, KeyError, TypeError):
        return None  # landmarks.csv from elsewhere: every frame of the truth counts
    return list(range(int(start), int(stop)))


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
    with np.load(path, allow_pickle=False) as data:
        nx, ny, nz = (int(n) for n in data["shape"])
        truth_grid = VoxelGrid(data["origin_m"], (nx, ny, nz), float(data["voxel_size_m"]))
        offsets, voxels = data["offsets"], data["voxels"]
    if abs(truth_grid.voxel_size_m - grid.voxel_size_m) > 1e-9:
        return None
    scores = []
    for frame, arrays in reader:
        if frame + 1 >= len(offsets):
            break
        own = voxels[offsets[frame] : offsets[frame + 1]]
        on_grid = grid.voxels_of(truth_grid.centers(own))
        scores.append(volume_scores(_on_grid(arrays["voxels"]), on_grid[on_grid >= 0]))
    return sum_volume_scores(scores) if scores else None


def _on_grid(voxels: NDArray[np.generic]) -> NDArray[np.int64]:
    return voxels.astype(np.int64)
