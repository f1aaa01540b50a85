"""Keypoints: volumes alone, plain triangulation, the follower on keypoints alone, both together.

Runs on the realistic development sessions in ../shared/dev_sessions with the detections of MediaPipe that lie beside
them, by number of cameras, and on synthetic scenes with simulated detections that were held out; writes a table of
eval/results/ whole: keypoints.csv of keypoints, keypoints_fused.csv of volumes without and with them.

    python -m eval.keypoints [--sessions walk,reach,cross,room] [--cameras 2,3,4,7]
    python -m eval.keypoints --fused [--sessions walk,...,keypoints_gesture_test] [--cameras 4,7]
    python -m eval.keypoints --fit      # the places and the errors of MediaPipe's points, on `steps` and `furnished`

No number was chosen on walk, reach, cross and room: places and deviations of keypoints come from steps and furnished
(`--fit`). Triangulation is that of the same detections: of every point the largest set of views that agree, no
smoothing; head, neck and pelvis are the midpoints of ears, shoulders and hips.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from eval.whole import write_csv, write_text
from mocap.data import LANDMARKS, Motion
from mocap.data.keypoints import KEYPOINTS
from mocap.io.tables import read_landmarks_csv
from mocap.metrics.points import offset_corrected, point_errors

Array = NDArray[np.float64]

ROOT = Path(__file__).resolve().parents[1]
DEV = ROOT.parent / "shared" / "dev_sessions"
RESULTS = ROOT / "eval" / "results"
SESSIONS = ("walk", "reach", "cross", "room")
SCENES = ("keypoints_gesture_test", "keypoints_pair_test")
FITTED_ON = ("steps", "furnished")
METHODS = ("triangulation", "keypoints")
METHODS_WITH_VOLUMES = ("volumes", "fused")
WITH_DEPTH = "_depth"  # at the end of a method's name: with the depth maps of the session too
CAMERAS = (2, 3, 4, 7)
CAMERAS_WITH_VOLUMES = {
    **dict.fromkeys(("walk", "reach", "cross"), (4, 7)),
    **dict.fromkeys(("room", *SCENES), (4,)),
}
# Cameras on the ring, far apart: the first two look from sides at right angles, as far as seven on a ring can.
OF_RING = (0, 2, 4, 1, 5, 3, 6)
EPSILON_MM = 100.0
FIELDS = (
    *("session", "cameras", "method", "seed", "persons", "found"),
    *("mean_error_mm", "mean_error_after_offset_mm", "mmta_percent", "ms_per_frame"),
)


@dataclass(frozen=True, eq=False)
class Case:
    """One run.  cameras : how many of the session's."""

    session: str
    cameras: int
    method: str
    seed: int


def cases(
    sessions: Sequence[str], cameras: Sequence[int], methods: Sequence[str], seeds: int, work: Path
) -> Iterator[Case]:
    """Every run that can be: `room` has five cameras."""
    for session in sessions:
        most = len(list(_sources(session, work)[1].iterdir()))
        for n in sorted({min(n, most) for n in cameras}):
            for method in methods:
                for seed in range(1 if method == "triangulation" else seeds):
                    yield Case(session, n, method, seed)


def _sources(session: str, work: Path) -> tuple[Path, Path]:
    """The folder of a development session or of a scene, which is made when it is not there, and its keypoints."""
    from mocap.synth import synthesise

    if (DEV / session).is_dir():
        return DEV / session, DEV / "keypoints" / session
    folder = work / "scenes" / session
    if not folder.is_dir():
        synthesise(session, folder, workers=1)
    return folder, folder / "keypoints"


def session_folder(case: Case, source: Path, keypoints: Path, work: Path) -> Path:
    """A session of some cameras of `source`, with keypoints, and with videos (and depth) where a method needs them."""
    from mocap.io.calibration import read_calibration

    has_videos = case.method.removesuffix(WITH_DEPTH) in METHODS_WITH_VOLUMES
    has_depth = case.method.endswith(WITH_DEPTH)
    kind = ("videos" if has_videos else "keypoints") + WITH_DEPTH * has_depth
    folder = work / f"{case.session}_{case.cameras}_{kind}"
    folder.mkdir(parents=True, exist_ok=True)
    links = {"calibration.toml": source / "calibration.toml", "truth": source / "truth"}
    links |= {"keypoints": keypoints}
    wanted = ["videos", "background"] * has_videos + ["depth"] * has_depth
    links |= {name: source / name for name in wanted if (source / name).exists()}
    for name, target in links.items():
        if not (folder / name).exists():
            os.symlink(target.resolve(), folder / name)
    names = read_calibration(source / "calibration.toml").rig.names
    order = OF_RING if len(names) == len(OF_RING) else range(len(names))
    kept = [names[i] for i in sorted(list(order)[: case.cameras])]
    write_text(folder / "session.toml", f"fps = 30.0\ncameras = {json.dumps(kept)}\n")
    return folder


