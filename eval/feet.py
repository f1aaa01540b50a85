"""Feet against the truth: how far planted feet move, strikes and offs in frames, heels, toes and hand tips; jumps and
squats.

    python -m eval.feet [--only walk,jog] [--seeds 3] [--bodies whole,whole-free] [--work out/eval]

Runs the default preset on whole scenes, masks from the videos, with the default body (`whole`) and with its feet not
held on the floor (`whole-free`); stages before the poses are computed once per scene. Writes eval/results/feet.csv: one
row per scene, seed and body. `dev:NAME` is a realistic development session. What the hold brings is told by two scenes:
the file has `whole-free` of walk and dev:steps alone. Another body is `girdle` (no feet, and outlines at 3, as when it
was the default), which the file does not have.
"""

from __future__ import annotations

import argparse
import csv
import shutil
import sys
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from eval.pose_sessions import ROOT
from eval.whole import write_csv
from mocap.compare import CompareOptions, compare
from mocap.data.motion import ALL_LANDMARKS, FURTHER_LANDMARKS, LANDMARKS
from mocap.io.tables import FEET_AND_HANDS, FeetAndHands, read_feet_and_hands_csv, read_landmarks_csv
from mocap.pose.contacts import SOLE_POINTS, contacts_of, slips_m, unbroken_runs
from mocap.pose.method import ContactSettings
from mocap.pose.moves import find_moves

Array = NDArray[np.float64]

RESULTS = ROOT / "eval" / "results" / "feet.csv"
DEV = ROOT.parent / "shared" / "dev_sessions"
SCENES = ("walk", "jog", "squat", "jump", "dev:steps", "walk_test", "jog_test", "squat_test", "jump_test")
BODIES = {
    "girdle": ("body.model=girdle", "pose.outline_weight=3"),
    "whole": (),
    "whole-free": ("method.contact.hold=0",),
}
KINDS = ("heel", "toe", "hand_tip")
FIELDS = (
    *("session", "seed", "body", "mean_error_mm", "mean_error_after_offset_mm", "legs_mm"),
    *(f"{kind}_mm" for kind in KINDS),
    *(
        "slip_mm",
        "largest_slip_mm",
        "true_slip_mm",
        "n_strikes",
        "strikes_within_1",
        "n_offs",
        "offs_within_1",
    ),
    *("n_moves", "moves_found", "move_height_mm"),
)
# Columns of the truth's heels and toes, in the order of SOLE_POINTS.
OF_TRUTH = [FURTHER_LANDMARKS.index(ALL_LANDMARKS[k]) for k in SOLE_POINTS]
_LEGS = ("left_knee", "left_ankle", "right_knee", "right_ankle")


def run(name: str, seed: int, body: str, work: Path) -> tuple[Path, Path]:
    """Session and output folder of a run; what is there already is taken."""
    from mocap.pipeline.config import load_config
    from mocap.pipeline.run import run_session
    from mocap.synth import synthesise

    plain = name.replace(":", "_")
    session = DEV / name.removeprefix("dev:") if name.startswith("dev:") else work / "sessions" / name
    out = work / "feet" / f"{plain}_{seed}_{body}"
    if not session.exists():
        synthesise(name, session, workers=1)
    if not (out / "run.json").exists():
        others = (work / "feet" / f"{plain}_{s}_{b}" for s in range(seed + 1) for b in BODIES)
        done = next((o for o in others if (o / "run.json").exists()), None)
        if done is not None:
            shutil.copytree(done, out, ignore=shutil.ignore_patterns(".lock"))
        settings = ("output.formats=[]", *BODIES[body])
        run_session(session, out, config=load_config("default", settings), seed=seed, resume=done is not None)
    return session, out


def row_of(name: str, seed: int, body: str, work: Path) -> dict[str, Any]:
    """The table's row of one run."""
    session, out = run(name, seed, body, work)
    scores = compare(out, session, CompareOptions()).scores
    per_landmark, further = scores["per_landmark_mm"], scores["per_further_landmark_mm"] or {}
    row = {"session": name, "seed": seed, "body": body}
    row |= {key: round(scores[key], 2) for key in ("mean_error_mm", "mean_error_after_offset_mm")}
    row["legs_mm"] = round(float(np.mean([per_landmark[n] for n in _LEGS])), 2)
    for kind in KINDS:
        own = [further[f"{side}_{kind}"] for side in ("left", "right") if f"{side}_{kind}" in further]
        row[f"{kind}_mm"] = round(float(np.mean(own)), 1) if own else ""
    motions = read_landmarks_csv(out / "landmarks.csv")
    if (session / "truth" / FEET_AND_HANDS).exists() and motions[0].names == ALL_LANDMARKS:
        (truth,) = read_feet_and_hands_csv(session / "truth" / FEET_AND_HANDS)
        _, i, j = np.intersect1d(motions[0].frames, truth.frames, return_indices=True)
        fps = 1.0 / float(np.median(np.diff(motions[0].time_s)))
        row |= foot_scores(motions[0].landmarks[i], truth, j, fps)
        (of_truth,) = read_landmarks_csv(session / "truth" / "landmarks.csv")
        row |= move_scores(motions[0].landmarks[i], of_truth.landmarks[j], truth, j, fps)
    return row


