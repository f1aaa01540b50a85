"""How well are cameras put right by people? Calibrations disturbed by 2 degrees and 3 cm, refined, against the truth.

    python -m eval.refine_rig                    # development scenes
    python -m eval.refine_rig --test             # the scenes kept for the final judgement
    python -m eval.refine_rig SESSION [...]      # sessions with an exact calibration
    python -m eval.refine_rig --poses            # and the poses, of the first draw (minutes a session)
    python -m eval.refine_rig --moved            # one camera at a time, pushed in mid-take

Every camera is turned by 2 degrees about some axis and shifted by 3 cm in some direction (--turn-deg, --shift-mm).
Angles between pairs of cameras and places after the best fit of the whole rig are compared with the truth before and
after; `told` is the share of places within 2.5 of the stated deviations, `scale` what the whole rig is too small by.
A refusal of `mocap calibrate --refine` is a row with its reason. Writes
eval/results/refine_rig_{development,test}.csv (--name: another name).

With --moved every camera of a session is pushed in turn, --seeds times, by up to 5 degrees and 5 cm, at two fifths of
the clip: its calibration is put off by as much, and `mocap calibrate --refine --moved` finds it from there on. With
--poses a scene is filmed anew with a camera pushed by 3 degrees and 3 cm, and run without the push (`unharmed`), with
the camera left out from there on (`left_out`) and found again (`mended`). Writes moved_camera_{development,test}.csv.
"""

from __future__ import annotations

import argparse
import json
import shutil
import sys
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import combinations
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from eval.session_tables import N_FRAMES, Row, names_of, session_of, session_parser, write_table
from mocap.arrays import Array
from mocap.data import Camera, CameraRig
from mocap.errors import MocapError
from mocap.io.calibration import write_calibration
from mocap.io.session import Session, open_session
from mocap.io.store import StageStore
from mocap.pipeline.config import load_config
from mocap.pipeline.refine import (
    look_at,
    moved_from,
    refine_from,
    refine_moved,
    write_moved,
    write_refined,
)
from mocap.pipeline.stages.carve import SWINGS
from mocap.pipeline.stretches import run_recording
from mocap.products.hulls import stored_faults
from mocap.synth import synthesise
from mocap.synth.scene import load_scene

DEVELOPMENT = ("walk", "gesture")
TEST = ("walk_final", "jog_test")
WITHIN = 2.5  # standard deviations
MOST_TURN_DEG, MOST_SHIFT_M = 5.0, 0.05  # of a push
PUSHED_AT = 0.4  # of the clip
MOVED_COLUMNS = ("off_deg", "off_mm", "stated_deg", "stated_mm", "told")
Seen = tuple[list[list[Array]], int]  # what `look_at` gives


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


def fitted_places(rig: CameraRig, truth: CameraRig) -> tuple[Array, float]:
    """Places (C, 3) m of the cameras after the best fit of the whole rig, and the factor by which it had to grow."""
    own, true = (np.array([c.center for c in cameras]) for cameras in (rig, truth))
    a, b = own - own.mean(axis=0), true - true.mean(axis=0)
    U, S, Vt = np.linalg.svd(b.T @ a)
    D = np.diag([1.0, 1.0, np.sign(np.linalg.det(U @ Vt))])
    factor = float((S * np.diag(D)).sum() / (a**2).sum())
    return factor * a @ (U @ D @ Vt).T + true.mean(axis=0), factor


def place_errors(rig: CameraRig, truth: CameraRig) -> tuple[Array, float]:
    """Distances (C,) m of the places after the best fit of the whole rig, and what it was too small by."""
    places, factor = fitted_places(rig, truth)
    return np.linalg.norm(places - np.array([c.center for c in truth]), axis=1), factor - 1


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


def pose_error(root: Path, out: Path, calibration: Path | None = None) -> float | None:
    """Mean error of a run, mm; None where it is refused."""
    config = load_config("default", ("output.formats=[]",))
    try:
        run_recording(root, out, config=config, calibration=calibration)
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


def evaluate_moved(session: Session, seen: Seen, camera: str, seed: int) -> Row:
    """One camera, pushed once."""
    truth = session.rig
    rng = np.random.default_rng([seed, *camera.encode(), *session.root.name.encode()])
    turn_deg, shift_m = rng.uniform(1.0, MOST_TURN_DEG), rng.uniform(0.0, MOST_SHIFT_M)
    (pushed,) = disturbed(truth.subset([camera]), turn_deg, shift_m, rng)
    rig = CameraRig(tuple(pushed if own.name == camera else own for own in truth))
    row: Row = {
        "session": session.root.name,
        "camera": camera,
        "seed": seed,
        "turned_deg": round(turn_deg, 2),
        "shifted_mm": round(1000 * shift_m, 1),
    }
    try:
        found = moved_from(replace(session, rig=rig), camera, *seen).refinement
    except MocapError as error:
        return row | dict.fromkeys(MOVED_COLUMNS) | {"refused": error.message}
    move = found.moves[camera]
    off_deg, off_m = off(found.rig[camera], truth[camera])
    stated_deg, stated_m = np.sqrt(3) * move.turn_std_deg, np.sqrt(3) * move.shift_std_m
    told = off_deg < WITHIN * stated_deg and off_m < WITHIN * stated_m
    values = (off_deg, 1000 * off_m, stated_deg, 1000 * stated_m, float(told))
    return (
        row
        | {key: round(float(v), 3) for key, v in zip(MOVED_COLUMNS, values, strict=True)}
        | {"refused": None}
    )


