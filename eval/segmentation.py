"""Masks against exact silhouettes, kind of error by kind, and their cost beside OpenCV's MOG2: methods x sessions.

Ours, each camera on its own and with the second look of all together; OpenCV's MOG2 and KNN (both with shadow tests,
learnt from the empty clip, cleaned up like ours); ours on a temporal median and on one still picture. Sessions:
synthetic scenes, and ../shared/dev_sessions where they lie beside the checkout; settings were chosen on those
that are not in TEST. Writes eval/results/segmentation.csv.

    python -m eval.segmentation [--only demo,dev:walk] [--step 24] [--work out/eval]

Columns: IoU, precision, recall over all pixels of all cameras. Errors as shares of the person's pixels: `halo` and
`rim` lie within 2 px of the outline, outside and inside; further out, `contact` is darker than the background and near
the feet, `soft` is darker and elsewhere, `stray` is the rest; further in, `hole`. Milliseconds per picture and ratio to
MOG2 with shadows, in CPU time of one thread, measured in turns on the same pictures (clean-up included for all but the
bare MOG2 that the ratio refers to). About 10 s per session and method, after 30 s to synthesise a scene.
"""

from __future__ import annotations

import argparse
import statistics
import sys
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

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
from mocap.pipeline.shade import with_shadows_in
from mocap.pipeline.stages.segment import second_look

ROOT = Path(__file__).resolve().parents[1]
DEV = ROOT.parent / "shared" / "dev_sessions"
RESULTS = ROOT / "eval" / "results" / "segmentation.csv"
SCENES = ("demo", "gesture", "two_persons", "furnished_test")
DEV_SESSIONS = ("walk", "reach", "cross", "room", "furnished", "steps")
# No setting was chosen by looking at these.
TEST = ("dev:reach", "dev:steps")
METHODS = ("ours", "ours, median", "ours, still", "mog2", "knn")
LOOK = "ours, second look"
KINDS = ("halo", "contact", "soft", "stray", "rim", "hole")
FIELDS = ("session", "part", "method", "iou", "precision", "recall", *KINDS, "ms_per_image", "times_mog2")
MEDIAN_PICTURES = 50
RIM_PX = 2
DARKER = 0.95  # of the background's brightness
FEET = 0.2  # of the person's height in the picture: so far above his lowest pixel, and below it, and to both sides
TIMED = 20
INSTANTS = 8  # that tell how dark shadows get

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


class View(NamedTuple):
    """One camera: the background of every method, and every step-th picture with the true silhouette."""

    backgrounds: dict[str, Background]
    empty: list[Image]
    images: list[Image]
    truth: list[Mask]


def views(session: Session, step: int) -> list[View]:
    """The cameras of a session."""
    found = []
    for camera in session.rig:
        images = list(iter_clip(session.image_sources[camera.name], camera=camera.name))
        empty = list(iter_clip(session.background_sources[camera.name], camera=camera.name))
        with true_silhouettes(session, [camera.name]) as reader:
            truth = [masks[0] for _, masks in reader]
        backgrounds = {method: background_of(method, empty, images) for method in METHODS}
        found.append(View(backgrounds, empty[:TIMED], images[::step], truth[::step]))
    return found


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


def segmenters_of(session: Session, cameras: Sequence[View], method: str) -> list[Segmenter]:
    """A method's segmenters, which know how dark shadows get in the pictures."""
    settings = ForegroundSettings(method=method if method in ("mog2", "knn") else "gaussian")
    backgrounds = [view.backgrounds[method] for view in cameras]
    settings = with_shadows_in(instants(cameras), session, backgrounds, settings)
    return [Segmenter(background, settings) for background in backgrounds]


