"""Live: what a result costs, how late it is, and how far off, on a session that is played over and over.

    python -m eval.live SESSION [--cameras 4,7] [--seconds 20] [--preset live] [--threads 2] [--work out/eval]

`every` follows every frame without threads: milliseconds of CPU per frame, which no other process disturbs.
`live` plays the same videos at their own pace through threads, as `mocap live` does: results per second, latency and
what was dropped depend on the machine and on what else it does. Somebody who walks on a closed path jumps but a step
when the clip begins anew. Writes eval/results/live.csv.
"""

from __future__ import annotations

import argparse
import os
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from eval.pose_sessions import ROOT
from eval.whole import write_csv
from mocap.data import LANDMARKS

RESULTS = ROOT / "eval" / "results" / "live.csv"
FIELDS = (
    "session", "mode", "cameras", "cores", "preset", "threads", "results", "height_s", "first_pose_s", "search_cpu_s",
    "cpu_ms", "results_per_s", "latency_p50_ms", "latency_p95_ms", "dropped", "error_mm",
)  # fmt: skip


def played(session_root: Path, seconds: float, work: Path) -> Path:
    """A copy of a session whose videos are played over and over for so long."""
    from mocap.io.session import open_session
    from mocap.io.video import FrameReader

    session = open_session(session_root)
    out = work / f"{session.name}-{seconds:g}s"
    if (out / "done").exists():
        return out
    (out / "videos").mkdir(parents=True, exist_ok=True)
    for name in ("calibration.toml", "session.toml"):
        if (session_root / name).exists():
            (out / name).write_bytes((session_root / name).read_bytes())
    (out / "background").mkdir(exist_ok=True)
    for name, path in session.background_sources.items():
        (out / "background" / f"{name}{path.suffix}").write_bytes(path.read_bytes())
    with FrameReader(session.image_sources, session.rig, session.frames) as reader:
        clip = [pictures for _, pictures in reader]
    for c, camera in enumerate(session.rig):
        video = str(out / "videos" / f"{camera.name}.mp4")
        writer = cv2.VideoWriter(video, cv2.VideoWriter.fourcc(*"mp4v"), session.fps, camera.size)
        for i in range(round(seconds * session.fps)):
            writer.write(cv2.cvtColor(clip[i % len(clip)][c], cv2.COLOR_RGB2BGR))
        writer.release()
    (out / "done").touch()
    return out


class Errors:
    """Mean distance of the landmarks to the nearest person of the truth, frame by frame; a sink of a live run."""

    def __init__(self, session_root: Path) -> None:
        from mocap.io.tables import read_landmarks_csv

        self._truth = read_landmarks_csv(session_root / "truth" / "landmarks.csv")
        self._n = max(len(person.frames) for person in self._truth)
        self.errors_mm: list[float] = []
        self.height_s: float | None = None
        self.first_pose_s: float | None = None
        self._began_s: float | None = None
        self.latencies_s: list[float] = []

    def put(self, result: Any) -> None:
        """One result."""
        if self._began_s is None and result.persons:
            self._began_s = result.time_s
        for person in result.persons:
            if self.height_s is None and self._began_s is not None and person.height_m is not None:
                self.height_s = result.time_s - self._began_s
            if person.pose is None:
                continue
            if self.first_pose_s is None and self._began_s is not None:
                self.first_pose_s = result.time_s - self._began_s
            row = result.frame % self._n
            truth = [t.landmarks[row] for t in self._truth if row < len(t.landmarks)]
            found = person.pose.landmarks[: len(LANDMARKS)]
            distances = [np.linalg.norm(found - t[: len(LANDMARKS)], axis=1).mean() for t in truth]
            self.errors_mm.append(1000 * float(min(distances)))
        if self.first_pose_s is not None:
            self.latencies_s.append(result.latency_s)

    def close(self) -> None:
        """Nothing to close."""


def every(root: Path, n_cameras: int, preset: str, seconds: float, work: Path) -> dict[str, Any]:
    """Every frame without threads: CPU time per frame."""
    from mocap.data import Occluders
    from mocap.io.store import StageStore
    from mocap.pipeline.live.engine import Engine

    session, config = _opened(root, n_cameras, preset, seconds, work)
    errors = Errors(root)
    costs: list[float] = []
    with tempfile.TemporaryDirectory() as folder:
        store = StageStore(Path(folder) / "store.zarr")
        with Engine(session, config, store, Occluders({}, 1), n_threads=1) as engine:
            before = time.process_time()
            for result in engine.results(_sets(session)):
                now = time.process_time()
                costs.append(now - before)
                before = now
                errors.put(result)
    followed = costs[-len(errors.latencies_s) + 1 :]
    return {
        "results": len(costs),
        "height_s": _rounded(errors.height_s),
        "first_pose_s": _rounded(errors.first_pose_s),
        "search_cpu_s": round(max(costs), 2),
        "cpu_ms": round(1000 * float(np.median(followed)), 1),
        "error_mm": round(float(np.mean(errors.errors_mm)), 1),
    }


