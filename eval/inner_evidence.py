"""What evidence inside the silhouette is worth where it is hard: arms before a trunk of the same look.

    python -m eval.inner_evidence [--seeds 5] [--work out/eval]

Three scenes with the same man, room and gestures: bare skin all over, a suit of one colour, a striped shirt with bare
arms; before all seven cameras, and before four that stand all round. Pose stage alone, on masks, volumes and tracks
that are made once per scene. A row per scene, cameras, variant and seed;
mean errors over 15 landmarks, mm, raw and in the other frames after one offset per landmark learnt on the first ten,
and over elbows and wrists, raw. Variants: `none` knows outlines and hull alone, `zones` how colours are spread over
zones of the body, `best` the colours of places of its surface besides. Writes eval/results/inner_evidence.csv, whole,
and prints the means.
"""

from __future__ import annotations

import argparse
import sys
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from eval.accuracy import measures
from eval.few_cameras import some_cameras
from eval.pose_ablation import poses_of, run_until_tracks, session_folder
from eval.pose_sessions import ROOT
from eval.whole import write_csv
from mocap.data import LANDMARKS, Motion
from mocap.io.tables import read_landmarks_csv
from mocap.metrics.points import point_errors
from mocap.pipeline.config import load_config
from mocap.pose.result import motion_of

RESULTS = ROOT / "eval" / "results" / "inner_evidence.csv"
SCENES = ("arms_bare", "arms_uniform", "arms_striped")
VARIANTS = {
    "none": ("default", ("pose.texture_weight=0", "pose.colour_weight=0")),
    "zones": ("default", ("pose.texture_weight=0",)),
    "best": ("best", ()),
}
SCORES = ("raw", "after_offset", "arms", "lost_wrist_percent")
FIELDS = ("session", "cameras", "variant", "seed", *SCORES)
FOUR = ("cam_0", "cam_2", "cam_4", "cam_5")
_ARMS = [k for k, name in enumerate(LANDMARKS) if name.endswith(("elbow", "wrist"))]


def prepared(name: str, n_cameras: int, work: Path) -> tuple[Path, Path]:
    """Session folder and run folder of a scene before some cameras."""
    folder = session_folder(name, work)
    if n_cameras == len(FOUR):
        folder = some_cameras(folder, FOUR, work)
    out = work / "inner_evidence" / folder.name
    run_until_tracks(folder, out)
    return folder, out


def scores_of(folder: Path, out: Path, variant: str, seed: int) -> dict[str, Any]:
    """One run of the pose stage."""
    session, (poses,) = poses_of(folder, out, load_config(*VARIANTS[variant]), seed)
    (truth,) = read_landmarks_csv(folder / "truth" / "landmarks.csv")
    found = motion_of(poses, session.fps)
    row = measures(found, truth, session.fps) | {"arms": arms_mm(found, truth)}
    return {"variant": variant, "seed": seed} | {score: round(row[score], 2) for score in SCORES}


def arms_mm(found: Motion, truth: Motion) -> float:
    """Mean error of elbows and wrists, mm, over the frames that both have."""
    _, i, j = np.intersect1d(found.frames, truth.frames, return_indices=True)
    errors = point_errors(found.landmarks[i][:, : len(LANDMARKS)], truth.landmarks[j][:, : len(LANDMARKS)])
    return float(np.nanmean(errors[:, _ARMS]))


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--work", type=Path, default=ROOT / "out" / "eval")
    options = parser.parse_args()
    rows = []
    for name, n_cameras in product(SCENES, (7, 4)):
        folder, out = prepared(name, n_cameras, options.work)
        for variant in VARIANTS:
            own = [scores_of(folder, out, variant, seed) for seed in range(options.seeds)]
            means = ", ".join(f"{score} {np.mean([row[score] for row in own]):.1f}" for score in SCORES)
            sys.stdout.write(f"{name} {n_cameras} {variant}: {means}\n")
            sys.stdout.flush()
            rows += [{"session": name, "cameras": n_cameras} | row for row in own]
    write_csv(RESULTS, FIELDS, rows)


if __name__ == "__main__":
    main()
