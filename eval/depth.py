"""Depth: one camera that measures it and ordinary ones, against more ordinary ones.

Makes the scenes `depth_*_test`, which nothing was chosen on, and runs them with some of their cameras; writes
eval/results/depth.csv whole.

    python -m eval.depth [--scenes NAME,...] [--seeds 1]

The cameras of a scene stand on a ring, cam_0 measures depth. Few cameras are those that stand furthest apart.
"""

from __future__ import annotations

import argparse
import json
import os
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from eval.evidence import scores
from eval.whole import write_csv, write_text

ROOT = Path(__file__).resolve().parents[1]
RESULTS = ROOT / "eval" / "results" / "depth.csv"
SCENES = ("depth_walk_test", "depth_gesture_test", "depth_dance_test")
FIELDS = (
    *("scene", "cameras", "depth_cameras", "seed", "found"),
    *("mean_error_mm", "mean_error_after_offset_mm", "mmta_percent", "volume_iou", "cpu_ms_per_frame"),
)


@dataclass(frozen=True)
class Rig:
    """Some cameras of a scene.  with_depth : whether cam_0's depth maps are used."""

    cameras: tuple[int, ...]
    with_depth: bool


RIGS = (Rig((0, 2, 3), False), Rig((0, 2, 3), True), Rig((0, 1, 2, 3, 4), False))


def session_folder(source: Path, rig: Rig, work: Path) -> Path:
    """A session of some cameras of a scene."""
    name = "".join(map(str, rig.cameras)) + ("_depth" if rig.with_depth else "")
    folder = work / f"{source.name}_{name}"
    folder.mkdir(parents=True, exist_ok=True)
    links = ["calibration.toml", "videos", "background", "truth", *(["depth"] if rig.with_depth else [])]
    for link in links:
        if not (folder / link).exists():
            os.symlink((source / link).resolve(), folder / link)
    cameras = json.dumps([f"cam_{k}" for k in rig.cameras])
    bounds = next(line for line in (source / "session.toml").read_text().splitlines() if "bounds" in line)
    write_text(folder / "session.toml", f"fps = 30.0\ncameras = {cameras}\n{bounds}\n")
    return folder


def measure(source: Path, rig: Rig, seed: int, work: Path, overrides: Sequence[str] = ()) -> dict[str, Any]:
    """One run as a row."""
    from mocap.io.tables import read_landmarks_csv
    from mocap.pipeline.config import load_config
    from mocap.pipeline.run import run_session
    from mocap.pose.result import motion_of

    folder = session_folder(source, rig, work)
    config = load_config("default", ("output.formats=[]", *overrides))
    begin = time.process_time()
    result = run_session(folder, folder.parent / f"{folder.name}_out", config=config, seed=seed, n_threads=1)
    cpu_s = time.process_time() - begin
    n = len(result.session.frames)
    motions = [motion_of(p, result.session.fps) for p in result.poses]
    truth = read_landmarks_csv(source / "truth" / "landmarks.csv")
    return {
        "scene": source.name,
        "cameras": len(rig.cameras),
        "depth_cameras": int(rig.with_depth),
        "seed": seed,
        **{k: v for k, v in scores(motions, truth, n).items() if k != "persons"},
        "volume_iou": _iou(folder.parent / f"{folder.name}_out", source),
        "cpu_ms_per_frame": round(1000 * cpu_s / n, 1),
    }


def _iou(out: Path, source: Path) -> float | None:
    """Overlap of the hulls of a run with the true bodies."""
    from mocap.compare.hulls import volume_overlap
    from mocap.io.store import StageStore

    found = volume_overlap(source / "truth", StageStore(out / "store.zarr"))
    return None if found is None or found.iou is None else round(found.iou, 4)


def main(arguments: Sequence[str] | None = None) -> None:
    """Make the scenes, run all cases, and write the table."""
    from mocap.synth import synthesise

    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--scenes", default=",".join(SCENES))
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--work", type=Path, default=ROOT / "out" / "depth")
    parser.add_argument("--set", action="append", default=[], help="KEY=VALUE; nothing is written then")
    options = parser.parse_args(arguments)

    def rows() -> Iterator[dict[str, Any]]:
        for scene in options.scenes.split(","):
            source = options.work / scene
            if not source.is_dir():
                synthesise(scene, source, workers=1)
            for rig in RIGS:
                for seed in range(options.seeds):
                    row = measure(source, rig, seed, options.work, options.set)
                    print(", ".join(f"{k} {v}" for k, v in row.items()), flush=True)
                    yield row

    if options.set or options.scenes != ",".join(SCENES):
        list(rows())
    else:
        write_csv(RESULTS, FIELDS, rows())


if __name__ == "__main__":
    main()
