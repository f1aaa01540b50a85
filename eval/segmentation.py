"""Masks against exact silhouettes, and their cost beside OpenCV's MOG2: methods x sessions.

Ours, OpenCV's MOG2 and KNN (both with shadow tests, learnt from the empty clip, cleaned up like ours), ours on a
temporal median and on one still picture. Sessions: synthetic scenes, and ../shared/dev_sessions where they lie beside
the checkout. Writes eval/results/segmentation.csv.

    python -m eval.segmentation [--only demo,dev:walk] [--step 6] [--work out/eval]

Columns: IoU, precision, recall over all pixels of all cameras; leak = foreground further than 4 px from the person, as
a share of the person; milliseconds per picture and ratio to MOG2 with shadows, in CPU time of one thread, measured in
turns on the same pictures (clean-up included for all but the bare MOG2 that the ratio refers to).
About 10 s per session and method, after 30 s to synthesise a scene.
"""

from __future__ import annotations

import argparse
import statistics
import sys
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from eval.whole import write_csv
from mocap.foreground import (
    Background,
    ForegroundSettings,
    Segmenter,
    learn_background,
    median_background,
)
from mocap.io.session import Session, open_session
from mocap.io.video import MaskReader, iter_clip

ROOT = Path(__file__).resolve().parents[1]
DEV = ROOT.parent / "shared" / "dev_sessions"
RESULTS = ROOT / "eval" / "results" / "segmentation.csv"
SCENES = ("demo", "gesture", "two_persons")
DEV_SESSIONS = ("walk", "reach", "cross", "room")
METHODS = ("ours", "ours, median", "ours, still", "mog2", "knn")
FIELDS = ("session", "method", "iou", "precision", "recall", "leak", "ms_per_image", "times_mog2")
MEDIAN_PICTURES = 50
NEAR_PX = 4
TIMED = 20

Image = NDArray[np.uint8]
Mask = NDArray[np.bool_]


def sessions(only: set[str] | None, work: Path) -> Iterator[tuple[str, Path]]:
    """Names and folders; scenes that are not there yet are synthesised."""
    names = [*SCENES, *(f"dev:{n}" for n in DEV_SESSIONS if (DEV / n).is_dir())]
    for name in names:
        if only is not None and name not in only:
            continue
        if name.startswith("dev:"):
            yield name, DEV / name.removeprefix("dev:")
            continue
        folder = work / "sessions" / name
        if not folder.exists():
            from mocap.synth import synthesise

            synthesise(name, folder)
        yield name, folder


def cameras(folder: Path) -> Iterator[tuple[list[Image], list[Image], list[Mask]]]:
    """Empty pictures, pictures and true silhouettes of one camera after the other."""
    session = open_session(folder)
    for camera in session.rig:
        images = list(iter_clip(session.image_sources[camera.name], camera=camera.name))
        empty = list(iter_clip(session.background_sources[camera.name], camera=camera.name))
        with true_silhouettes(session, [camera.name]) as reader:
            yield empty, images, [masks[0] for _, masks in reader]


def true_silhouettes(session: Session, cameras: Sequence[str] | None = None) -> MaskReader:
    """The exact silhouettes of a session with truth, of some of its cameras or of all."""
    rig = session.rig if cameras is None else session.rig.subset(cameras)
    truth = session.root / "truth"
    together = truth / "silhouettes.npz"
    sources = {c.name: together if together.exists() else truth / "masks" / f"{c.name}.npz" for c in rig}
    return MaskReader(sources, rig, session.frames)


def background_of(method: str, empty: list[Image], images: list[Image]) -> Background:
    if method == "ours, median":
        return median_background(images[:: max(1, len(images) // MEDIAN_PICTURES)])
    return learn_background(empty[:1] if method == "ours, still" else empty)


def evaluate(folder: Path, step: int) -> dict[str, dict[str, float]]:
    """Numbers of every method on one session; every step-th picture is scored."""
    counts = {method: np.zeros(4) for method in METHODS}
    times: dict[str, list[float]] = {key: [] for key in (*METHODS, "bare")}
    square = np.ones((2 * NEAR_PX + 1,) * 2, dtype=np.uint8)
    for empty, images, truth in cameras(folder):
        segmenters = {
            m: Segmenter(
                background_of(m, empty, images),
                ForegroundSettings(method=m if m in ("mog2", "knn") else "gaussian"),
            )
            for m in METHODS
        }
        bare: Any = cv2.createBackgroundSubtractorMOG2(detectShadows=True)
        for picture in empty:
            bare.apply(picture)
        for i in range(0, len(images), step):
            near = cv2.dilate(truth[i].astype(np.uint8), square) > 0
            for method, segmenter in segmenters.items():
                begun = time.thread_time()
                mask = segmenter.segment(images[i]).mask
                times[method].append(time.thread_time() - begun)
                counts[method] += (
                    np.count_nonzero(mask & truth[i]),
                    np.count_nonzero(mask & ~truth[i]),
                    np.count_nonzero(~mask & truth[i]),
                    np.count_nonzero(mask & ~near),
                )
            if i < TIMED * step:
                begun = time.thread_time()
                bare.apply(images[i])
                times["bare"].append(time.thread_time() - begun)
    theirs = statistics.median(times["bare"])
    return {m: _row(counts[m], statistics.median(times[m]), theirs) for m in METHODS}


def _row(counts: NDArray[np.float64], seconds: float, theirs: float) -> dict[str, float]:
    hit, false, missed, far = counts
    return {
        "iou": hit / (hit + false + missed),
        "precision": hit / max(hit + false, 1),
        "recall": hit / max(hit + missed, 1),
        "leak": far / max(hit + missed, 1),
        "ms_per_image": 1e3 * seconds,
        "times_mog2": theirs / seconds,
    }


def main(argv: list[str] | None = None) -> int:
    """Print the table and write the CSV."""
    parser = argparse.ArgumentParser(prog="python -m eval.segmentation", description=__doc__)
    parser.add_argument("--only", help="names of sessions, separated by commas")
    parser.add_argument("--step", type=int, default=6, help="every so many pictures are looked at")
    parser.add_argument("--work", type=Path, default=ROOT / "out" / "eval")
    options = parser.parse_args(argv)
    cv2.setNumThreads(1)
    only = set(options.only.split(",")) if options.only else None
    rows: list[dict[str, Any]] = []
    for name, folder in sessions(only, options.work):
        for method, numbers in evaluate(folder, options.step).items():
            rows.append({"session": name, "method": method} | {k: round(v, 4) for k, v in numbers.items()})
            print("  ".join(f"{rows[-1][field]!s:>12}" for field in FIELDS), flush=True)
    if not rows:
        print("no session is named like that", file=sys.stderr)
        return 2
    if only is None:
        write_csv(RESULTS, FIELDS, rows)
    return 0


if __name__ == "__main__":
    sys.exit(main())
