"""Pieces of a recording run apart and joined, against the whole run: how far apart they are, by overlap.

    python -m eval.join_pieces

Two people of the development scene `two_persons` in pictures of 320 x 240, default preset. What another seed does to
the whole run stands beside it: nearer than that a result of another filter cannot be. Writes
eval/results/join_pieces.csv; a command that was stopped goes on where it was.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from eval.fault_table import prepared
from eval.whole import write_csv
from mocap.pipeline.config import load_config
from mocap.pipeline.join import join_runs, piece_frames
from mocap.pipeline.record import RunResult
from mocap.pipeline.run import run_session

RESULT = Path(__file__).with_name("results") / "join_pieces.csv"
SCENE, SIZE, N_FRAMES = "two_persons", (320, 240), 90
N_PIECES = 2
OVERLAPS_S = (0.5, 1.0)


def differences_mm(one: RunResult, other: RunResult) -> NDArray[np.float64]:
    """Distances of the landmarks of all persons, each paired with the nearest of the other run, mm."""
    found = []
    for p in one.poses:
        means = {}
        for q in other.poses:
            frames, at, there = np.intersect1d(p.frames, q.frames, return_indices=True)
            if len(frames):
                d = 1000 * np.linalg.norm(p.landmarks[at] - q.landmarks[there], axis=2)
                means[float(d.mean())] = d.ravel()
        found.append(means[min(means)])
    return np.concatenate(found)


def row_of(name: str, overlap_s: float | None, run: RunResult, whole: RunResult) -> dict[str, Any]:
    """One row of the table."""
    d = differences_mm(whole, run)
    seams = run.record.numbers.get("join", {}).get("seams", [])
    gaps = [gap for seam in seams for gap in seam["gap_mm"].values()]
    scores = run.scores or {}
    return {
        "run": name,
        "overlap_s": "" if overlap_s is None else overlap_s,
        "persons": len(run.poses),
        "heights_m": " ".join(f"{p.height.height_m:.3f}" for p in run.poses),
        "largest_gap_at_seam_mm": max(gaps, default=""),
        "median_from_whole_mm": round(float(np.median(d)), 1),
        "mean_from_whole_mm": round(float(d.mean()), 1),
        "percentile_95_from_whole_mm": round(float(np.percentile(d, 95)), 1),
        "mean_error_mm": round(scores["mean_error_mm"], 1),
        "coverage_90_percent": round(scores["coverage_90_percent"], 1),
    }


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m eval.join_pieces", description=__doc__)
    parser.add_argument(
        "--work", type=Path, default=Path("out/join_pieces"), help="folder for session and runs"
    )
    options = parser.parse_args(argv)
    session = prepared(SCENE, options.work, SIZE, n_frames=N_FRAMES)
    config = load_config("default", ("output.formats=[]",))

    def run(name: str, frames: range | None = None, seed: int = 0) -> RunResult:
        limits = None if frames is None else (frames.start, frames.stop)
        result = run_session(
            session, options.work / name, config=config, seed=seed, until="pose", resume=True, frames=limits
        )
        print(name, result.scores and result.scores["mean_error_mm"], flush=True)
        return result

    whole = run("whole")
    rows = [
        row_of("whole", None, whole, whole),
        row_of("whole, another seed", None, run("seed", seed=1), whole),
    ]
    for overlap_s in OVERLAPS_S:
        cut = piece_frames(whole.session.frames, N_PIECES, round(overlap_s * whole.session.fps))
        runs = [run(f"piece_{p.start}_{p.stop}", p) for p in cut]
        joined = join_runs(session, [r.out for r in runs], options.work / f"joined_{overlap_s}")
        rows.append(row_of(f"{N_PIECES} pieces", overlap_s, joined, whole))
    write_csv(RESULT, list(rows[0]), rows)
    return 0


if __name__ == "__main__":
    sys.exit(main())
