"""Are clocks found from silhouettes, and what is the correction worth? Scenes filmed by unsynchronised cameras.

    python -m eval.synchrony                    # development scenes
    python -m eval.synchrony --test             # the scenes kept for the final judgement
    python -m eval.synchrony SESSION [...]      # sessions with truth/, clips cut by whole frames
    python -m eval.synchrony --no-poses         # clocks only

Every camera but the first begins up to a quarter of a second early or late, by a fraction of a frame, and its clock
drifts by up to 50 ppm; a clip of a given session is cut by up to eight frames. Each session is run as it was filmed,
and after `mocap sync`; its synchronised twin is the measure. Writes eval/results/synchrony_{development,test}.csv
(--name: another name). Synthesises what is not in --work yet (two minutes a scene).
"""

from __future__ import annotations

import json
import shutil
import sys
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

from eval.session_tables import N_FRAMES, Row, names_of, session_of, session_parser, write_table
from eval.whole import write_text
from mocap.errors import MocapError
from mocap.io.session import open_clips
from mocap.io.video import iter_clip
from mocap.pipeline.config import load_config
from mocap.pipeline.run import run_session
from mocap.pipeline.sync import SessionClocks, find_clocks, write_clocks
from mocap.synth import synthesise
from mocap.synth.scene import load_scene

DEVELOPMENT = ("walk", "gesture")
TEST = ("walk_final", "jog_test")
MOST_OFFSET_S, MOST_DRIFT_MS_PER_S = 0.25, 0.05
MOST_CUT = 8


def unsynchronised(name: str, work: Path, seed: int) -> tuple[Path, Path, dict[str, tuple[float, float]]]:
    """A scene filmed twice, synchronised and not; true offsets (s) and drifts of the second."""
    rng = _draws(name, seed)
    scene = load_scene(name).model_copy(update={"n_frames": N_FRAMES})
    twin = session_of(name, work)
    names = open_clips(twin).rig.names
    true = {
        n: (float(rng.uniform(-1, 1)) * MOST_OFFSET_S, float(rng.uniform(-1, 1)) * MOST_DRIFT_MS_PER_S)
        for n in names[1:]
    }
    faults = [
        {"kind": "offset", "camera": n, "offset_s": o, "drift_ms_per_s": d} for n, (o, d) in true.items()
    ]
    root = work / "sessions" / f"{name}_unsynchronised_{seed}"
    if not (root / "calibration.toml").exists():
        document = {**scene.model_dump(exclude_unset=True), "faults": faults}
        synthesise(type(scene).model_validate(document), root)
    return twin, root, {n: (o, d / 1000) for n, (o, d) in true.items()}


def cut(session: Path, work: Path, seed: int) -> tuple[Path, Path, dict[str, tuple[float, float]]]:
    """A given session, and the same with clips that begin later by whole frames."""
    rng = _draws(session.name, seed)
    clips = open_clips(session)
    root = work / "sessions" / f"{session.name}_unsynchronised_{seed}"
    n_cut = {n: int(rng.integers(0, MOST_CUT + 1)) if i else 0 for i, n in enumerate(clips.rig.names)}
    if not root.exists():
        shutil.copytree(session, root, ignore=shutil.ignore_patterns("videos", "images", "masks"))
        for name, n in n_cut.items():
            folder = root / "images" / name
            folder.mkdir(parents=True)
            for k, picture in enumerate(iter_clip(clips.images[name], camera=name)):
                if k >= n:
                    cv2.imwrite(str(folder / f"{k:05d}.png"), picture[:, :, ::-1])
        if clips.settings.fps is None:
            path = root / "session.toml"
            before = path.read_text(encoding="utf-8") if path.exists() else ""
            write_text(path, f"fps = {clips.fps:g}\n{before}")
    return session, root, {n: (k / clips.fps, 0.0) for n, k in n_cut.items()}


def _draws(name: str, seed: int) -> np.random.Generator:
    """Random numbers of a session, whatever else is run."""
    return np.random.default_rng([seed, *name.encode()])


def clock_errors(clocks: SessionClocks, true: dict[str, tuple[float, float]]) -> dict[str, float | int]:
    """Largest and root mean square error of the offsets, ms, and of the times at the end of the clip."""
    names = list(clocks.found.clocks)
    found = np.array([[c.offset_s, c.drift] for c in clocks.found.clocks.values()])
    truth = np.array([true.get(n, (0.0, 0.0)) for n in names])
    reference = names.index(clocks.found.reference)
    error = found - (truth - truth[reference])
    end = max(t[-1] for t in clocks.own_times.values())
    at_end = error[:, 0] + error[:, 1] * end
    return {
        "offset_error_ms": round(1000 * float(np.sqrt((error[:, 0] ** 2).mean())), 2),
        "worst_ms": round(1000 * float(np.abs(error[:, 0]).max()), 2),
        "worst_at_end_ms": round(1000 * float(np.abs(at_end).max()), 2),
    }


def pose_error(root: Path, out: Path) -> dict[str, float | None]:
    """Mean error and MMTA of a run; None where it cannot be run as it is."""
    config = load_config("default", ("output.formats=[]",))
    try:
        run_session(root, out, config=config)
    except MocapError:
        return {"mean_error_mm": None, "mmta_percent": None}
    scores = json.loads((out / "run.json").read_text(encoding="utf-8")).get("scores") or {}
    return {name: round(scores[name], 1) for name in ("mean_error_mm", "mmta_percent")}


def evaluate(name: str, work: Path, seed: int, with_poses: bool) -> Row:
    """One session: clocks of its twin and its own, and poses before and after."""
    given = Path(name)
    twin, root, true = cut(given, work, seed) if given.is_dir() else unsynchronised(name, work, seed)
    write_text(root / "session.toml", _without_clocks(root))
    healthy = find_clocks(twin)
    # Truth counts frames on the clock of the first camera.
    clocks = find_clocks(root, reference=open_clips(root).rig.names[0])
    row: Row = {"session": twin.name, "seed": seed, "false_corrections": len(healthy.off)}
    row |= {"healthy_worst_ms": clock_errors(healthy, {})["worst_ms"]}
    row |= clock_errors(clocks, true)
    if with_poses:
        runs = work / "runs" / f"{twin.name}_{seed}"
        row |= {f"synchronised_{k}": v for k, v in pose_error(twin, runs / "synchronised").items()}
        row |= {f"as_filmed_{k}": v for k, v in pose_error(root, runs / "as_filmed").items()}
        write_clocks(root, clocks)
        row |= {f"corrected_{k}": v for k, v in pose_error(root, runs / "corrected").items()}
    return row


def _without_clocks(root: Path) -> str:
    """session.toml before `mocap sync`."""
    path = root / "session.toml"
    return path.read_text(encoding="utf-8").partition("[offset_s]")[0] if path.exists() else ""


def main(arguments: Sequence[str] | None = None) -> int:
    """Write the table."""
    parser = session_parser(__doc__, "out/synchrony")
    parser.add_argument("--no-poses", action="store_true", help="clocks only")
    parser.add_argument("--seeds", type=int, default=1, help="draws of clocks per session")
    options = parser.parse_args(arguments)
    rows = []
    for name in names_of(options, DEVELOPMENT, TEST):
        for seed in range(options.seeds):
            rows.append(evaluate(name, options.work, seed, not options.no_poses))
            print(rows[-1], flush=True)
    write_table("synchrony", options, rows)
    return 0


if __name__ == "__main__":
    sys.exit(main())
