"""Masks when the light changes after the empty clip was filmed, or the pictures are poor: conditions x methods.

The pictures of a session are spoilt; IoU with the exact silhouettes, all pixels of all cameras. `uncompensated` is ours
without dividing the light out.  Writes eval/results/light.csv.

    python -m eval.light [--only demo,dev:walk] [--step 12] [--work out/eval]

Conditions: `exposure` swings by a quarter with a period of 45 frames; `white balance` moves red and blue by 15 %
against each other in 60 frames; `lamp` makes one side of the picture up to 40 % brighter from the middle of the clip
on; `flicker` draws two bands of 12 %, as lamps at 50 Hz do at short exposures; `noise` of 8 levels; `compression` as
JPEG of quality 20; `hard light` leaves 40 % of it in shadows. In the empty clip too: `no colours` leaves the brightness
alone, `dim` is noise of 14 levels. One to three minutes per session.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from eval.segmentation import INSTANTS, ROOT, TEST, View, sessions, views
from eval.whole import write_csv
from mocap.foreground import (
    ForegroundSettings,
    Segmenter,
    as_grey,
    brightness_of,
    grey_outline,
    learn_background,
)
from mocap.io.session import open_session
from mocap.pipeline.shade import with_shadows_in
from mocap.pipeline.stages.segment import second_look

RESULTS = ROOT / "eval" / "results" / "light.csv"
SESSIONS = {"demo", "dev:walk", "dev:reach"}
METHODS = {
    "uncompensated": ForegroundSettings(compensate_gain=False),
    "ours": ForegroundSettings(),
    "mog2": ForegroundSettings(method="mog2"),
    "knn": ForegroundSettings(method="knn"),
}
LOOK = "ours, second look"
FIELDS = ("session", "part", "condition", "uncompensated", "ours", LOOK, "mog2", "knn")

Image = NDArray[np.uint8]


def _lit(picture: Image, light: Any) -> Image:
    return np.clip(np.round(picture * light), 0, 255).astype(np.uint8)


def _lamp(picture: Image, frame: int, n: int, rng: np.random.Generator) -> Image:
    side = np.linspace(0, 1, picture.shape[1])[None, :, None]
    return _lit(picture, 1 + 0.4 * side) if frame >= n // 2 else picture


def _flicker(picture: Image, frame: int, n: int, rng: np.random.Generator) -> Image:
    rows = np.linspace(0, 2, picture.shape[0])[:, None, None]
    return _lit(picture, 1 + 0.12 * np.sin(2 * np.pi * (rows + 0.37 * frame)))


def _white_balance(picture: Image, frame: int, n: int, rng: np.random.Generator) -> Image:
    swing = 0.15 * np.sin(2 * np.pi * frame / 60)
    return _lit(picture, np.array([1 + swing, 1, 1 - swing]))


def _noisy(picture: Image, levels: float, rng: np.random.Generator) -> Image:
    return np.clip(np.round(picture + rng.normal(0, levels, picture.shape)), 0, 255).astype(np.uint8)


def _compressed(picture: Image, quality: int) -> Image:
    data = cv2.imencode(".jpg", picture[:, :, ::-1], [cv2.IMWRITE_JPEG_QUALITY, quality])[1]
    return cv2.cvtColor(cv2.imdecode(data, cv2.IMREAD_COLOR), cv2.COLOR_BGR2RGB)


def _hard(picture: Image, empty: NDArray[np.float32], person: NDArray[np.bool_]) -> Image:
    """The picture with shadows of a hard light, soft only at their rims; a person as he was."""
    near = cv2.dilate(person.astype(np.uint8), np.ones((5, 5), np.uint8)) > 0
    left = (picture.sum(axis=2, dtype=np.float32) + 1) / (empty.sum(axis=2) + 1)
    share = cv2.blur((~near).astype(np.float32), (9, 9))
    around = cv2.blur(np.where(near, np.float32(0), left), (9, 9)) / np.maximum(share, 1e-3)
    shade = np.clip((0.97 - np.where(share > 0.05, around, 1)) / 0.15, 0, 1)
    light = np.where(person | (shade == 0), 1, np.minimum((1 - 0.6 * shade) / np.maximum(around, 0.3), 1))
    return _lit(picture, light[..., None])


Spoil = Callable[[Image, int, int, np.random.Generator], Image]

CONDITIONS: dict[str, Spoil] = {
    "as recorded": lambda picture, frame, n, rng: picture,
    "exposure": lambda picture, frame, n, rng: _lit(picture, 1 + 0.25 * np.sin(2 * np.pi * frame / 45)),
    "white balance": _white_balance,
    "lamp": _lamp,
    "flicker": _flicker,
    "noise": lambda picture, frame, n, rng: _noisy(picture, 8, rng),
    "compression": lambda picture, frame, n, rng: _compressed(picture, 20),
}
HARD = "hard light"
# Of the camera: the empty clip is like that, too.
CAMERAS: dict[str, Spoil] = {
    "overexposed": lambda picture, frame, n, rng: _lit(picture, 1.8),
    "stored": lambda picture, frame, n, rng: _compressed(picture, 35),
    "no colours": lambda picture, frame, n, rng: as_grey(picture),
    "dim": lambda picture, frame, n, rng: _noisy(picture, 14, rng),
}


def evaluate(folder: Path, step: int) -> dict[str, dict[str, float]]:
    """IoU of every method under every condition."""
    session = open_session(folder)
    cameras = views(session, step)
    found: dict[str, dict[str, float]] = {}
    for condition, spoil in (CONDITIONS | CAMERAS | {HARD: CONDITIONS["as recorded"]}).items():
        rng = np.random.default_rng(0)
        n = len(session.frames)
        backgrounds = [
            learn_background(spoil(picture, 0, n, rng) for picture in view.empty)
            if condition in CAMERAS
            else view.backgrounds["ours"]
            for view in cameras
        ]
        are_grey = all(background.is_grey for background in backgrounds)
        look = second_look(session, are_grey=are_grey)
        counts = {name: np.zeros(2) for name in (*METHODS, LOOK)}
        seen = []
        for i in range(min(len(view.truth) for view in cameras)):
            pictures = [spoil(view.images[i], i * step, n, rng) for view in cameras]
            if condition == HARD:
                pictures = [
                    _hard(picture, background.mean, view.truth[i])
                    for picture, background, view in zip(pictures, backgrounds, cameras, strict=True)
                ]
            seen.append(pictures)
        segmenters = {}
        for name, settings in METHODS.items():
            told = with_shadows_in(seen[:: max(1, len(seen) // INSTANTS)], session, backgrounds, settings)
            segmenters[name] = [Segmenter(background, told) for background in backgrounds]
        for i, pictures in enumerate(seen):
            for name, own in segmenters.items():
                answers = [s.segment(picture) for s, picture in zip(own, pictures, strict=True)]
                masks = [a.mask for a in answers]
                counts[name] += _overlap(masks, cameras, i)
                if name == "ours" and look is not None:
                    looked = look.masks(masks, [a.shadow for a in answers], [a.doubtful for a in answers])
                    if are_grey:
                        looked = [
                            grey_outline(brightness_of(picture), brightness_of(s.background), mask)
                            for picture, s, mask in zip(pictures, own, looked, strict=True)
                        ]
                    counts[LOOK] += _overlap(looked, cameras, i)
        found[condition] = {name: hit / max(union, 1) for name, (hit, union) in counts.items()}
    return found


def _overlap(masks: list[NDArray[np.bool_]], cameras: list[View], i: int) -> NDArray[np.float64]:
    """Pixels in both and in either of masks and silhouettes."""
    pairs = [(mask, view.truth[i]) for mask, view in zip(masks, cameras, strict=True)]
    return np.array(
        [sum(np.count_nonzero(m & t) for m, t in pairs), sum(np.count_nonzero(m | t) for m, t in pairs)],
        dtype=np.float64,
    )


def main(argv: list[str] | None = None) -> int:
    """Print the table and write the CSV."""
    parser = argparse.ArgumentParser(prog="python -m eval.light", description=__doc__)
    parser.add_argument("--only", help="names of sessions, separated by commas")
    parser.add_argument("--step", type=int, default=12, help="every so many pictures are looked at")
    parser.add_argument("--work", type=Path, default=ROOT / "out" / "eval")
    options = parser.parse_args(argv)
    cv2.setNumThreads(1)
    rows: list[dict[str, Any]] = []
    for name, folder in sessions(set(options.only.split(",")) if options.only else SESSIONS, options.work):
        part = "test" if name in TEST else "development"
        for condition, numbers in evaluate(folder, options.step).items():
            rounded = {key: round(value, 4) for key, value in numbers.items()}
            rows.append({"session": name, "part": part, "condition": condition} | rounded)
            print("  ".join(f"{rows[-1][field]!s:>14}" for field in FIELDS), flush=True)
    if not rows:
        print("no session is named like that", file=sys.stderr)
        return 2
    if options.only is None:
        write_csv(RESULTS, FIELDS, rows)
    return 0


if __name__ == "__main__":
    sys.exit(main())