def resting(landmarks: Array, fps: float) -> NDArray[np.bool_]:
    """(T, 4), where heels and toes of landmarks (T, 21, 3) m are found to rest, in the order of SOLE_POINTS."""
    sole = landmarks[:, list(SOLE_POINTS)]
    return contacts_of(sole, np.zeros(sole.shape[:2]), fps, ContactSettings()).probability > 0.5


def move_scores(
    landmarks: Array, true: Array, truth: FeetAndHands, rows: NDArray[np.int64], fps: float
) -> dict[str, Any]:
    """Jumps and squats of landmarks (T, 21, 3) m against those of the truth (T, 15, 3) m: how many of them were found
    where their extremes are within three frames, and how far their heights are off; nothing where the truth has none.
    """
    pelvis, knee = LANDMARKS.index("pelvis"), np.zeros(len(rows))
    own = find_moves(landmarks[:, pelvis, 2], resting(landmarks, fps), knee, fps)
    wanted = find_moves(true[:, pelvis, 2], truth.in_contact[rows][:, OF_TRUTH], knee, fps)
    pairs = [(a, b) for a in wanted for b in own if a.kind == b.kind and abs(a.extreme - b.extreme) <= 3]
    if not wanted and not own:
        return {}
    off = [abs(a.height_m - b.height_m) for a, b in pairs]
    return {
        "n_moves": len(wanted),
        "moves_found": f"{len(pairs)} of {len(own)}",
        "move_height_mm": round(1000 * float(np.mean(off)), 1) if off else "",
    }


def foot_scores(landmarks: Array, truth: FeetAndHands, rows: NDArray[np.int64], fps: float) -> dict[str, Any]:
    """Slips in the contacts of the truth and moments of strikes and offs, of landmarks (T, 21, 3) m on rows (T,)."""
    points, in_contact = landmarks[:, list(SOLE_POINTS)], truth.in_contact[rows][:, OF_TRUTH]
    assert len(LANDMARKS) == min(SOLE_POINTS)
    runs = [unbroken_runs(own) for own in in_contact.T]
    slips, true_slips = 1000 * slips_m(points, runs), 1000 * slips_m(truth.xyz[rows][:, OF_TRUTH], runs)
    found = resting(landmarks, fps)
    strikes, offs = [], []
    for foot in (slice(0, 2), slice(2, 4)):
        down = np.asarray(found[:, foot].any(axis=1))
        true_down = np.asarray(in_contact[:, foot].any(axis=1))
        true_runs = whole_stances(true_down)
        own_runs = whole_stances(down)
        strikes += _distances([r[0] for r in true_runs if r[0] > 0], [r[0] for r in own_runs])
        last = len(down) - 1
        offs += _distances([r[-1] for r in true_runs if r[-1] < last], [r[-1] for r in own_runs])
    return {
        "slip_mm": round(float(slips.mean()), 1),
        "largest_slip_mm": round(float(slips.max()), 1),
        "true_slip_mm": round(float(true_slips.mean()), 1),
        "n_strikes": len(strikes),
        "strikes_within_1": sum(d <= 1 for d in strikes),
        "n_offs": len(offs),
        "offs_within_1": sum(d <= 1 for d in offs),
    }


def whole_stances(down: NDArray[np.bool_], gap_frames: int = 3) -> list[NDArray[np.int64]]:
    """Stances of a foot that is down (T,): gaps of a few frames, in which a threshold toggles, are closed."""
    closed = down.copy()
    for gap in unbroken_runs(~down):
        if len(gap) <= gap_frames and gap[0] > 0 and gap[-1] < len(down) - 1:
            closed[gap] = True
    return unbroken_runs(closed)


def _distances(true: list[Any], found: list[Any]) -> list[float]:
    """How far each true moment is from the nearest found one, frames."""
    return [float(min((abs(int(t) - int(f)) for f in found), default=np.inf)) for t in true]


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--only", help="scenes, separated by commas")
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--bodies", default="whole")
    parser.add_argument("--work", type=Path, default=ROOT / "out" / "eval")
    arguments = parser.parse_args()
    names = arguments.only.split(",") if arguments.only else list(SCENES)
    runs = [(n, s, b) for n in names for s in range(arguments.seeds) for b in arguments.bodies.split(",")]
    rows = []
    for name, seed, body in runs:
        rows.append(row_of(name, seed, body, arguments.work))
        sys.stdout.write(f"{rows[-1]}\n")
        sys.stdout.flush()
    kept = []
    if RESULTS.exists():
        done = {(n, str(s), b) for n, s, b in runs}
        with RESULTS.open(encoding="utf-8", newline="") as stream:
            kept = [r for r in csv.DictReader(stream) if (r["session"], r["seed"], r["body"]) not in done]
    write_csv(RESULTS, FIELDS, [*kept, *({f: row.get(f, "") for f in FIELDS} for row in rows)])


if __name__ == "__main__":
    main()
