"""What the error that is left consists of: session by session, from the error as it is to what the body could reach.

    python -m eval.error_budget [--only dev:walk,dev:cross] [--presets best] [--seed 0] [--work out/eval]

Presets `default` and `best`, pose stage alone on the same masks, volumes and tracks. Columns, mm, means over 15
landmarks:

    raw, after_offset   as they are, and after one offset per landmark learnt on the first ten frames
    best_offset         after the best constant offset in the torso's frame
    bone_offset         after the best constant offset in the frame of the joint that carries the landmark
    fast                of that, what changes within 0.3 s
    lost_percent        landmarks more than 100 mm away, percent
    not_held            best_offset when feet that stand are not held
    from_truth          best_offset of poses refined from the true ones: what hull and outlines prefer; with `best`
                        hull, outlines and the colours that the true poses teach
    body                bone_offset of the found body fitted to the true landmarks: what its joints can reach
    nats                by how much hull and outlines prefer their own minimum to the true pose

Writes eval/results/error_budget.csv, whole, when all sessions are run with both presets. Rows that are in WORK/budget
already, of the same program, are taken from there; --again makes them anew.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from eval.landmark_bias import _running_mean
from eval.pose_ablation import SESSIONS, prepare
from eval.pose_sessions import ROOT
from eval.second_pass import evidence_of_rows, nearest
from eval.whole import kept_rows, write_csv
from mocap.arrays import Array
from mocap.body import Body, landmarks_of
from mocap.body.kinematics import joint_transforms, point_jacobian
from mocap.data import LANDMARKS
from mocap.filters.refine import RefineSettings, refine
from mocap.io.session import open_session
from mocap.io.session.reading import pictures_of
from mocap.io.store import StageStore
from mocap.io.tables import read_landmarks_csv
from mocap.metrics.points import offset_corrected, point_errors
from mocap.pipeline.config import load_config
from mocap.pipeline.stage import Job
from mocap.pipeline.stages.pose import PoseWork
from mocap.pose.edits import copied
from mocap.pose.person import VolumeClip
from mocap.pose.point_fit import PointFit
from mocap.pose.result import FollowedPerson
from mocap.pose.smooth import smooth_motion
from mocap.pose.texture import settle_on_texture
from mocap.pose.volume import VolumeObservation, VolumeTools
from mocap.products.tracks import stored_tracks

RESULTS = ROOT / "eval" / "results" / "error_budget.csv"
FIELDS = (
    *(
        "session",
        "person",
        "preset",
        "raw",
        "after_offset",
        "best_offset",
        "bone_offset",
        "fast",
        "lost_percent",
    ),
    *("not_held", "from_truth", "body", "nats"),
)
N = len(LANDMARKS)
_LOST_MM = 100.0
_ROUNDS = 4


def fitted_to(body: Body, states: Array, true: Array) -> tuple[Array, Array]:
    """States (T, D) near others whose landmarks, each moved by one constant in its joint's frame, meet the true ones
    (T, 15, 3) m; and these moved landmarks."""
    joint, found = body.landmark_joint[:N], states.copy()
    settings = RefineSettings(np.full(states.shape[1], 0.3), residual_std_m=0.003, n_iterations=8)
    for _ in range(_ROUNDS):
        R, t = joint_transforms(body, found)
        offset = np.einsum("tmji,tmj->tmi", R[:, joint], true - t[:, joint]).mean(axis=0)
        fits = [PointFit(body, joint, offset, places) for places in true]
        found = np.stack([refine(fit, start, settings)[0] for fit, start in zip(fits, states, strict=True)])
    points = [point_jacobian(body, state, joint, offset)[0] for state in found]
    return found, np.stack(points)


def settled(work: PoseWork, one: FollowedPerson, known: NDArray[np.bool_], states: Array) -> Array:
    """Other poses (T', D) of the known frames (T,), settled on the texture that they teach."""
    tools = one.tools
    assert isinstance(tools, VolumeTools)
    pictures = partial(pictures_of, work.job.session)
    observation = VolumeObservation(tools, work.hull_of(one.person), pictures_of=pictures)
    series = copied(one.series).rows(known)
    series.states[:] = states
    frames = one.frames[known]
    settle_on_texture(VolumeClip(one.person, frames, np.zeros((len(frames), 3)), observation), series)
    return series.states


def row_of(work: PoseWork, one: FollowedPerson, true: Array, fps: float) -> dict[str, float]:
    """The columns of one person.  true : (T, 15, 3) m, NaN in frames without."""
    body, settings = one.body, one.tools.settings
    known: NDArray[np.bool_] = np.asarray(np.isfinite(true).all(axis=(1, 2)))
    t = true[known]
    states = work.finished(one).states

    def best(poses: Array, rows: Array) -> float:
        places = landmarks_of(body, poses)[:, :N]
        return float(point_errors(offset_corrected(places, rows, len(rows)), rows).mean())

    places = landmarks_of(body, states[known])[:, :N]
    R, _ = joint_transforms(body, states[known])
    local = np.einsum("tmji,tmj->tmi", R[:, body.landmark_joint[:N]], 1000.0 * (places - t))
    rest = local - local.mean(axis=0)
    method = settings.method
    loose = replace(method, contact=replace(method.contact, hold=0.0))
    walking = smooth_motion(body, one.series, fps, settings.smooth_lag_frames, loose)
    fitted, points = fitted_to(body, states[known], t)
    evidence = [seen for seen, is_known in zip(evidence_of_rows(work, one), known, strict=True) if is_known]
    refined, nats = fitted.copy(), []
    for row, seen in enumerate(evidence):
        if seen is None:
            continue
        refined[row] = seen.refined(fitted[row])
        costs = [seen.residuals.normal_equations(s)[0] / seen.m2_per_nat for s in (fitted[row], refined[row])]
        nats.append(costs[0] - costs[1])
    if settings.texture_weight > 0:
        refined = settled(work, one, known, fitted)
    return {
        "raw": float(point_errors(places, t).mean()),
        "after_offset": float(point_errors(offset_corrected(places, t), t).mean()),
        "best_offset": best(states[known], t),
        "bone_offset": float(np.linalg.norm(rest, axis=2).mean()),
        "fast": float(np.linalg.norm(rest - _running_mean(rest), axis=2).mean()),
        "lost_percent": 100.0 * float((point_errors(places, t) > _LOST_MM).mean()),
        "not_held": best(walking[known], t),
        "from_truth": best(refined, t),
        "body": float(point_errors(points, t).mean()),
        "nats": float(np.mean(nats)),
    }


def followed_with_truth(
    name: str, preset: str, seed: int, work_folder: Path, *, trust_store: bool
) -> Iterator[tuple[PoseWork, FollowedPerson, Array, float]]:
    """The persons of a session as they are followed: the work on them, one of them, his true landmarks (T, 15, 3) m,
    NaN = not known, and the frame rate."""
    folder, out = prepare(name, work_folder, trust_store=trust_store)
    session, store = open_session(folder), StageStore(out / "store.zarr")
    truth = read_landmarks_csv(folder / "truth" / "landmarks.csv")
    work = PoseWork(Job(session, load_config(preset), store, seed=seed))
    for one in work.follow(stored_tracks(store, session.fps)):
        person = min(truth, key=lambda motion: nearest(one, motion.frames, motion.landmarks[:, 0]))
        true = np.full((len(one.frames), N, 3), np.nan)
        _, own, of_truth = np.intersect1d(one.frames, person.frames, return_indices=True)
        true[own] = person.landmarks[of_truth][:, :N]
        yield work, one, true, session.fps


def rows_of(
    name: str, preset: str, seed: int, work_folder: Path, *, trust_store: bool
) -> list[dict[str, Any]]:
    """A row per person of a session."""
    rows = []
    for work, one, true, fps in followed_with_truth(name, preset, seed, work_folder, trust_store=trust_store):
        row = row_of(work, one, true, fps)
        about = {"session": name, "person": one.person, "preset": preset}
        rows.append(about | {k: f"{v:.1f}" for k, v in row.items()})
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--only", help="sessions, separated by commas; then the table is not written")
    parser.add_argument("--presets", default="default,best", help="separated by commas; likewise")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--work", type=Path, default=ROOT / "out" / "eval")
    parser.add_argument("--trust-store", action="store_true", help="take masks and volumes as they are")
    parser.add_argument("--again", action="store_true", help="make rows anew")
    arguments = parser.parse_args()
    names = arguments.only.split(",") if arguments.only else SESSIONS
    rows: list[dict[str, str]] = []
    for name, preset in product(names, arguments.presets.split(",")):
        kept = arguments.work / "budget" / f"{name.replace(':', '_')}_{preset}_{arguments.seed}.csv"
        make = partial(
            rows_of, name, preset, arguments.seed, arguments.work, trust_store=arguments.trust_store
        )
        rows += kept_rows(kept, FIELDS, make, again=arguments.again)
    if not arguments.only and arguments.presets == parser.get_default("presets"):
        write_csv(RESULTS, FIELDS, rows)


if __name__ == "__main__":
    main()
