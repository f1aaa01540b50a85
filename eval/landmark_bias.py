"""How much of the error is constant on its segment: where a body's joints stand wrongly, and what else is left.

    python -m eval.landmark_bias [--only dev:walk,dev:cross] [--bodies before,now] [--seeds 1] [--work out/eval]

Runs the default preset with the body as it is (`now`) and as it was before decision 52 (`before`,
eval/bodies/girdle_before.toml); stages before the poses are computed once per session. A landmark's error is turned
into the frame of the joint that carries it. Its mean there, over the frames in which the landmark is found within
100 mm, is the bias: a joint at another place in the flesh, or a segment of another length. `rest` is what is left
without it, `fast` the part of that which changes within 0.3 s. Writes eval/results/landmark_bias.csv: one row per
session, person, body, seed and kind of landmark, kind `all` with the scores.
"""

from __future__ import annotations

import argparse
import csv
import sys
from pathlib import Path
from typing import Any

import numpy as np

from eval.pose_ablation import SESSIONS, prepare
from eval.pose_sessions import ROOT
from eval.whole import write_csv
from mocap.arrays import Array
from mocap.body.kinematics import joint_transforms
from mocap.data.motion import LANDMARKS, Motion
from mocap.metrics.points import offset_corrected, point_errors, point_scores
from mocap.pose.result import PersonPoses

RESULTS = ROOT / "eval" / "results" / "landmark_bias.csv"
BODIES = {"before": str(ROOT / "eval" / "bodies" / "girdle_before.toml"), "now": "girdle"}
FIELDS = (
    *("session", "person", "body", "seed", "landmark", "raw_mm", "bias_mm", "rest_mm", "fast_mm"),
    *("after_offset_mm", "mmta_percent", "height_m"),
)
_FOUND_MM = 100.0
_FAST_FRAMES = 9  # 0.3 s at 30 frames per second


def poses_of(folder: Path, out: Path, body: str, seed: int) -> list[PersonPoses]:
    """Poses of a session whose masks, volumes and tracks are in the store of `out`."""
    from mocap.io.session import open_session
    from mocap.io.store import StageStore
    from mocap.pipeline.config import load_config
    from mocap.pipeline.stage import Job
    from mocap.pipeline.stages.pose import estimate_poses
    from mocap.products.tracks import stored_tracks

    session, store = open_session(folder), StageStore(out / "store.zarr")
    config = load_config("default", (f"body.model={body}",))
    tracks = stored_tracks(store, session.fps)
    return estimate_poses(Job(session, config, store, seed=seed), tracks)


def rows_of(poses: PersonPoses, truths: list[Motion]) -> tuple[int, list[dict[str, Any]]]:
    """Number of the true person who is nearest, and a row per kind of landmark."""
    n = len(LANDMARKS)
    pairs = []
    for truth in truths:
        _, i, j = np.intersect1d(poses.frames, truth.frames, return_indices=True)
        estimate, places = poses.landmarks[i][:, :n], truth.landmarks[j][:, :n]
        pairs.append((float(np.nanmean(point_errors(estimate, places))), i, estimate, places))
    person = int(np.argmin([p[0] for p in pairs]))
    _, i, estimate, places = pairs[person]
    R, _ = joint_transforms(poses.body, poses.states[i])
    carrier = R[:, poses.body.landmark_joint[:n]]
    local = 1000.0 * np.einsum("tmji,tmj->tmi", carrier, estimate - places)
    error = point_errors(estimate, places)
    bias = np.array([local[error[:, m] < _FOUND_MM, m].mean(axis=0) for m in range(n)])
    rest = local - bias
    fast = rest - _running_mean(rest)
    rows = []
    kinds = [name.removeprefix("left_").removeprefix("right_") for name in LANDMARKS]
    for kind in (*dict.fromkeys(kinds), "all"):
        own = [m for m in range(n) if kind in (kinds[m], "all")]
        rows.append(
            {
                "landmark": kind,
                "raw_mm": float(np.nanmean(error[:, own])),
                "bias_mm": float(np.linalg.norm(bias[own], axis=1).mean()),
                "rest_mm": float(np.nanmean(np.linalg.norm(rest[:, own], axis=2))),
                "fast_mm": float(np.nanmean(np.linalg.norm(fast[:, own], axis=2))),
            }
        )
    scores = point_scores(estimate, places)
    rows[-1] |= {
        "after_offset_mm": float(np.nanmean(point_errors(offset_corrected(estimate, places), places))),
        "mmta_percent": scores.mmta_percent,
        "height_m": poses.body.height_m,
    }
    return person, rows


def _running_mean(values: Array) -> Array:
    """Mean over frames about each of values (T, M, 3)."""
    half = _FAST_FRAMES // 2
    padded = np.pad(np.nan_to_num(values), ((half, half), (0, 0), (0, 0)), mode="edge")
    summed = np.cumsum(np.concatenate([np.zeros((1, *values.shape[1:])), padded]), axis=0)
    return np.asarray((summed[_FAST_FRAMES:] - summed[:-_FAST_FRAMES]) / _FAST_FRAMES)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--only", default=",".join(SESSIONS), help="sessions, separated by commas")
    parser.add_argument("--bodies", default=",".join(BODIES))
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--work", type=Path, default=ROOT / "out" / "eval")
    parser.add_argument("--trust-store", action="store_true", help="take masks and volumes as they are")
    arguments = parser.parse_args()
    from mocap.io.tables import read_landmarks_csv

    rows: list[dict[str, Any]] = []
    for name in arguments.only.split(","):
        folder, out = prepare(name, arguments.work, trust_store=arguments.trust_store)
        truths = read_landmarks_csv(folder / "truth" / "landmarks.csv")
        for body in arguments.bodies.split(","):
            for seed in range(arguments.seeds):
                for poses in poses_of(folder, out, BODIES[body], seed):
                    person, own = rows_of(poses, truths)
                    known = {"session": name, "person": person, "body": body, "seed": seed}
                    rows += [known | row for row in own]
                    sys.stdout.write(f"{rows[-1]}\n")
                    sys.stdout.flush()
    done = {(r["session"], r["body"]) for r in rows}
    kept = []
    if RESULTS.exists():
        with RESULTS.open(encoding="utf-8", newline="") as stream:
            kept = [r for r in csv.DictReader(stream) if (r["session"], r["body"]) not in done]
    write_csv(RESULTS, FIELDS, [*kept, *(_rounded(row) for row in rows)])


def _rounded(row: dict[str, Any]) -> dict[str, Any]:
    return {
        f: round(v, 3 if f == "height_m" else 1) if isinstance(v := row.get(f, ""), float) else v
        for f in FIELDS
    }


if __name__ == "__main__":
    main()
