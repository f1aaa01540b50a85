"""Anatomical angles against the truth of own scenes, in degrees: root mean square error, offset, coverage.

    python -m eval.angles [--only walk,walk_test] [--seeds 1] [--fit] [--work out/eval]

Runs the default preset on whole scenes, masks from the videos, as a user would (the runs of `eval.feet`), and compares
the angles of its poses with the true orientations of the segments (truth/pose_N.npz), nothing aligned. Writes
eval/results/angles.csv and the table of docs/angles.md: one row per scene, seed and angle. With --fit it prints the
constants `ANGLE_UNCERTAINTY` of mocap/pose/method.py, from development scenes alone.

`dev:steps` and `dev:furnished` are realistic development sessions. Their truth tells how segments have turned since a
rest pose in which arms are neither hanging nor straight out: angles of trunk and legs but for a constant, none of arms.
"""

from __future__ import annotations

import argparse
import csv
import sys
from collections.abc import Iterator
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any

import numpy as np

from eval.feet import run
from eval.pose_sessions import ROOT
from eval.whole import write_csv, write_text
from mocap.compare.angles import AngleError, angle_errors, true_angles
from mocap.compare.match import associate_persons
from mocap.data import AngleSeries
from mocap.geometry.rigid import wrap_angle
from mocap.io.session import open_session
from mocap.io.store import StageStore
from mocap.io.tables import read_landmarks_csv
from mocap.metrics.anatomy import anatomical_angles
from mocap.pose.angles import angles_of
from mocap.pose.method import AngleSettings
from mocap.products.poses import stored_poses

RESULTS = ROOT / "eval" / "results" / "angles.csv"
PAGE, BEGIN, END = ROOT / "docs" / "angles.md", "<!-- table -->", "<!-- end of table -->"
DEVELOPMENT = ("walk", "gesture", "jog", "squat", "jump")
REALISTIC = ("dev:steps", "dev:furnished")
TEST = ("walk_test", "gesture_test", "jog_test", "squat_test", "jump_test")
FIELDS = ("set", "session", "seed", "person", *(field.name for field in fields(AngleError)))
_LOOKS_ALONG_MINUS_Y = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
_OF_ARMS = ("upper_arm", "forearm", "hand")
LEVEL, WIDTH = 0.9, 1.6449  # of a region, and its half width in standard deviations
_MEASURES = ("rmse_deg", "rmse_after_offset_deg", "coverage_90_percent")
SHOWN = (
    *("left_hip_flexion", "right_hip_flexion", "left_knee_flexion", "right_knee_flexion"),
    *("pelvis_tilt", "trunk_flexion", "left_elbow_flexion", "right_elbow_flexion"),
)


def truth_of(session: Path, fps: float) -> list[AngleSeries]:
    """The true angles of a session's persons."""
    path = session / "truth" / "segments.npz"
    if not path.exists():
        return true_angles(session / "truth", fps)
    # In their rest pose people look along -y.
    turned = {name.removeprefix("person_1_"): R @ _LOOKS_ALONG_MINUS_Y for name, R in np.load(path).items()}
    angles = anatomical_angles({s: R for s, R in turned.items() if not s.endswith(_OF_ARMS)})
    frames = np.arange(len(turned["pelvis"]), dtype=np.int64)
    return [AngleSeries(1, tuple(angles), frames, frames / fps, np.stack(list(angles.values()), axis=1))]


def pairs_of(session: Path, out: Path, settings: AngleSettings) -> Iterator[tuple[AngleSeries, AngleSeries]]:
    """Estimated and true angles of every true person who was found."""
    fps = open_session(session).fps
    truth = {s.person: s for s in truth_of(session, fps)}
    found = {p.person: angles_of(p, fps, settings) for p in stored_poses(StageStore(out / "store.zarr"))}
    both = associate_persons(
        read_landmarks_csv(out / "landmarks.csv"), read_landmarks_csv(session / "truth" / "landmarks.csv")
    )
    for estimate, true in both:
        if estimate is not None:
            yield found[estimate.person], truth[true.person]


def rows_of(name: str, seed: int, work: Path) -> Iterator[dict[str, Any]]:
    """Rows of the table of one run."""
    which = "realistic" if name in REALISTIC else "test" if name in TEST else "development"
    for estimate, truth in pairs_of(*run(name, seed, "whole", work), AngleSettings()):
        for error in angle_errors(estimate, truth):
            numbers = {k: round(v, 3) if isinstance(v, float) else v for k, v in asdict(error).items()}
            yield {"set": which, "session": name, "seed": seed, "person": truth.person, **numbers}


