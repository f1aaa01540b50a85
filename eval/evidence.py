"""Evidence: what volumes, keypoints, both, and depth beside them are worth, by number of cameras and by session.

    python -m eval.evidence                                        # all rows; hours
    python -m eval.evidence --sessions clean,walk --cameras 4      # some of them

Sessions are five synthetic scenes (`eval.evidence_scenes`) and the realistic development sessions in
../shared/dev_sessions with the detections of MediaPipe that lie beside them; fewer cameras are those of the ring that
stand far apart. All tables have five seeds: another one is another scene, or other random numbers in the same
development session. A row that the same program has measured is kept in --work and read from there, so that the table
can be made in many calls. A table of eval/results/ is written, whole, when all its rows are there: evidence.csv of the
scenes, keypoints.csv and keypoints_fused.csv of the development sessions.

No number was chosen on these sessions: places and deviations of keypoints come from `steps` and `furnished`
(`python -m eval.keypoint_places`). Time is that of one core for a whole run up to the poses, the start of the program
and the compilation of kernels aside.
"""

from __future__ import annotations

import argparse
import json
import os
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from eval.evidence_scenes import SCENES, scene_folder
from eval.triangulation import triangulated
from eval.whole import of_this_program, write_csv, write_text
from mocap.arrays import Array
from mocap.data import LANDMARKS, Motion
from mocap.io.calibration import read_calibration
from mocap.io.tables import read_landmarks_csv
from mocap.metrics.points import offset_corrected, point_errors
from mocap.pipeline.config import load_config
from mocap.pipeline.run import run_session
from mocap.pipeline.warm_up import warm_up
from mocap.pose.result import motion_of

ROOT = Path(__file__).resolve().parents[1]
DEV = ROOT.parent / "shared" / "dev_sessions"
RESULTS = ROOT / "eval" / "results"
DEV_SESSIONS = ("walk", "reach", "cross", "room")
FURTHER = ("keypoints_gesture_test", "keypoints_pair_test")  # scenes of `mocap synth`
METHODS = ("triangulation", "keypoints", "volumes", "fused", "fused_depth")
CAMERAS = (2, 3, 4, 7)
# Cameras on the ring, far apart: the first two look from sides at right angles, as far as seven on a ring can.
OF_RING = (0, 2, 4, 1, 5, 3, 6)
N_SEEDS = 5
EPSILON_MM = 100.0
FIELDS = (
    *("session", "cameras", "method", "seed", "persons", "found"),
    *("mean_error_mm", "mean_error_after_offset_mm", "mmta_percent", "cpu_ms_per_frame"),
)


@dataclass(frozen=True)
class Case:
    """One run.  cameras : how many of the session's."""

    session: str
    cameras: int
    method: str
    seed: int

    @property
    def has_videos(self) -> bool:
        """Whether it looks at pictures."""
        return self.method not in ("triangulation", "keypoints")


def cases(
    sessions: Sequence[str], cameras: Sequence[int], methods: Sequence[str], seed: int
) -> Iterator[Case]:
    """Every run that can be: `room` has five cameras, development sessions have no depth."""
    for session in sessions:
        most = 5 if session == "room" else len(OF_RING)
        for n in sorted({min(n, most) for n in cameras}):
            for method in methods:
                if session in SCENES or method != "fused_depth":
                    yield Case(session, n, method, seed)


TABLES: dict[str, tuple[Case, ...]] = {
    "evidence.csv": tuple(
        case for seed in range(N_SEEDS) for case in cases(tuple(SCENES), CAMERAS, METHODS, seed)
    ),
    "keypoints.csv": tuple(
        case for seed in range(N_SEEDS) for case in cases(DEV_SESSIONS, CAMERAS, METHODS[:2], seed)
    ),
    "keypoints_fused.csv": tuple(
        case
        for seed in range(N_SEEDS)
        for sessions, cameras in ((DEV_SESSIONS[:3], (4, 7)), ((DEV_SESSIONS[3], *FURTHER), (4,)))
        for case in cases(sessions, cameras, ("volumes", "fused"), seed)
    ),
}


def some_cameras(case: Case, work: Path) -> Path:
    """The session of a case: some cameras of its source, with what it needs."""
    if case.session in DEV_SESSIONS:
        source, keypoints = DEV / case.session, DEV / "keypoints" / case.session
    else:
        source = scene_folder(case.session, case.seed, work)
        keypoints = source / "keypoints"
    wanted = ["videos", "background"] * case.has_videos + ["depth"] * case.method.endswith("_depth")
    folder = work / "runs" / f"{case.session}_{case.cameras}_{case.method}_{case.seed}"
    folder.mkdir(parents=True, exist_ok=True)
    links = {name: source / name for name in ("calibration.toml", "truth", *wanted)} | {
        "keypoints": keypoints
    }
    for name, target in links.items():
        if target.exists() and not (folder / name).exists():
            os.symlink(target.resolve(), folder / name)
    names = read_calibration(source / "calibration.toml").rig.names
    order = OF_RING if len(names) == len(OF_RING) else range(len(names))
    kept = [names[i] for i in sorted(list(order)[: case.cameras])]
    write_text(folder / "session.toml", f"fps = 30.0\ncameras = {json.dumps(kept)}\n")
    return folder


