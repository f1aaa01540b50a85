"""Session folders: the clips, the calibration and the exact truth of a scene."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import cv2
import numpy as np

from mocap.errors import MocapError
from mocap.io.calibration import write_calibration
from mocap.io.keypoints import write_keypoints_csv
from mocap.io.tables import read_landmarks_csv
from mocap.progress import Progress, no_progress
from mocap.synth.keypoints import simulated_keypoints
from mocap.synth.markers import Sight, make_detections, write_detections
from mocap.synth.recorder import Moments, Recorder
from mocap.synth.render import require_embree
from mocap.synth.scene import Scene, load_scene, scene_from_dict
from mocap.synth.truth import write_truth
from mocap.synth.world import World, build_world, rng_at


def synthesise(
    scene: Scene | str | Path,
    out: Path | str,
    *,
    seed: int | None = None,
    workers: int = 2,
    body: str | None = None,
    progress: Progress = no_progress,
) -> Path:
    """Write the session folder of a scene (or scene name, or TOML file) to `out` and return it.

    seed : replaces the scene's seed and draws other persons.
    workers : processes over which the cameras are shared; the result does not depend on it.
    body : replaces the kind of all bodies, "own" or "anny".
    progress : a `what` may count from the start more than once.
    The folder is complete or absent: an earlier session there is replaced at the end, anything else is refused.
    Raises MocapError without embreex, for an unknown scene, and when `out` holds something that is no session;
    ValueError for workers < 1.
    """
    if workers < 1:
        raise ValueError(f"workers must be at least 1, got {workers}")
    checked = scene if isinstance(scene, Scene) else load_scene(scene)
    if body is not None:
        document = checked.model_dump(mode="json")
        checked = scene_from_dict({**document, "persons": [{**p, "body": body} for p in document["persons"]]})
    require_embree()
    out = Path(out)
    _refuse_foreign(out)
    progress("bodies", 0, 1)
    world = build_world(checked, seed=seed)
    progress("bodies", 1, 1)
    out.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix=f".{out.name}-", dir=out.parent) as scratch:
        folder = Path(scratch) / "session"
        folder.mkdir()
        _fill(world, folder, Path(scratch), seed=seed, workers=workers, progress=progress)
        if out.exists():
            shutil.rmtree(out)
        folder.rename(out)
    return out


def _refuse_foreign(out: Path) -> None:
    """MocapError when `out` holds something that this module has not written."""
    if not out.exists() or (out / "truth" / "truth.json").is_file():
        return
    if not out.is_dir() or any(out.iterdir()):
        raise MocapError(
            "the output folder exists and is not a synthetic session", path=out, remedy="give another folder"
        )


def _fill(
    world: World, folder: Path, scratch: Path, *, seed: int | None, workers: int, progress: Progress
) -> None:
    """All files of a session; the cameras are shared between this process and others."""
    groups = [list(world.rig.names[k::workers]) for k in range(workers)]
    # This process writes the truth too: it takes the smallest group.
    groups = [g for g in groups if g][::-1]
    total = len(world.rig) * world.scene.n_frames

    def pictures(share: float) -> None:
        progress("pictures", round(share * total), total)

    with _rendering(world.scene, seed, groups[1:], folder, scratch) as jobs:
        _write_head(world, folder)
        render_cameras(world, groups[0], folder, progress=pictures)
        write_truth(world, folder / "truth", progress)
        for job in jobs:
            if job.wait() != 0:
                raise RuntimeError(f"a rendering process failed with exit code {job.returncode}")
        _write_detections(world, folder)
        _write_keypoints(world, folder)
    progress("pictures", total, total)


@contextmanager
def _rendering(
    scene: Scene, seed: int | None, groups: list[list[str]], folder: Path, scratch: Path
) -> Iterator[list[subprocess.Popen[bytes]]]:
    """Processes that render groups of cameras, none of which outlives the block; each builds the same world."""
    jobs = []
    try:
        for k, names in enumerate(groups):
            job = scratch / f"job_{k}.json"
            job.write_text(
                json.dumps(
                    {
                        "scene": scene.model_dump(mode="json"),
                        "seed": seed,
                        "cameras": names,
                        "out": str(folder),
                    }
                )
            )
            # A fresh interpreter: forking a process that has used OpenCV's threads can hang.
            code = "import sys; sys.path[:0] = sys.argv[2:]; from mocap.synth import session; session.work(sys.argv[1])"
            root = str(Path(__file__).resolve().parents[2])  # the folder that holds the package
            jobs.append(subprocess.Popen([sys.executable, "-c", code, str(job), root]))
        yield jobs
    finally:
        for process in jobs:
            if process.poll() is None:
                process.terminate()
                process.wait()


def work(job_file: str) -> None:
    """Entry of a rendering process."""
    job = json.loads(Path(job_file).read_text())
    scene = Scene.model_validate(job["scene"])
    render_cameras(build_world(scene, seed=job["seed"]), job["cameras"], Path(job["out"]))


def render_cameras(
    world: World, names: list[str], folder: Path, *, progress: Callable[[float], None] | None = None
) -> None:
    """Clips, background clips and true silhouettes of some cameras.  progress : called with the share done."""
    n_threads = cv2.getNumThreads()
    cv2.setNumThreads(1)  # the pictures are small and there is a process per core
    recorders = [Recorder(world, n, folder) for n in names]
    try:
        _record(world, recorders, progress)
    finally:
        cv2.setNumThreads(n_threads)
        for recorder in recorders:
            recorder.close()


def _record(world: World, recorders: list[Recorder], progress: Callable[[float], None] | None) -> None:
    """The empty room, then picture by picture over all cameras, which share the bodies of an instant."""
    scene = world.scene
    moments = Moments(world, with_light=not scene.masks_only)
    if scene.with_background and not scene.masks_only:
        for recorder in recorders:
            recorder.record_background()
    last = max(len(r.timeline) for r in recorders)
    for frame in range(last):
        for recorder in recorders:
            if frame < len(recorder.timeline):
                recorder.record(frame, moments)
        if progress is not None:
            progress((frame + 1) / last)


def _write_detections(world: World, folder: Path) -> None:
    """detections/ of the simulated detector; for rendered balls the labels that a person would give in one frame."""
    config = world.scene.markers
    if config is None:
        return
    if config.detections:
        found = make_detections(
            folder,
            detection_rate=config.detection_rate,
            false_positives=config.false_positives,
            noise_variance_px2=config.noise_variance_px2,
            rng=rng_at(world.seed if config.seed is None else config.seed, 12),
        )
        write_detections(folder, found)
    if config.balls:
        lines = ["camera,frame,u_px,v_px"]
        for name in world.rig.names:
            with np.load(folder / "truth" / "views" / f"{name}.npz") as data:
                seen = data["marker_uv"][0][data["marker_state"][0] == Sight.VISIBLE]
            lines += [f"{name},0,{u:.2f},{v:.2f}" for u, v in seen]
        (folder / "marker_labels.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")


def _write_keypoints(world: World, folder: Path) -> None:
    """keypoints/ of the simulated pose network, of every person in every picture; cameras run on time."""
    config = world.scene.keypoints
    if config is None:
        return
    motions = read_landmarks_csv(folder / "truth" / "landmarks.csv")
    for c, camera in enumerate(world.rig):
        found = [
            simulated_keypoints(m, camera, config, rng=world.rng(14, c, person))
            for person, m in enumerate(motions)
        ]
        rows = sorted(
            (int(frame), person, points)
            for person, (m, own) in enumerate(zip(motions, found, strict=True))
            for frame, points in zip(m.frames, own, strict=True)
        )
        write_keypoints_csv(folder / "keypoints" / f"{camera.name}.csv", rows)


def _write_head(world: World, folder: Path) -> None:
    """calibration.toml and session.toml; the persons' heights are truth and stay out of them."""
    scene = world.scene
    write_calibration(
        folder / "calibration.toml", world.rig, metadata={"source": f"synthetic scene {scene.name}"}
    )
    lower, upper = ([float(x) for x in corner] for corner in scene.room.capture_m)
    text = f"fps = {float(scene.fps)}\nroom_bounds_m = [{lower}, {upper}]\n"
    (folder / "session.toml").write_text(text, encoding="utf-8")