def fit(runs: list[tuple[str, int]], work: Path) -> dict[str, tuple[float, float]]:
    """Kind of angle -> floor in degrees and factor on what follows from the landmarks, so that the regions of every
    scene hold what they should; every run weighs the same, and of equals the narrowest is taken."""
    found: dict[str, list[tuple[np.ndarray, np.ndarray]]] = {}
    bare = AngleSettings(of_angle={}, of_others=(0.0, 1.0))
    for name, seed in runs:
        for estimate, truth in pairs_of(*run(name, seed, "whole", work), bare):
            _, i, j = np.intersect1d(estimate.frames, truth.frames, return_indices=True)
            for a, angle in enumerate(estimate.names):
                kind = angle.removeprefix("left_").removeprefix("right_")
                if estimate.observed is not None and not estimate.observed[:, a].any():
                    continue  # inferred: synthetic people share every bend of the spine alike
                error = np.rad2deg(wrap_angle(estimate.values[i, a] - truth.of(angle)[j]))
                assert estimate.std is not None
                found.setdefault(kind, []).append((np.abs(error), np.rad2deg(estimate.std[i, a])))
    out = {}
    for kind, both in found.items():
        costs = {}
        for floor in np.arange(0.5, 15.01, 0.5):
            for factor in np.arange(0.0, 1.01, 0.1):
                std = [np.sqrt(floor**2 + (factor * s) ** 2) for _, s in both]
                held = [float((e <= WIDTH * s).mean()) for (e, _), s in zip(both, std, strict=True)]
                wide = float(np.mean([s.mean() for s in std]))
                costs[round(floor, 1), round(factor, 1)] = abs(np.mean(held) - LEVEL) + 0.002 * wide
        out[kind] = min(costs, key=costs.__getitem__)
    return out


def page_table(rows: list[dict[str, Any]]) -> str:
    """Means over runs and both sides, by kind of angle, as the table of docs/angles.md."""
    shown = {"development": _MEASURES, "test": _MEASURES, "realistic": _MEASURES[1:2]}
    names = {which: sorted({r["session"] for r in rows if r["set"] == which}) for which in shown}
    lines = [
        f"Development: {', '.join(names['development'])}; test: {', '.join(names['test'])}; realistic: "
        f"{', '.join(names['realistic'])}. Held: share of frames whose 90 % region holds the truth.",
        "",
        "| angle | RMSE | after offset | held, % | test: RMSE | after offset | held, % | realistic: after offset |",
        "|---|---|---|---|---|---|---|---|",
    ]
    kinds = dict.fromkeys(str(r["angle"]).removeprefix("left_").removeprefix("right_") for r in rows)
    for kind in kinds:
        cells = []
        for which in names:
            both = (kind, f"left_{kind}", f"right_{kind}")
            own = [r for r in rows if r["set"] == which and r["angle"] in both]
            for key in shown[which]:
                cells.append(f"{np.mean([float(r[key]) for r in own]):.1f}" if own else "-")
        lines.append(f"| {kind} | {' | '.join(cells)} |")
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--only", help="scenes, separated by commas")
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--fit", action="store_true", help="print constants fitted to development scenes")
    parser.add_argument("--work", type=Path, default=ROOT / "out" / "eval")
    arguments = parser.parse_args()
    names = arguments.only.split(",") if arguments.only else [*DEVELOPMENT, *TEST, *REALISTIC]
    runs = [(name, seed) for name in names for seed in range(arguments.seeds)]
    if arguments.fit:
        if set(names) - set(DEVELOPMENT):
            parser.error("nothing is fitted on held-out scenes: give --only development ones")
        for kind, value in fit(runs, arguments.work).items():
            sys.stdout.write(f'    "{kind}": ({value[0]:.1f}, {value[1]:.1f}),\n')
        return
    rows = []
    for name, seed in runs:
        own = list(rows_of(name, seed, arguments.work))
        rows += own
        by_angle = {row["angle"]: row for row in own}
        words = [f"{a} {by_angle[a]['rmse_deg']:.1f}" for a in SHOWN if a in by_angle]
        sys.stdout.write(f"{name} seed {seed}: RMSE deg: {', '.join(words)}\n")
        sys.stdout.flush()
    kept = []
    if RESULTS.exists():
        done = {(name, str(seed)) for name, seed in runs}
        with RESULTS.open(encoding="utf-8", newline="") as stream:
            kept = [r for r in csv.DictReader(stream) if (r["session"], r["seed"]) not in done]
    write_csv(RESULTS, FIELDS, [*kept, *rows])
    head, _, rest = PAGE.read_text("utf-8").partition(BEGIN)
    write_text(PAGE, f"{head}{BEGIN}\n{page_table([*kept, *rows])}\n{END}{rest.partition(END)[2]}")


if __name__ == "__main__":
    main()