def measure(case: Case, work: Path, frames: tuple[int, int] | None = None) -> dict[str, Any]:
    """One run as a row.  frames : of the session, first and the one after the last; None = all."""
    folder = some_cameras(case, work)
    begin = time.process_time()
    if case.method == "triangulation":
        found, n_frames = triangulated(folder, frames)
    else:
        found, n_frames = _run(case, folder, frames)
    cpu_ms = 1000 * (time.process_time() - begin) / n_frames
    truth = read_landmarks_csv(folder / "truth" / "landmarks.csv")
    row = {field: getattr(case, field) for field in FIELDS[:4]}
    return row | scores(found, truth, n_frames) | {"cpu_ms_per_frame": round(cpu_ms)}


def _run(case: Case, folder: Path, frames: tuple[int, int] | None) -> tuple[list[Motion], int]:
    kind = {"volumes": "voxels"}.get(case.method, case.method.removesuffix("_depth"))
    config = load_config("default", ("output.formats=[]", f"observation={kind}"))
    out = folder.parent / f"{folder.name}_out"
    result = run_session(folder, out, config=config, seed=case.seed, frames=frames, until="pose", n_threads=1)
    fps = result.session.fps
    return [motion_of(p, fps) for p in result.poses], len(result.session.frames)


def scores(found: Sequence[Motion], truth: Sequence[Motion], n_frames: int) -> dict[str, Any]:
    """Scores over all true persons; every true person takes the estimate that is nearest to it, each once.

    A landmark without an estimate is no error, but is missing from MMTA.
    """
    free = list(found)
    raw, after, hits, total, n_found = [], [], 0, 0, 0
    for person in truth:
        total += min(n_frames, len(person.frames)) * len(LANDMARKS)
        distances = [_errors(m, person) for m in free]
        usable = [(float(np.nanmedian(e)), k) for k, (e, _) in enumerate(distances) if np.isfinite(e).any()]
        if not usable or min(usable)[0] > 2 * EPSILON_MM:
            continue
        best = min(usable)[1]
        own, own_after = distances[best]
        free.pop(best)
        n_found += 1
        raw.append(own[np.isfinite(own)])
        after.append(own_after[np.isfinite(own_after)])
        hits += int((own <= EPSILON_MM).sum())
    mean = [round(float(np.concatenate(e).mean()), 2) if e else None for e in (raw, after)]
    return {
        "persons": len(found),
        "found": n_found,
        "mean_error_mm": mean[0],
        "mean_error_after_offset_mm": mean[1],
        "mmta_percent": round(100.0 * hits / max(total, 1), 2),
    }


def _errors(estimate: Motion, truth: Motion) -> tuple[Array, Array]:
    """Errors (T, 15) mm on the frames that both have, raw and after one offset per landmark."""
    frames, i, j = np.intersect1d(estimate.frames, truth.frames, return_indices=True)
    n = len(LANDMARKS)  # feet and hands, of which not every method speaks, follow them
    a, b = estimate.landmarks[i][:, :n], truth.landmarks[j][:, :n]
    if not len(frames):
        return np.zeros((0, len(LANDMARKS))), np.zeros((0, len(LANDMARKS)))
    return point_errors(a, b), point_errors(offset_corrected(a, b), b)


def kept_row(case: Case, work: Path) -> Path:
    """Where the row of a case is kept."""
    name = f"{case.session}_{case.cameras}_{case.method}_{case.seed}.json"
    return of_this_program(work / "rows" / name)


def row_of(case: Case, work: Path) -> dict[str, Any]:
    """A measured row, or the kept one."""
    kept = kept_row(case, work)
    if not kept.exists():
        write_text(kept, json.dumps(measure(case, work)))
    row: dict[str, Any] = json.loads(kept.read_text(encoding="utf-8"))
    print(", ".join(f"{k} {v}" for k, v in row.items()), flush=True)
    return row


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure the cases that are asked for, and write the table when all its rows are there."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--sessions", default=",".join((*SCENES, *DEV_SESSIONS, *FURTHER)))
    parser.add_argument("--cameras", default=",".join(map(str, CAMERAS)))
    parser.add_argument("--methods", default=",".join(METHODS))
    seeds = ",".join(map(str, range(N_SEEDS)))
    parser.add_argument("--seeds", default=seeds)
    parser.add_argument("--work", type=Path, default=ROOT / "out" / "evidence")
    options = parser.parse_args(arguments)
    sessions, methods = options.sessions.split(","), options.methods.split(",")
    if not DEV.is_dir() and set(sessions) & set(DEV_SESSIONS):
        parser.error("the development sessions (../shared/dev_sessions) are not there")
    warm_up()
    for seed in map(int, options.seeds.split(",")):
        for case in cases(sessions, [int(n) for n in options.cameras.split(",")], methods, seed):
            row_of(case, options.work)
    for name, table in TABLES.items():
        if all(kept_row(case, options.work).exists() for case in table):
            write_csv(RESULTS / name, FIELDS, (row_of(case, options.work) for case in table))


if __name__ == "__main__":
    main()