def off(camera: Camera, truth: Camera) -> tuple[float, float]:
    """Degrees and metres by which one camera looks and stands elsewhere than the other."""
    turned = Rotation.from_matrix(camera.R @ truth.R.T).magnitude()
    return float(np.degrees(turned)), float(np.linalg.norm(camera.center - truth.center))


def moved_poses(name: str, work: Path) -> Row:
    """Poses of a scene in which a camera is pushed, against those of its twin in which none is."""
    twin, root = session_of(name, work), work / "sessions" / f"{name}_pushed"
    rig = open_session(twin).rig
    rng = np.random.default_rng([*name.encode()])
    camera = rig.names[int(rng.integers(len(rig)))]
    turn, shift = (v / np.linalg.norm(v) for v in rng.normal(size=(2, 3)))
    frame = round(PUSHED_AT * N_FRAMES)
    if not (root / "calibration.toml").exists():
        push = {"rotate_deg": (3.0 * turn).tolist(), "shift_m": (0.03 * shift).tolist()}
        fault = {"kind": "moved", "camera": camera, "frame": frame, **push}
        scene = load_scene(name).model_copy(update={"n_frames": N_FRAMES})
        synthesise(
            type(scene).model_validate({**scene.model_dump(exclude_unset=True), "faults": [fault]}), root
        )
    mended = work / "sessions" / f"{name}_mended"
    shutil.rmtree(mended, ignore_errors=True)
    shutil.copytree(root, mended)
    runs = work / "runs"
    row: Row = {"session": name, "camera": camera, "turned_deg": 3.0, "shifted_mm": 30.0}
    row["unharmed_pose_mm"] = pose_error(twin, runs / f"{name}_unharmed")
    row["left_out_pose_mm"] = pose_error(root, runs / f"{name}_left_out")
    faults = stored_faults(StageStore(runs / f"{name}_left_out" / "store.zarr"))
    named = [fault.first_frame for fault in faults if fault.camera == camera and fault.kind == "moved"]
    row["frames_off"] = named[0] - frame if named else None
    write_moved(mended / "found.toml", refine_moved(mended, camera, frame + SWINGS), mended)
    row["mended_pose_mm"] = pose_error(mended, runs / f"{name}_mended")
    return row


def main(arguments: Sequence[str] | None = None) -> int:
    """Write the table."""
    parser = session_parser(__doc__, "out/refine_rig")
    parser.add_argument("--poses", action="store_true", help="and poses of the first draw")
    parser.add_argument("--seeds", type=int, default=3, help="draws of errors per session")
    parser.add_argument("--turn-deg", type=float, default=2.0)
    parser.add_argument("--shift-mm", type=float, default=30.0)
    parser.add_argument("--height-m", type=float, help="of the person, who sets the scale")
    parser.add_argument("--moved", action="store_true", help="one camera at a time, pushed in mid-take")
    options = parser.parse_args(arguments)
    rows = []
    for name in names_of(options, DEVELOPMENT, TEST):
        for row in moved(name, options) if options.moved else refined(name, options):
            print(row, flush=True)
            rows.append(row)
    write_table("moved_camera" if options.moved else "refine_rig", options, rows)
    return 0


def refined(name: str, options: argparse.Namespace) -> Iterator[Row]:
    """All draws of one session."""
    session = open_session(session_of(name, options.work))
    seen = look_at(session, n_threads=1)
    for seed in range(options.seeds):
        yield evaluate(session, seen, seed, options)


def moved(name: str, options: argparse.Namespace) -> Iterator[Row]:
    """Every camera of one session pushed; and its poses, of a scene."""
    session = open_session(session_of(name, options.work))
    first = session.frames[round(PUSHED_AT * len(session.frames))] + SWINGS
    session = replace(session, frames=range(first, session.frames.stop))
    hulls, stride = look_at(session, n_threads=1)
    # The empty clip of a camera that was pushed is of the place where it stood before.
    without, _ = look_at(replace(session, background_sources={}), n_threads=1)
    for c, camera in enumerate(session.rig.names):
        seen = [without[k] if k == c else own for k, own in enumerate(hulls)]
        for seed in range(options.seeds):
            yield evaluate_moved(session, (seen, stride), camera, seed)
    if options.poses:
        yield moved_poses(name, options.work)


if __name__ == "__main__":
    sys.exit(main())
