"""What occluders are worth in furnished rooms: hulls and poses with occluders learnt and ignored, one table.

    python -m eval.occlusion                       # development scenes
    python -m eval.occlusion --test                # the scenes kept for the final judgement
    python -m eval.occlusion SESSION [SESSION ...] # sessions with truth/

Synthesises what is not in --work yet (two minutes a scene) and runs each session twice for every seed. Writes
eval/results/occlusion_{development,test}.csv. Thresholds were set on realistic sessions of another make.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from eval.whole import write_csv
from mocap.data import LANDMARKS
from mocap.io.store import StageStore
from mocap.io.tables import read_landmarks_csv
from mocap.pipeline.config import load_config
from mocap.pipeline.run import run_session
from mocap.products.hulls import read_hulls

RESULTS = Path(__file__).with_name("results")
DEVELOPMENT, TEST = ("furnished", "walk_counter", "sit", "walk"), ("furnished_test", "sit_test", "walk_test")
LEGS = ("left_knee", "right_knee", "left_ankle", "right_ankle")
FIELDS = ("mean_error_mm", "mean_error_after_offset_mm", "mmta_percent", "coverage_90_percent")
Row = dict[str, str | float | int | None]


def evaluate(session: Path, work: Path, how: str, seed: int) -> Row:
    """One run of a session, judged.  how : `learn` or `ignore`, as of volume.occluders."""
    out = work / "runs" / f"{session.name}_{how}_{seed}"
    config = load_config("default", ("output.formats=[]", f"volume.occluders={how}"))
    run_session(session, out, config=config, seed=seed)
    record = json.loads((out / "run.json").read_text(encoding="utf-8"))
    scores = record["scores"]
    share = record["numbers"].get("occluders", {}).get("picture_share", {})
    return {
        "session": session.name,
        "occluders": how,
        "seed": seed,
        "largest_picture_share": max(share.values(), default=0.0),
        "legs_in_hull_percent": round(100.0 * legs_in_hull(session, out), 1),
        "hull_iou": None if scores["volume_iou"] is None else round(scores["volume_iou"], 3),
        **{name: round(scores[name], 1) for name in FIELDS},
        "camera_faults": record["numbers"]["carve"]["camera_faults"],
    }


def legs_in_hull(session: Path, out: Path) -> float:
    """Share of the true knees and ankles that lie in an occupied voxel, over persons and frames."""
    columns = [LANDMARKS.index(name) for name in LEGS]
    true = read_landmarks_csv(session / "truth" / "landmarks.csv")
    inside = []
    for frame, hull in read_hulls(StageStore(out / "store.zarr")):
        for person in true:
            row = np.flatnonzero(person.frames == frame)
            if len(row):
                at = hull.grid.voxels_of(person.landmarks[row[0], columns])
                inside.append(np.isin(at, hull.voxels))
    return float(np.mean(inside)) if inside else float("nan")


def prepared(name: str, work: Path) -> Path:
    """The session of a scene, synthesised when it is not there yet."""
    root = work / name
    if not (root / "truth" / "truth.json").exists():
        from mocap.synth import synthesise

        synthesise(name, root)
    return root


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m eval.occlusion", description=__doc__)
    parser.add_argument("sessions", nargs="*", type=Path, help="session folders; the scenes when absent")
    parser.add_argument(
        "--work", type=Path, default=Path("out/occlusion"), help="folder for sessions and runs"
    )
    parser.add_argument("--test", action="store_true", help="the scenes kept for the final judgement")
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--name", help="of the table; development or test when absent")
    options = parser.parse_args(argv)
    scenes = TEST if options.test else DEVELOPMENT
    sessions = options.sessions or [prepared(name, options.work) for name in scenes]
    rows: list[Row] = []
    for session in sessions:
        for how in ("ignore", "learn"):
            rows += [evaluate(session, options.work, how, seed) for seed in range(options.seeds)]
            print(", ".join(f"{k} {v}" for k, v in rows[-1].items()), flush=True)
    path = RESULTS / f"occlusion_{options.name or ('test' if options.test else 'development')}.csv"
    write_csv(path, list(rows[0]), rows)
    return 0


if __name__ == "__main__":
    sys.exit(main())
