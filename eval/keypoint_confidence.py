"""What another meaning of confidence costs: poses from keypoints alone, with confidences that are not MediaPipe's.

    python -m eval.keypoint_confidence      # some minutes; needs ../shared/dev_sessions

Deviations were fitted to MediaPipe's confidence (`python -m eval.keypoint_places`). Other tools mean something else by
theirs: it is lower, has no upper bound, or is the same for all points. The detections of `walk` and `reach` before
three cameras are given such confidences; places stay as they are.
"""

from __future__ import annotations

import argparse
import csv
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from eval.evidence import DEV, FIELDS, RESULTS, ROOT, Case, scores, some_cameras
from eval.whole import write_csv, write_text
from mocap.io.tables import read_landmarks_csv
from mocap.pipeline.config import load_config
from mocap.pipeline.run import run_session
from mocap.pose.result import motion_of

SESSIONS = ("walk", "reach")
N_CAMERAS = 3
MEANINGS: dict[str, Callable[[float, np.random.Generator], float]] = {
    "as they are": lambda c, rng: c,
    "a third": lambda c, rng: c / 3,
    "three times": lambda c, rng: 3 * c,
    "all 1": lambda c, rng: 1.0,
    "all 0.5": lambda c, rng: 0.5,
    "random": lambda c, rng: float(rng.uniform(0.05, 1.0)),
    "exchanged for doubt": lambda c, rng: max(1.02 - c, 0.01),
}
_SCORES = FIELDS[-4:-1]


def main(arguments: Sequence[str] | None = None) -> None:
    """Run every session with every meaning, and write the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--work", type=Path, default=ROOT / "out" / "keypoint_confidence")
    work = parser.parse_args(arguments).work
    if not DEV.is_dir():
        parser.error("the development sessions (../shared/dev_sessions) are not there")
    rows = []
    for session in SESSIONS:
        for meaning in MEANINGS:
            rows.append({"session": session, "confidence": meaning, **measure(session, meaning, work)})
            print(rows[-1], flush=True)
    write_csv(RESULTS / "keypoint_confidence.csv", ("session", "confidence", *_SCORES), rows)


def measure(session: str, meaning: str, work: Path) -> dict[str, object]:
    """The scores of one run."""
    folder = some_cameras(Case(session, N_CAMERAS, "keypoints", 0), work / meaning.replace(" ", "_"))
    source, own = (folder / "keypoints").resolve(), folder / "keypoints"
    if own.is_symlink():
        own.unlink()
        own.mkdir()
        rng = np.random.default_rng(0)
        for path in sorted(source.glob("*.csv")):
            write_text(own / path.name, with_confidence(path, lambda c: MEANINGS[meaning](c, rng)))
    config = load_config("default", ("output.formats=[]", "observation=keypoints"))
    out = folder.parent / f"{folder.name}_out"
    result = run_session(folder, out, config=config, seed=0, until="pose", n_threads=1)
    found = [motion_of(p, result.session.fps) for p in result.poses]
    truth = read_landmarks_csv(folder / "truth" / "landmarks.csv")
    of_all = scores(found, truth, len(result.session.frames))
    return {name: of_all[name] for name in _SCORES}


def with_confidence(path: Path, meant: Callable[[float], float]) -> str:
    """A table of keypoints with other confidences."""
    head, *rows = csv.reader(path.read_text(encoding="utf-8").splitlines())
    at = head.index("confidence")
    lines = [",".join([*row[:at], f"{meant(float(row[at])):.4f}", *row[at + 1 :]]) for row in rows]
    return "\n".join([",".join(head), *lines]) + "\n"


if __name__ == "__main__":
    main()
