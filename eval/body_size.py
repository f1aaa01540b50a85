"""Errors of the standing height and of the limb lengths that a run sizes its body with, where the truth is exact.

    python -m eval.body_size [--only walk,dev:walk] [--test] [--seed 0] [--work out/eval]

Two ways of sizing: by the highest place of the head (`body.sizing = "head"`, CF 6.3.4), and by the size at which also
refined poses explain the volumes best (`"poses"`). Prints a line per person and way and writes
eval/results/body_size.csv. Bones are distances of true landmarks (means over frames) against those of the sized body.
"""

from __future__ import annotations

import argparse
import csv
import json
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from eval.pose_ablation import prepare
from eval.pose_coverage import DEV_SESSIONS, DEV_TEST, SCENES, TEST
from eval.pose_sessions import DEV, ROOT
from eval.whole import write_csv

RESULTS = ROOT / "eval" / "results" / "body_size.csv"
WAYS = ("head", "poses")
BONES = {
    "trunk": ("pelvis", "neck"),
    "upper_arm": ("shoulder", "elbow"),
    "forearm": ("elbow", "wrist"),
    "thigh": ("hip", "knee"),
    "shank": ("knee", "ankle"),
}
FIELDS = (
    "session",
    "person",
    "way",
    "true_height_m",
    "height_m",
    "error_mm",
    "seconds",
    *(f"{b}_mm" for b in BONES),
)

Array = NDArray[np.float64]


def bone_lengths(landmarks: Array) -> dict[str, float]:
    """Mean lengths, m, over frames and sides, of landmarks (T, 15, 3)."""
    from mocap.data import LANDMARKS

    out = {}
    for name, (a, b) in BONES.items():
        pairs = [(a, b)] if a in LANDMARKS else [(f"{s}_{a}", f"{s}_{b}") for s in ("left", "right")]
        lengths = [
            np.linalg.norm(landmarks[:, LANDMARKS.index(p)] - landmarks[:, LANDMARKS.index(q)], axis=1)
            for p, q in pairs
        ]
        out[name] = float(np.nanmean(np.concatenate(lengths)))
    return out


def measure(name: str, work: Path, seed: int) -> list[dict[str, Any]]:
    """Rows of one session."""
    from mocap.body import landmarks_of, neutral_state
    from mocap.body.initial import HeightEstimate
    from mocap.io.session import open_session
    from mocap.io.store import StageStore
    from mocap.io.tables import read_landmarks_csv
    from mocap.pipeline.config import load_config
    from mocap.pipeline.pose_settings import make_tools
    from mocap.pipeline.stages.pose import hulls_of_person
    from mocap.pose.person import VolumeClip, start_person
    from mocap.pose.volume import VolumeObservation, estimate_height
    from mocap.products.hulls import stored_grid
    from mocap.products.tracks import stored_tracks

    folder, out = prepare(name, work, trust_store=True)
    session, store, config = open_session(folder), StageStore(out / "store.zarr"), load_config()
    grid, tracks = stored_grid(store), stored_tracks(store, session.fps)
    about = json.loads((folder / "truth" / "truth.json").read_text(encoding="utf-8"))["persons"]
    truth = read_landmarks_csv(folder / "truth" / "landmarks.csv")
    rows = []
    for person in tracks.persons:
        own, hull_of = tracks.of(person), hulls_of_person(session, store, person)
        distance = [
            np.nanmean(
                np.linalg.norm(
                    np.nanmean(t.landmarks, axis=1)[np.isin(t.frames, own.frame)][:, :2]
                    - own.xyz[np.isin(own.frame, t.frames)][:, :2],
                    axis=1,
                )
            )
            for t in truth
        ]
        k = int(np.argmin(distance))
        true_height, true_bones = float(about[k]["height_m"]), bone_lengths(truth[k].landmarks)
        head = estimate_height(grid, hull_of, own.frame.tolist())
        for way in WAYS:
            started = time.perf_counter()
            tools = make_tools(
                grid,
                session.fps,
                head.height_m,
                config.body_model("voxels"),
                config.pose,
                config.likelihood,
                1,
            )
            height: HeightEstimate = head
            if way == "poses":
                clip = VolumeClip(person, own.frame, own.xyz, VolumeObservation(tools, hull_of))
                found = start_person(clip, head, seed=seed, is_size_fitted=True)
                tools, height = found.tools, found.height
            bones = bone_lengths(landmarks_of(tools.body, neutral_state(tools.body)[None]))
            row: dict[str, Any] = {
                "session": name,
                "person": person,
                "way": way,
                "true_height_m": round(true_height, 4),
                "height_m": round(height.height_m, 4),
                "error_mm": round(1000 * (height.height_m - true_height), 1),
                "seconds": round(time.perf_counter() - started, 1),
            }
            row |= {f"{b}_mm": round(1000 * (bones[b] - true_bones[b]), 1) for b in BONES}
            rows.append(row)
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--only", help="sessions, separated by commas")
    parser.add_argument("--test", action="store_true", help="held-out scenes instead of development sessions")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--work", type=Path, default=ROOT / "out" / "eval")
    arguments = parser.parse_args()
    names = (
        [*TEST]
        if arguments.test
        else [*SCENES, *(f"dev:{n}" for n in DEV_SESSIONS + DEV_TEST if (DEV / n).is_dir())]
    )
    if arguments.only:
        names = arguments.only.split(",")
    rows: list[dict[str, Any]] = []
    if RESULTS.exists():
        with RESULTS.open(encoding="utf-8", newline="") as stream:
            rows = [r for r in csv.DictReader(stream) if r["session"] not in names]
    new: list[dict[str, Any]] = []
    for name in names:
        for row in measure(name, arguments.work, arguments.seed):
            new.append(row)
            sys.stdout.write(" ".join(f"{k}={row[k]}" for k in FIELDS) + "\n")
            sys.stdout.flush()
    for way in WAYS:
        own = [r for r in new if r["way"] == way]
        words = [f"{b} {np.mean([abs(r[f'{b}_mm']) for r in own]):.0f}" for b in BONES]
        height = [abs(r["error_mm"]) for r in own]
        sys.stdout.write(
            f"{way}: mean absolute error of the height {np.mean(height):.1f} mm, largest {max(height):.0f} mm; "
            f"of bones, mm: {', '.join(words)}\n"
        )
    write_csv(RESULTS, FIELDS, [*rows, *new])


if __name__ == "__main__":
    main()