def instants(cameras: Sequence[View]) -> Iterator[list[Image]]:
    """Some pictures of all cameras, evenly spread."""
    n = min(len(view.images) for view in cameras)
    return ([view.images[i] for view in cameras] for i in range(0, n, max(1, n // INSTANTS)))


def evaluate(folder: Path, step: int) -> dict[str, dict[str, float]]:
    """Numbers of every method on one session; every step-th picture is scored."""
    session = open_session(folder)
    cameras = views(session, step)
    look = second_look(session)
    methods = METHODS if look is None else (METHODS[0], LOOK, *METHODS[1:])
    segmenters = {m: segmenters_of(session, cameras, m) for m in METHODS}
    counts = {m: np.zeros(1 + len(KINDS)) for m in methods}
    times: dict[str, list[float]] = {m: [] for m in methods}
    for i in range(min(len(view.truth) for view in cameras)):
        pictures = [view.images[i] for view in cameras]
        for m in METHODS:
            begun = time.thread_time()
            found = [s.segment(picture) for s, picture in zip(segmenters[m], pictures, strict=True)]
            times[m].append((time.thread_time() - begun) / len(found))
            masks = {m: [f.mask for f in found]}
            if m == "ours" and look is not None:
                begun = time.thread_time()
                masks[LOOK] = look.masks(masks[m], [f.shadow for f in found], [f.doubtful for f in found])
                times[LOOK].append(times[m][-1] + (time.thread_time() - begun) / len(found))
            for name, own in masks.items():
                for mask, view in zip(own, cameras, strict=True):
                    counts[name] += kinds(mask, view.truth[i], view.images[i], view.backgrounds["ours"].mean)
    theirs = bare_mog2(cameras)
    return {m: _row(counts[m], statistics.median(times[m]), theirs) for m in methods}


def bare_mog2(cameras: Sequence[View]) -> float:
    """Median seconds per picture of OpenCV's MOG2 with shadows and nothing else."""
    times = []
    for view in cameras:
        model: Any = cv2.createBackgroundSubtractorMOG2(detectShadows=True)
        for picture in view.empty:
            model.apply(picture)
        for picture in view.images[:TIMED]:
            begun = time.thread_time()
            model.apply(picture)
            times.append(time.thread_time() - begun)
    return statistics.median(times)


def kinds(mask: Mask, truth: Mask, picture: Image, background: NDArray[np.float32]) -> NDArray[np.float64]:
    """Pixels of the person that were found, then those of every kind of error, (1 + len(KINDS),).

    background : (H, W, 3) mean of the empty scene.
    """
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * RIM_PX + 1,) * 2)
    person = truth.astype(np.uint8)
    near, deep = cv2.dilate(person, disc) > 0, cv2.erode(person, disc) > 0
    far, missed = mask & ~near, truth & ~mask
    dark = picture.sum(axis=2) < DARKER * background.sum(axis=2)
    feet = _at_feet(person)
    parts = (
        mask & truth,
        mask & ~truth & near,
        far & dark & feet,
        far & dark & ~feet,
        far & ~dark,
        missed & ~deep,
        missed & deep,
    )
    return np.array([np.count_nonzero(part) for part in parts], dtype=np.float64)


def _at_feet(person: NDArray[np.uint8]) -> Mask:
    """Where contact shadows of the persons fall, (H, W) bool."""
    out = np.zeros(person.shape, dtype=np.bool_)
    _, _, stats, _ = cv2.connectedComponentsWithStats(person, connectivity=8)
    for x, y, w, h, _ in stats[1:].tolist():
        reach = round(FEET * h)
        out[max(y + h - reach, 0) : y + h + reach, max(x - reach, 0) : x + w + reach] = True
    return out


def _row(counts: NDArray[np.float64], seconds: float, theirs: float) -> dict[str, float]:
    hit, halo, contact, soft, stray, rim, hole = counts
    false, person = halo + contact + soft + stray, max(hit + rim + hole, 1)
    return {
        "iou": hit / max(false + person, 1),
        "precision": hit / max(hit + false, 1),
        "recall": hit / person,
        **{kind: count / person for kind, count in zip(KINDS, counts[1:], strict=True)},
        "ms_per_image": 1e3 * seconds,
        "times_mog2": theirs / seconds,
    }


def main(argv: list[str] | None = None) -> int:
    """Print the table and write the CSV."""
    parser = argparse.ArgumentParser(prog="python -m eval.segmentation", description=__doc__)
    parser.add_argument("--only", help="names of sessions, separated by commas")
    parser.add_argument("--step", type=int, default=24, help="every so many pictures are looked at")
    parser.add_argument("--work", type=Path, default=ROOT / "out" / "eval")
    options = parser.parse_args(argv)
    cv2.setNumThreads(1)
    only = set(options.only.split(",")) if options.only else None
    rows: list[dict[str, Any]] = []
    for name, folder in sessions(only, options.work):
        for method, numbers in evaluate(folder, options.step).items():
            part = "test" if name in TEST else "development"
            rounded = {k: round(v, 4) for k, v in numbers.items()}
            rows.append({"session": name, "part": part, "method": method} | rounded)
            print("  ".join(f"{rows[-1][field]!s:>12}" for field in FIELDS), flush=True)
    if not rows:
        print("no session is named like that", file=sys.stderr)
        return 2
    if only is None:
        write_csv(RESULTS, FIELDS, rows)
    return 0


if __name__ == "__main__":
    sys.exit(main())
