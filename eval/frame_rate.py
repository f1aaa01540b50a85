"""Films of fewer pictures a second: the same session with every n-th of its pictures.

    python -m eval.frame_rate [SESSION ...] [--seeds 3]     # two walks, among the development sessions
    python -m eval.frame_rate --test                        # scenes that nothing was chosen on

Every thinned session is run with the default preset. Columns: pictures a second, the error, mm, MMTA and MOTA
%, and landmarks that are wrong without a word. Writes
eval/results/frame_rate_{development,test}.csv, whole; what is in --work already is kept. Half a minute per run.
"""

from __future__ import annotations

import argparse
import csv
import shutil
from pathlib import Path

import cv2

from eval.session_tables import Row, names_of, session_of, session_parser, write_table
from eval.whole import write_text
from mocap.compare import CompareOptions, compare
from mocap.io.session import open_session
from mocap.io.video import iter_clip
from mocap.pipeline.config import load_config
from mocap.pipeline.run import run_session

_SHARED = Path("../shared/dev_sessions")
DEVELOPMENT = (str(_SHARED / "walk"), str(_SHARED / "room"))
TEST = ("walk_test", "jog_test", "box_test")
STRIDES = (1, 2, 3, 4, 6, 10, 15, 30)


def thinned(session: Path, stride: int, work: Path) -> Path:
    """The session with every stride-th picture, and its truth."""
    root = work / "thinned" / f"{session.name}-{stride}"
    if root.exists():
        return root
    begun = root.with_suffix(".part")
    shutil.rmtree(begun, ignore_errors=True)
    opened = open_session(session)
    for clip in sorted((session / "videos").iterdir()):
        folder = begun / "images" / clip.stem
        folder.mkdir(parents=True)
        for frame, picture in enumerate(iter_clip(clip)):
            if frame % stride == 0:
                to = folder / f"{frame // stride:05d}.png"
                cv2.imwrite(str(to), cv2.cvtColor(picture, cv2.COLOR_RGB2BGR))
    for name in ("background", "calibration.toml"):
        (begun / name).symlink_to((session / name).resolve())
    write_text(begun / "session.toml", f"fps = {opened.fps / stride}\n")
    (begun / "truth").mkdir()
    for name in ("landmarks.csv", "tracks.csv"):
        with (session / "truth" / name).open(encoding="utf-8", newline="") as stream:
            head, *rows = csv.reader(stream)
        kept = [[str(int(row[0]) // stride), *row[1:]] for row in rows if int(row[0]) % stride == 0]
        write_text(begun / "truth" / name, "\n".join(",".join(row) for row in (head, *kept)) + "\n")
    begun.rename(root)
    return root


def row_of(session: Path, stride: int, seed: int, work: Path) -> Row:
    """One run of a thinned session."""
    root = thinned(session, stride, work)
    out = work / "runs" / f"{root.name}-seed-{seed}"
    run_session(root, out, config=load_config("default", ("output.formats=[]",)), seed=seed, resume=True)
    scores = compare(out, root, CompareOptions()).scores
    return {
        "session": session.name,
        "pictures_per_s": round(open_session(root).fps, 2),
        "seed": seed,
        "mean_error_mm": round(scores["mean_error_mm"], 1),
        "mmta_percent": round(scores["mmta_percent"], 1),
        "mota_percent": round(scores["mota_percent"], 1),
        "silently_wrong": int(scores["silent_errors"]),
    }


def main() -> None:
    parser = session_parser(__doc__, "out/frame_rate")
    parser.add_argument("--seeds", type=int, default=1, help="runs of every thinned session")
    options: argparse.Namespace = parser.parse_args()
    rows: list[Row] = []
    for name in names_of(options, DEVELOPMENT, TEST):
        session = session_of(name, options.work)
        for stride in STRIDES:
            for seed in range(options.seeds):
                rows.append(row_of(session, stride, seed, options.work))
                print(rows[-1], flush=True)
    write_table("frame_rate", options, rows)


if __name__ == "__main__":
    main()
