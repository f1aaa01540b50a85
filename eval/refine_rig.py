"""How well are cameras put right by people? Calibrations disturbed by 2 degrees and 3 cm, refined, against the truth.

    python -m eval.refine_rig                    # development scenes
    python -m eval.refine_rig --test             # the scenes kept for the final judgement
    python -m eval.refine_rig SESSION [...]      # sessions with an exact calibration
    python -m eval.refine_rig --poses            # and the poses, of the first draw (minutes a session)

Every camera is turned by 2 degrees about some axis and shifted by 3 cm in some direction (--turn-deg, --shift-mm).
Angles between pairs of cameras and places after the best fit of the whole rig are compared with the truth before and
after; `told` is the share of places within 2.5 of the stated deviations, `scale` what the whole rig is too small by.
A refusal of `mocap calibrate --refine` is a row with its reason. Writes
eval/results/refine_rig_{development,test}.csv (--name: another name).
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from itertools import combinations
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from eval.whole import write_csv
from mocap.arrays import Array
from mocap.data import Camera, CameraRig
from mocap.errors import MocapError
from mocap.io.calibration import write_calibration
from mocap.io.session import Session, open_session
from mocap.pipeline.config import load_config
from mocap.pipeline.refine import look_at, refine_from, write_refined
from mocap.pipeline.run import run_session
from mocap.synth import synthesise
from mocap.synth.scene import load_scene

RESULTS = Path(__file__).with_name("results")
DEVELOPMENT = ("walk", "gesture")
TEST = ("walk_final", "jog_test")
N_FRAMES = 150
WITHIN = 2.5  # standard deviations
Seen = tuple[list[list[Array]], int]  # what `look_at` gives
Row = dict[str, str | float | int | None]


def session_of(name: str, work: Path) -> Path:
    """A scene, filmed once, or the session itself."""
    if Path(name).is_dir():
        return Path(name)
    root = work / "sessions" / name
    if not (root / "calibration.toml").exists():
        synthesise(load_scene(name).model_copy(update={"n_frames": N_FRAMES}), root)
    return root


def disturbed(rig: CameraRig, turn_deg: float, shift_m: float, rng: np.random.Generator) -> CameraRig:
    """Every camera turned and shifted by so much in a direction of its own."""
    cameras = []
    for c in rig:
        turn, shift = (v / np.linalg.norm(v) for v in rng.normal(size=(2, 3)))
        R = Rotation.from_rotvec(np.radians(turn_deg) * turn).as_matrix() @ c.R
        cameras.append(
            Camera(c.name, c.size, c.K, c.dist, R, -R @ (c.center + shift_m * shift), c.is_fisheye)
        )
    return CameraRig(tuple(cameras))


def place_errors(rig: CameraRig, truth: CameraRig) -> tuple[Array, float]:
    """Distances (C,) m of the places after the best fit of the whole rig, and what it was too small by."""
    own, true = (np.array([c.center for c in cameras]) for cameras in (rig, truth))
    a, b = own - own.mean(axis=0), true - true.mean(axis=0)
    U, S, Vt = np.linalg.svd(b.T @ a)
    D = np.diag([1.0, 1.0, np.sign(np.linalg.det(U @ Vt))])
    factor = float((S * np.diag(D)).sum() / (a**2).sum())
    return np.linalg.norm(factor * a @ (U @ D @ Vt).T - b, axis=1), factor - 1


def pair_angles_deg(rig: CameraRig, truth: CameraRig) -> Array:
    """By how much the direction of one camera, as another sees it, is off, of all pairs."""
    off = [c.R.T @ t.R for c, t in zip(rig, truth, strict=True)]
    return np.array([np.degrees(Rotation.from_matrix(a.T @ b).magnitude()) for a, b in combinations(off, 2)])


def errors(rig: CameraRig, truth: CameraRig, word: str) -> Row:
    """Of a rig, as columns."""
    angles, (places, scale) = pair_angles_deg(rig, truth), place_errors(rig, truth)
    return {
        f"{word}_pair_deg": round(float(angles.mean()), 3),
        f"{word}_pair_worst_deg": round(float(angles.max()), 3),
        f"{word}_place_mm": round(1000 * float(places.mean()), 1),
        f"{word}_place_worst_mm": round(1000 * float(places.max()), 1),
        f"{word}_scale_percent": round(100 * scale, 2),
    }


def pose_error(root: Path, out: Path, calibration: Path) -> float | None:
    """Mean error of a run, mm; None where it is refused."""
    config = load_config("default", ("output.formats=[]",))
    try:
        run_session(root, out, config=config, calibration=calibration)
    except MocapError:
        return None
    scores = json.loads((out / "run.json").read_text(encoding="utf-8")).get("scores") or {}
    return round(scores["mean_error_mm"], 1)


def evaluate(session: Session, seen: Seen, seed: int, options: argparse.Namespace) -> Row:
    """One draw of one session."""
    root, truth, work = session.root, session.rig, options.work
    rng = np.random.default_rng([seed, *root.name.encode()])
    wrong = disturbed(truth, options.turn_deg, options.shift_mm / 1000, rng)
    folder = work / "calibrations"
    folder.mkdir(parents=True, exist_ok=True)
    before, after = (folder / f"{root.name}_{seed}_{word}.toml" for word in ("before", "after"))
    write_calibration(before, wrong)
    after.unlink(missing_ok=True)
    row: Row = {"session": root.name, "seed": seed, **errors(wrong, truth, "before")}
    try:
        refined = refine_from(open_session(root, calibration=before), *seen, options.height_m)
    except MocapError as error:
        return row | dict.fromkeys(errors(wrong, truth, "after"), None) | {"refused": error.message}
    row |= errors(refined.rig, truth, "after")
    moves = refined.refinement.moves.values()
    stated = np.sqrt(3) * np.array([move.shift_std_m for move in moves])
    row["stated_place_mm"] = round(1000 * float(stated.mean()), 1)
    row["told"] = round(float((place_errors(refined.rig, truth)[0] < WITHIN * stated).mean()), 2)
    write_refined(after, refined)
    if options.poses and seed == 0:
        write_calibration(folder / f"{root.name}_true.toml", truth)
        true = folder / f"{root.name}_true.toml"
        for word, path in (("before", before), ("after", after), ("true", true)):
            row[f"{word}_pose_mm"] = pose_error(root, work / "runs" / f"{root.name}_{word}", path)
    return row


def main(arguments: Sequence[str] | None = None) -> int:
    """Write the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("sessions", nargs="*", help="scenes, or folders of sessions; default: all")
    parser.add_argument("--test", action="store_true", help="the scenes kept for the final judgement")
    parser.add_argument("--poses", action="store_true", help="and poses of the first draw")
    parser.add_argument("--seeds", type=int, default=3, help="draws of errors per session")
    parser.add_argument("--turn-deg", type=float, default=2.0)
    parser.add_argument("--shift-mm", type=float, default=30.0)
    parser.add_argument("--height-m", type=float, help="of the person, who sets the scale")
    parser.add_argument(
        "--work", type=Path, default=Path("out/refine_rig"), help="sessions and runs go there"
    )
    parser.add_argument("--name", help="of the table")
    options = parser.parse_args(arguments)
    rows = []
    for name in options.sessions or (TEST if options.test else DEVELOPMENT):
        session = open_session(session_of(name, options.work))
        seen = look_at(session, n_threads=1)
        for seed in range(options.seeds):
            rows.append(evaluate(session, seen, seed, options))
            print(rows[-1], flush=True)
    columns = list(dict.fromkeys(key for row in rows for key in row))
    table = options.name or ("test" if options.test else "development")
    write_csv(RESULTS / f"refine_rig_{table}.csv", columns, [dict.fromkeys(columns) | row for row in rows])
    return 0


if __name__ == "__main__":
    sys.exit(main())
