"""Realistic sessions against what is aimed at: the presets, and a pose network with triangulation beside them.

    python -m eval.accuracy [--seeds 5] [--only dev:walk,dev:cross] [--methods best] [--work out/eval]

Pose stage alone on masks, volumes and tracks that are made once per session (as `eval.pose_ablation` does), all
cameras. `network` is plain triangulation of MediaPipe's detections, landmarks filtered at 6 Hz (Butterworth, second
order, forwards and backwards), which needs no seed. A row per person, method and seed; means over 15 landmarks, mm:

    raw, after_offset       as they are, and in the other frames after one offset per landmark learnt on the first ten
    mmta_percent            landmarks within 100 mm
    lost_wrist_percent      frames in which a wrist lies more than 150 mm away
    shoulder, hip           raw
    jitter                  mean length of the third derivative, m/s^3, and the truth's
    height_error            of the body that was found, mm

Writes eval/results/accuracy.csv, whole, and its table into docs/accuracy.md, when all sessions are run with all
methods.
Rows in WORK/accuracy are kept for the same program; --again makes them anew.
"""

from __future__ import annotations

import argparse
import json
import os
from collections.abc import Sequence
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from eval.pose_ablation import SESSIONS, poses_of, prepare, session_folder
from eval.pose_sessions import DEV, ROOT
from eval.triangulation import triangulated
from eval.whole import kept_rows, with_table, write_csv, write_text
from mocap.arrays import Array
from mocap.data import LANDMARKS, Motion
from mocap.io.session import open_session
from mocap.io.tables import read_landmarks_csv
from mocap.metrics.points import OFFSET_FRAMES, offset_corrected, point_errors
from mocap.metrics.smoothness import smoothness_scores
from mocap.pipeline.config import load_config
from mocap.pose.result import motion_of

RESULTS = ROOT / "eval" / "results" / "accuracy.csv"
PAGE = ROOT / "docs" / "accuracy.md"
METHODS = ("network", "default", "best")
MEASURES = (
    *("raw", "after_offset", "mmta_percent", "lost_wrist_percent", "shoulder", "hip"),
    *("jitter", "jitter_truth", "height_error"),
)
FIELDS = ("session", "person", "method", "seed", *MEASURES)
N = len(LANDMARKS)
FILTER_HZ, FILTER_ORDER = 6.0, 2
_FOUND_MM, _LOST_WRIST_MM = 100.0, 150.0
Row = dict[str, Any]


def filtered(motion: Motion, fps: float) -> Motion:
    """Landmarks through a low pass without lag; places between known ones are interpolated for it, and stay unknown."""
    from scipy.signal import butter, filtfilt

    frames = np.arange(motion.frames[0], motion.frames[-1] + 1)
    series = np.full((len(frames), *motion.landmarks.shape[1:]), np.nan)
    series[motion.frames - frames[0]] = motion.landmarks
    b, a = butter(FILTER_ORDER, FILTER_HZ, fs=fps)
    for m in range(series.shape[1]):
        known = np.asarray(np.isfinite(series[:, m]).all(axis=1))
        if known.sum() > 3 * max(len(a), len(b)):
            own = np.column_stack([np.interp(frames, frames[known], series[known, m, k]) for k in range(3)])
            series[:, m] = np.where(known[:, None], filtfilt(b, a, own, axis=0), np.nan)
    return Motion(motion.person, frames, frames / fps, series)


def measures(found: Motion, truth: Motion, fps: float) -> Row:
    """The columns of one person, over the frames of the truth; what is missing is no error, but not within 100 mm."""
    frames, i, j = np.intersect1d(found.frames, truth.frames, return_indices=True)
    x, y = found.landmarks[i][:, :N], truth.landmarks[j][:, :N]
    raw = point_errors(x, y)
    after = point_errors(offset_corrected(x, y, OFFSET_FRAMES)[OFFSET_FRAMES:], y[OFFSET_FRAMES:])

    def kind(word: str) -> list[int]:
        return [LANDMARKS.index(f"{side}_{word}") for side in ("left", "right")]

    wrists = raw[:, kind("wrist")]
    smooth = smoothness_scores(x, y, frames, fps)
    return {
        "raw": float(np.nanmean(raw)),
        "after_offset": float(np.nanmean(after)),
        "mmta_percent": 100.0 * float((raw <= _FOUND_MM).sum()) / (len(truth.frames) * N),
        "lost_wrist_percent": 100.0 * float((~(wrists <= _LOST_WRIST_MM)).any(axis=1).mean()),
        "shoulder": float(np.nanmean(raw[:, kind("shoulder")])),
        "hip": float(np.nanmean(raw[:, kind("hip")])),
        "jitter": smooth.jitter_estimate_m_s3,
        "jitter_truth": smooth.jitter_truth_m_s3,
    }


def apart_mm(found: Motion, truth: Motion) -> float:
    """Median distance of two motions, infinite where they have nothing in common."""
    _, i, j = np.intersect1d(found.frames, truth.frames, return_indices=True)
    errors = point_errors(found.landmarks[i][:, :N], truth.landmarks[j][:, :N])
    return float(np.nanmedian(errors)) if np.isfinite(errors).any() else np.inf