def live(
    root: Path, n_cameras: int, preset: str, n_threads: int, seconds: float, work: Path
) -> dict[str, Any]:
    """The videos at their own pace."""
    from mocap.pipeline.live.run import LiveOrder, run_live

    session, config = _opened(root, n_cameras, preset, seconds, work)
    errors = Errors(root)
    sources = {name: str(path) for name, path in session.image_sources.items()}
    order = LiveOrder(session, sources, config, tolerance_s=0.6 / session.fps, n_threads=n_threads)
    before = _cpu_s()
    status = run_live(order, [errors], show=lambda status: None, count_down=lambda left_s: None)
    cpu_s = _cpu_s() - before
    p50, p95 = (1000 * float(np.percentile(errors.latencies_s, p)) for p in (50, 95))
    return {
        "results": status.n_results,
        "height_s": _rounded(errors.height_s),
        "first_pose_s": _rounded(errors.first_pose_s),
        "cpu_ms": round(1000 * cpu_s / status.n_results, 1),
        "results_per_s": round(status.results_per_s, 1),
        "latency_p50_ms": round(p50),
        "latency_p95_ms": round(p95),
        "dropped": status.counts.n_dropped,
        "error_mm": round(float(np.mean(errors.errors_mm)), 1),
    }


def _cpu_s() -> float:
    """Seconds of CPU of this process, and of those that it has started and that have ended."""
    spent = os.times()
    return spent.user + spent.system + spent.children_user + spent.children_system


def _opened(root: Path, n_cameras: int, preset: str, seconds: float, work: Path) -> tuple[Any, Any]:
    """The session that is played, by n cameras evenly round the room, and the configuration."""
    from mocap.io.session import open_session
    from mocap.pipeline.config import load_config
    from mocap.pipeline.live.run import LIVE_DEFAULTS, LIVE_SETTINGS

    session = open_session(played(root, seconds, work))
    rows = np.unique(np.linspace(0, len(session.rig), n_cameras, endpoint=False).astype(int))
    names = [session.rig.names[i] for i in rows]
    session = replace(
        session,
        rig=session.rig.subset(names),
        image_sources={name: session.image_sources[name] for name in names},
        background_sources={name: session.background_sources[name] for name in names},
    )
    return session, load_config(preset, (*LIVE_DEFAULTS, *LIVE_SETTINGS))


def _sets(session: Any) -> Iterator[Any]:
    """Every frame as a set."""
    from mocap.io.video import FrameReader
    from mocap.pipeline.live.capture import Shot
    from mocap.pipeline.live.pairing import PictureSet

    with FrameReader(session.image_sources, session.rig, session.frames) as reader:
        for frame, pictures in reader:
            now_s = time.monotonic()
            yield PictureSet(tuple(Shot(frame / session.fps, now_s, picture) for picture in pictures))


def _rounded(value: float | None) -> float | None:
    return None if value is None else round(value, 1)


def main(words: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("session", type=Path, nargs="+")
    parser.add_argument("--cameras", default="4,7")
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--preset", default="live")
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--modes", default="every,live")
    parser.add_argument("--work", type=Path, default=ROOT / "out" / "eval" / "live")
    arguments = parser.parse_args(words)
    preset, seconds, work = arguments.preset, arguments.seconds, arguments.work
    n_cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    rows = []
    for root in arguments.session:
        for n_cameras in map(int, arguments.cameras.split(",")):
            for mode in arguments.modes.split(","):
                row = {
                    "session": root.name,
                    "mode": mode,
                    "cameras": n_cameras,
                    "cores": n_cores,
                    "preset": preset,
                }
                if mode == "every":
                    row |= {"threads": 1, **every(root, n_cameras, preset, seconds, work)}
                else:
                    n_threads = arguments.threads
                    row |= {"threads": n_threads, **live(root, n_cameras, preset, n_threads, seconds, work)}
                print("  ".join(f"{key} {value}" for key, value in row.items()), flush=True)
                rows.append(row)
    write_csv(RESULTS, FIELDS, rows)


if __name__ == "__main__":
    main()