def measure(
    case: Case,
    sources: tuple[Path, Path],
    work: Path,
    frames: tuple[int, int] | None,
    *,
    resume: bool = False,
) -> dict[str, Any]:
    """One run as a row.  sources : folder of the session, and of its keypoints."""
    folder = session_folder(case, *sources, work)
    begin = time.perf_counter()
    found, n_frames = (
        _triangulated(folder, frames)
        if case.method == "triangulation"
        else _run(case, folder, frames, resume)
    )
    wall_s = time.perf_counter() - begin
    truth = read_landmarks_csv(folder / "truth" / "landmarks.csv")
    row: dict[str, Any] = {f: getattr(case, f) for f in ("session", "cameras", "method", "seed")}
    return {**row, **scores(found, truth, n_frames), "ms_per_frame": round(1000 * wall_s / n_frames, 1)}


def _run(case: Case, folder: Path, frames: tuple[int, int] | None, resume: bool) -> tuple[list[Motion], int]:
    from mocap.pipeline.config import load_config
    from mocap.pipeline.run import run_session
    from mocap.pose.result import motion_of

    method = case.method.removesuffix(WITH_DEPTH)
    kind = {"volumes": "voxels"}.get(method, method)
    config = load_config("default", ("output.formats=[]", f"observation={kind}"))
    result = run_session(
        folder,
        folder.parent / f"{folder.name}_{case.method}",
        config=config,
        seed=case.seed,
        frames=frames,
        resume=resume,
    )
    fps = result.session.fps
    return [motion_of(p, fps) for p in result.poses], len(result.session.frames)


def _triangulated(folder: Path, frames: tuple[int, int] | None) -> tuple[list[Motion], int]:
    """Landmarks of the points on which views agree, frame by frame."""
    from mocap.io.keypoints import read_keypoints
    from mocap.io.session import open_session
    from mocap.likelihood.markers import marker_views
    from mocap.pipeline.stages.keypoints import figure_views, undistorted
    from mocap.tracking.figures import FigureSettings, persons_of_figures

    session = open_session(folder, frames=frames)
    read = read_keypoints(session.keypoint_sources, session.rig, session.frames)
    figures = {f: undistorted(read[f], session.rig) for f in session.frames}
    views = figure_views(marker_views(session.rig))
    persons = persons_of_figures(figures, views, session.fps, FigureSettings())
    motions = []
    for p in persons:
        at = np.array(p.frames, dtype=np.int64)
        landmarks = np.array([landmarks_of_points(p.points[f]) for f in p.frames])
        motions.append(Motion(p.number, at, at / session.fps, landmarks))
    return motions, len(session.frames)


def landmarks_of_points(points: Array) -> Array:
    """The 15 landmarks (15, 3) m that points (K, 3) m stand for, NaN where one is missing."""
    middle = {"head": "ear", "neck": "shoulder", "pelvis": "hip"}
    out = np.full((len(LANDMARKS), 3), np.nan)
    for i, name in enumerate(LANDMARKS):
        pair = [f"left_{middle[name]}", f"right_{middle[name]}"] if name in middle else [name]
        out[i] = np.mean([points[KEYPOINTS.index(k)] for k in pair], axis=0)
    return out


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
    a, b = estimate.landmarks[i][:, : len(LANDMARKS)], truth.landmarks[j]
    if not len(frames):
        return np.zeros((0, len(LANDMARKS))), np.zeros((0, len(LANDMARKS)))
    return point_errors(a, b), point_errors(offset_corrected(a, b), b)


def main(arguments: Sequence[str] | None = None) -> None:
    """Run all cases, and write the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--sessions", help="default: all of the table")
    parser.add_argument("--cameras", help="default: 2,3,4,7; with --fused 4, and 7 where there are so many")
    parser.add_argument("--fused", action="store_true", help="volumes without and with keypoints")
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--frames", help="first:stop, for a quick look; nothing is written then")
    parser.add_argument("--work", type=Path, default=ROOT / "out" / "keypoints")
    parser.add_argument("--fit", action="store_true", help="print places and errors of MediaPipe's points")
    options = parser.parse_args(arguments)
    if not DEV.is_dir():
        sys.exit("the development sessions (../shared/dev_sessions) are not there")
    if options.fit:
        from eval.keypoint_places import print_fit

        print_fit(FITTED_ON)
        return
    first, _, stop = (options.frames or "").partition(":")
    frames = (int(first or 0), int(stop)) if options.frames else None
    methods, table = (
        (METHODS_WITH_VOLUMES, "keypoints_fused.csv") if options.fused else (METHODS, "keypoints.csv")
    )
    default = (*SESSIONS, *SCENES) if options.fused else SESSIONS
    given = tuple(int(n) for n in options.cameras.split(",")) if options.cameras else None
    usual = CAMERAS_WITH_VOLUMES if options.fused else {}
    wanted = (
        case
        for session in (options.sessions.split(",") if options.sessions else default)
        for case in cases(
            [session], given or usual.get(session, CAMERAS), methods, options.seeds, options.work
        )
    )
    # Runs with volumes take minutes each: they may go on where an earlier call has stopped, and tell no time then.
    fields = FIELDS[:-1] if options.fused else FIELDS

    def rows() -> Iterator[dict[str, Any]]:
        for case in wanted:
            sources = _sources(case.session, options.work)
            row = measure(case, sources, options.work, frames, resume=options.fused)
            print(", ".join(f"{k} {v}" for k, v in row.items()), flush=True)
            yield {field: row[field] for field in fields}

    if frames is None:
        write_csv(RESULTS / table, fields, rows())
    else:
        list(rows())


if __name__ == "__main__":
    main()