def of_network(name: str, work: Path) -> tuple[list[tuple[Motion, float | None]], float]:
    """Filtered motions of the network, and the frame rate."""
    source, folder = session_folder(name, work), work / "accuracy" / f"{name.replace(':', '_')}_keypoints"
    folder.mkdir(parents=True, exist_ok=True)
    for word, target in {
        "calibration.toml": source / "calibration.toml",
        "keypoints": DEV / "keypoints" / source.name,
    }.items():
        if not (folder / word).exists():
            os.symlink(target.resolve(), folder / word)
    fps = open_session(source).fps
    write_text(folder / "session.toml", f"fps = {fps}\n")
    return [(filtered(motion, fps), None) for motion in triangulated(folder)[0]], fps


def of_preset(
    name: str, preset: str, seed: int, work: Path, *, trust_store: bool
) -> tuple[list[tuple[Motion, float | None]], float]:
    """Motions of a preset's poses, with the heights that were found, and the frame rate."""
    folder, out = prepare(name, work, trust_store=trust_store)
    session, poses = poses_of(folder, out, load_config(preset), seed)
    return [(motion_of(p, session.fps), p.body.height_m) for p in poses], session.fps


def rows_of(name: str, method: str, seed: int, work: Path, *, trust_store: bool) -> list[Row]:
    """A row per true person; of one who is not found nothing but that."""
    if method == "network":
        found, fps = of_network(name, work)
    else:
        found, fps = of_preset(name, method, seed, work, trust_store=trust_store)
    folder = session_folder(name, work) / "truth"
    heights = [
        float(p["height_m"])
        for p in json.loads((folder / "truth.json").read_text(encoding="utf-8"))["persons"]
    ]
    rows: list[Row] = []
    for k, truth in enumerate(read_landmarks_csv(folder / "landmarks.csv")):
        row: Row = {"session": name, "person": k + 1, "method": method, "seed": seed}
        if found:
            nearest, height_m = min(found, key=lambda one: apart_mm(one[0], truth))
            if apart_mm(nearest, truth) < 2 * _FOUND_MM:
                row |= measures(nearest, truth, fps)
                if height_m is not None:
                    row["height_error"] = 1000.0 * (height_m - heights[k])
        told = {f: f"{v:.1f}" if isinstance(v, float) else v for f, v in row.items()}
        rows.append(dict.fromkeys(FIELDS, "") | told)
    return rows


def mean_of(rows: Sequence[Row], measure: str) -> float:
    """Mean over the rows that have the measure; of heights without their sign."""
    values: Array = np.array([float(row[measure]) for row in rows if row.get(measure) not in (None, "")])
    if not len(values):
        return np.nan
    return float((np.abs(values) if measure == "height_error" else values).mean())


def table(rows: Sequence[Row]) -> str:
    """A line per person and method, means over seeds, and the mean of all persons."""
    heads = (
        *("raw, mm", "after offset, mm", "MMTA, %", "lost wrist, %", "shoulders, mm", "hips, mm"),
        *("jitter, m/s³", "of the truth", "height, mm"),
    )
    lines = [f"| person | method | {' | '.join(heads)} |", "|---|---" + "|---" * len(heads) + "|"]
    persons = list(dict.fromkeys((row["session"], str(row["person"])) for row in rows))
    for person, method in product([*persons, None], METHODS):
        own = [
            row
            for row in rows
            if row["method"] == method and person in (None, (row["session"], str(row["person"])))
        ]
        if own:
            several = person is not None and sum(p[0] == person[0] for p in persons) > 1
            word = "mean" if person is None else f"{person[0]}, {person[1]}" if several else person[0]
            values = [mean_of(own, measure) for measure in MEASURES]
            texts = ["-" if np.isnan(v) else f"{v:.1f}" for v in values]
            lines.append(f"| {word} | {method} | {' | '.join(texts)} |")
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--only", help="sessions, separated by commas; then nothing is written")
    parser.add_argument("--methods", default=",".join(METHODS), help="likewise")
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--work", type=Path, default=ROOT / "out" / "eval")
    parser.add_argument("--trust-store", action="store_true", help="take masks and volumes as they are")
    parser.add_argument("--again", action="store_true", help="make rows anew")
    options = parser.parse_args()
    names = options.only.split(",") if options.only else SESSIONS
    rows: list[Row] = []
    for name, method, seed in product(names, options.methods.split(","), range(options.seeds)):
        if method == "network" and seed > 0:
            continue
        kept = options.work / "accuracy" / f"{name.replace(':', '_')}_{method}_{seed}.csv"
        make = partial(rows_of, name, method, seed, options.work, trust_store=options.trust_store)
        rows += kept_rows(kept, FIELDS, make, again=options.again)
    if not options.only and options.methods == parser.get_default("methods"):
        write_csv(RESULTS, FIELDS, rows)
        write_text(PAGE, with_table(PAGE.read_text(encoding="utf-8"), "accuracy", table(rows)))


if __name__ == "__main__":
    main()
