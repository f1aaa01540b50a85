"""Speed of a run from video files to poses, and of its pose stage.

    python -m eval.pose_speed [--only demo,cameras_4] [--frames 60] [--runs 1] [--threads 1,2] [--work out/eval]

One thing at a time is changed from `demo`: persons, cameras, voxels, particles, size of the pictures. CPU time is that
of one thread, which no other process disturbs: decoding and segmentation; furniture, carving and tracking; poses with
the search for the first one. Exports and report are left out. `run_ms` is the wall clock of the whole run at once with
so many threads: run it on an idle machine. Writes eval/results/pose_speed.csv, whole, and docs/pictures/pose-speed.png.
"""

from __future__ import annotations

import argparse
import os
import tempfile
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from eval.pose_ablation import session_folder
from eval.pose_sessions import ROOT
from eval.whole import save_figure, write_csv

RESULTS = ROOT / "eval" / "results" / "pose_speed.csv"
PICTURE = ROOT / "docs" / "pictures" / "pose-speed.png"
FIELDS = (
    "case", "run", "frames", "persons", "cameras", "voxel_cm", "particles", "preset",
    "segment_ms", "volume_ms", "pose_ms", "cpu_ms", "threads", "cores", "load", "run_ms",
)  # fmt: skip
# Words that a run ends with, and what they are called here.
STEPS = {"segment": "segment_ms", "track": "volume_ms", "pose": "pose_ms"}


@dataclass(frozen=True)
class Case:
    """What is run.  n_cameras : evenly chosen from the rig; None = all."""

    scene: str = "demo"
    n_cameras: int | None = None
    settings: tuple[str, ...] = ()
    preset: str = "default"


CASES: Mapping[str, Case] = {
    "demo": Case(),
    "realtime": Case(preset="realtime"),
    "persons_2": Case("two_persons"),
    "cameras_4": Case(n_cameras=4),
    "cameras_5": Case(n_cameras=5),
    "voxels_15mm": Case(settings=("volume.voxel_size_m=0.015",)),
    "voxels_30mm": Case(settings=("volume.voxel_size_m=0.03",)),
    "particles_100": Case(settings=("pose.n_particles=100",)),
    "particles_400": Case(settings=("pose.n_particles=400",)),
}


def opened(case: Case, n_frames: int, work: Path) -> Any:
    """The session of a case."""
    from mocap.io.session import open_session

    session = open_session(session_folder(case.scene, work), frames=(0, n_frames))
    if case.n_cameras is None:
        return session
    rows = np.unique(np.linspace(0, len(session.rig), case.n_cameras, endpoint=False).astype(int))
    names = [session.rig.names[i] for i in rows]
    return replace(
        session,
        rig=session.rig.subset(names),
        image_sources={name: session.image_sources[name] for name in names},
        background_sources={name: session.background_sources[name] for name in names},
    )


def measure(case: Case, session: Any, threads: Sequence[int]) -> list[dict[str, Any]]:
    """CPU per frame, step by step on one thread, and the wall clock of whole runs; ms."""
    from mocap.pipeline.config import load_config
    from mocap.pipeline.run import run_session

    config = load_config(case.preset, ("output.formats=[]", *case.settings))
    n = len(session.frames)
    row: dict[str, Any] = {}
    with tempfile.TemporaryDirectory() as folder:
        for until, field in STEPS.items():
            before = time.process_time()
            found = run_session(
                session, Path(folder) / "steps", config=config, until=until, resume=True, n_threads=1
            )
            row[field] = round(1e3 * (time.process_time() - before) / n, 1)
        row |= {
            "persons": len(found.poses),
            "voxel_cm": 100 * config.volume.voxel_size_m,
            "particles": config.pose.n_layers * config.pose.n_particles,
        }
        row["cpu_ms"] = round(sum(row[field] for field in STEPS.values()), 1)
        rows = []
        for n_threads in threads:
            begun = time.perf_counter()
            run_session(session, Path(folder) / "run", config=config, until="pose", n_threads=n_threads)
            run_ms = round(1e3 * (time.perf_counter() - begun) / n, 1)
            rows.append({**row, "threads": n_threads, "run_ms": run_ms})
    return rows or [row]


def draw(rows: Sequence[Mapping[str, Any]], path: Path) -> None:
    """CPU per frame of every case as a bar of its steps, the cheapest run of each."""
    from matplotlib.figure import Figure

    cases = list(dict.fromkeys(row["case"] for row in rows))
    best = [min((r for r in rows if r["case"] == case), key=lambda r: r["cpu_ms"]) for case in cases]
    figure = Figure(figsize=(7.0, 0.4 * len(cases) + 1.2), dpi=100, layout="constrained")
    axes = figure.subplots()
    left = np.zeros(len(cases))
    for field, label in (
        ("segment_ms", "decoding, segmentation"),
        ("volume_ms", "furniture, carving, tracking"),
        ("pose_ms", "poses"),
    ):
        width = np.array([float(row[field]) for row in best])
        axes.barh(np.arange(len(cases)), width, left=left, label=label)
        left += width
    axes.set_yticks(np.arange(len(cases)), [case.replace("_", " ") for case in cases])
    axes.invert_yaxis()
    axes.set_xlabel("ms of CPU per frame")
    axes.legend(frameon=False)
    save_figure(figure, path)


def main() -> None:
    from mocap.pipeline.warm_up import warm_up

    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--only", default=",".join(CASES), help="cases, separated by commas")
    parser.add_argument("--frames", type=int, default=60)
    parser.add_argument("--runs", type=int, default=1)
    parser.add_argument("--threads", default="1,2", help="of the runs on the wall clock; empty = none")
    parser.add_argument("--work", type=Path, default=ROOT / "out" / "eval")
    arguments = parser.parse_args()
    threads = [int(word) for word in arguments.threads.split(",") if word]
    n_cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    warm_up()
    rows = []
    for name in arguments.only.split(","):
        case = CASES[name]
        session = opened(case, arguments.frames, arguments.work)
        for run in range(arguments.runs):
            load = round(os.getloadavg()[0], 1) if hasattr(os, "getloadavg") else None
            shared = {
                "case": name, "run": run, "frames": len(session.frames), "cameras": len(session.rig),
                "preset": case.preset, "cores": n_cores, "load": load,
            }  # fmt: skip
            for row in measure(case, session, threads):
                rows.append(shared | row)
                print("  ".join(f"{key} {value}" for key, value in rows[-1].items()), flush=True)
    write_csv(RESULTS, FIELDS, rows)
    draw(rows, PICTURE)


if __name__ == "__main__":
    main()
