"""Speed of the pose stage: milliseconds per frame of one person, and seconds until the first pose is settled.

    python -m eval.pose_speed [--scene demo] [--preset default] [--threads 1,2] [--runs 2] [--work out/eval]

Masks, volumes and tracks are made once. A frame's time is that between two reports of progress, on the wall clock: run
it on an idle machine. Writes eval/results/pose_speed.csv.
"""

from __future__ import annotations

import argparse
import time
from itertools import pairwise
from pathlib import Path
from statistics import fmean, median
from typing import Any

from eval.pose_ablation import prepare
from eval.pose_sessions import ROOT
from eval.whole import write_csv

RESULTS = ROOT / "eval" / "results" / "pose_speed.csv"
FIELDS = ("scene", "preset", "threads", "run", "frames", "start_s", "median_ms", "mean_ms", "frames_per_s")


def measure(scene: str, preset: str, n_threads: int, work: Path) -> dict[str, Any]:
    """One run of the pose stage: seconds before the first frame, and milliseconds per frame after it."""
    from mocap.io.session import open_session
    from mocap.io.store import StageStore
    from mocap.pipeline.config import load_config
    from mocap.pipeline.stages.pose import estimate_poses
    from mocap.products.tracks import stored_tracks

    folder, out = prepare(scene, work, trust_store=False)
    session, store = open_session(folder), StageStore(out / "store.zarr")
    ticks: list[float] = []
    begun = time.perf_counter()
    poses = estimate_poses(
        session,
        load_config(preset),
        store,
        stored_tracks(store, session.fps),
        seed=0,
        n_threads=n_threads,
        progress=lambda stage, done, total: ticks.append(time.perf_counter()),
    )
    # What follows the last frame, repair and smoothing, belongs to the frames.
    after = time.perf_counter() - ticks[-1]
    gaps = [b - a for a, b in pairwise(ticks)]
    n = sum(len(p.frames) for p in poses)
    mean = fmean(gaps) + after / n
    return {
        "frames": n,
        "start_s": round(ticks[0] - begun, 2),
        "median_ms": round(1e3 * median(gaps), 1),
        "mean_ms": round(1e3 * mean, 1),
        "frames_per_s": round(1.0 / mean, 1),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--scene", default="demo")
    parser.add_argument("--preset", default="default")
    parser.add_argument("--threads", default="1,2")
    parser.add_argument("--runs", type=int, default=2)
    parser.add_argument("--work", type=Path, default=ROOT / "out" / "eval")
    arguments = parser.parse_args()
    rows = []
    for n_threads in map(int, arguments.threads.split(",")):
        for run in range(arguments.runs):
            row = {"scene": arguments.scene, "preset": arguments.preset, "threads": n_threads, "run": run}
            row |= measure(arguments.scene, arguments.preset, n_threads, arguments.work)
            print("  ".join(f"{key} {value}" for key, value in row.items()), flush=True)
            rows.append(row)
    write_csv(RESULTS, FIELDS, rows)


if __name__ == "__main__":
    main()
