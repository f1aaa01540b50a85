"""The 2D polygon world of XN and SW: articulated objects that move and deform, with exact corners and states.

A scene is drawn lazily, frame by frame, in memory; as files with

    python -m mocap.synth.polygons OUT [--arms 4] [--levels 4] [--objects 1] [--clutter 0] [--seed 0] [--video]

which writes OUT/frames/*.png (or OUT/frames.mp4), OUT/states.csv and OUT/corners.csv.
Source: XN 4.4.1, 6.2.1.1; SW 6.1. What the sources leave open (sizes, colours, speeds) is our choice. Strong motion is
as fast as the filters' random walk, weak motion half as fast: at twice that speed the filters with 50 particles lost
the object in every scene looked at, and errors were several times the published ones.
"""

from __future__ import annotations

import argparse
import csv
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from mocap.polygons.likelihood import (
    FOREGROUND_BIT,
    PolygonLikelihoodSettings,
    PolygonProblem,
    colour_bins,
    mark_runs,
    part_histograms,
)
from mocap.polygons.tree import PolygonTree, corner_positions, star_tree

Array = NDArray[np.float64]

# RGB. Background, roots, then the parts of arms; no two in the same colour bins.
PALETTE = np.array(
    [
        (90, 90, 90),
        (20, 20, 235),
        (235, 20, 20),
        (20, 235, 20),
        (235, 235, 20),
        (235, 20, 235),
        (20, 235, 235),
        (235, 130, 20),
        (235, 235, 235),
    ],
    dtype=np.uint8,
)
_BINS_OF_LABEL = colour_bins(PALETTE[None], np.zeros((1, len(PALETTE)), dtype=np.bool_))[0]
_N_ARM_COLOURS = len(PALETTE) - 2
_SHIFT_BITS = 4  # corners are drawn to 1/16 pixel

# Amplitudes around the home position, standard deviations.
_POSITION_PX = 25.0
_TURN_RAD = 0.6
_JOINT_RAD = 0.2  # so that neighbouring arms seldom meet: the filters' model knows no occlusion
_N_WAVES = 6


@dataclass(frozen=True)
class PolygonSceneSettings:
    """What moves and how.  An object has n_arms (|P_j|) arms of n_levels - 1 (K - 1) rectangles."""

    n_arms: int
    n_levels: int
    n_objects: int = 1
    width: int = 800
    height: int = 640
    n_frames: int = 300
    strong_frames: tuple[tuple[int, int], ...] = ((80, 120), (200, 250))
    """Intervals of strong motion, both ends included (XN 4.4.4; SW 6.4 has 50-150 and 200-250)."""
    strong_factor: float = 2.0
    """How much faster the same motion runs there."""
    speed_px: float = 0.5
    """Standard deviation of the weak speed in x and in y, px per frame."""
    speed_rad: float = 0.0125
    """Standard deviation of the weak speed of every angle, rad per frame."""
    n_clutter: int = 0
    """Rectangles and polygons in the objects' colours on the background (XN 6.2.1.1)."""
    is_clutter_known: bool = True
    """Whether the foreground is what differs from the empty picture; otherwise from plain grey, clutter included."""

    def __post_init__(self) -> None:
        for name in ("width", "height", "n_frames"):
            if getattr(self, name) < 1:
                raise ValueError(f"{name}: expected at least 1, got {getattr(self, name)}")
        for name in ("strong_factor", "speed_px", "speed_rad", "n_clutter"):
            if not getattr(self, name) >= 0:
                raise ValueError(f"{name}: expected a number >= 0, got {getattr(self, name)}")


SMALL = PolygonSceneSettings(
    n_arms=4, n_levels=4, width=640, height=480, n_frames=200, strong_frames=((80, 120),)
)
"""The 640 x 480 x 200 format of XN chapter 6."""


@dataclass(frozen=True, eq=False)
class PolygonScene:
    """A scene with its truth.

    states : (T, D) true states.  part_label, background : palette indices of the parts (P,) and of the empty
    picture (H, W).
    """

    settings: PolygonSceneSettings
    tree: PolygonTree
    states: Array
    part_label: NDArray[np.uint8]
    background: NDArray[np.uint8]

    @cached_property
    def corners(self) -> Array:
        """True corners (T, S, 2) px."""
        return corner_positions(self.tree, self.states)

    def labels(self, frame: int) -> NDArray[np.uint8]:
        """Palette indices (H, W) of one frame; parents are drawn over children, later objects over earlier ones."""
        picture = self.background.copy()
        points = np.rint(self.corners[frame] * (1 << _SHIFT_BITS)).astype(np.int32)
        parent = self.tree.layout.parent_of_part
        root_of = np.arange(len(parent))
        for p in np.flatnonzero(parent >= 0):
            root_of[p] = root_of[parent[p]]
        for p in np.lexsort((-np.arange(len(parent)), root_of)):
            own = points[self.tree.corner_start[p] : self.tree.corner_start[p + 1]]
            cv2.fillConvexPoly(picture, own, int(self.part_label[p]), cv2.LINE_8, _SHIFT_BITS)
        return picture

    def frame(self, frame: int) -> NDArray[np.uint8]:
        """One picture (H, W, 3) RGB."""
        return PALETTE[self.labels(frame)]

    def bins(self, frame: int) -> NDArray[np.uint16]:
        """Colour bins of a frame with its foreground: the pixels that differ from the empty picture, or from grey."""
        out = self._empty_bins.copy()
        low = np.maximum(np.floor(self.corners[frame].min(axis=0)).astype(np.int64) - 2, 0)
        high = np.maximum(np.ceil(self.corners[frame].max(axis=0)).astype(np.int64) + 3, 0)
        box = np.s_[low[1] : high[1], low[0] : high[0]]  # the objects; elsewhere the picture is empty
        labels = self.labels(frame)[box]
        foreground = np.where(labels != self._expected[box], FOREGROUND_BIT, np.uint16(0))
        out[box] = _BINS_OF_LABEL[labels] | foreground
        return out

    @cached_property
    def _expected(self) -> NDArray[np.uint8]:
        """Palette indices (H, W) of what is no foreground."""
        return self.background if self.settings.is_clutter_known else np.zeros_like(self.background)

    @cached_property
    def _empty_bins(self) -> NDArray[np.uint16]:
        """Colour bins of the empty picture (H, W)."""
        clutter = np.where(self.background != self._expected, FOREGROUND_BIT, np.uint16(0))
        return np.asarray(_BINS_OF_LABEL[self.background] | clutter)

    def problem(self, frame: int, settings: PolygonLikelihoodSettings | None = None) -> PolygonProblem:
        """The articulated problem of a frame; reference histograms are those of the true state in frame 0."""
        return PolygonProblem(
            self.tree, mark_runs(self.bins(frame)), self.reference, settings or PolygonLikelihoodSettings()
        )

    @cached_property
    def reference(self) -> Array:
        """Colour histograms (P, 24) of the parts in frame 0."""
        return part_histograms(self.tree, self.bins(0), self.states[:1])[0][0]


def make_polygon_scene(settings: PolygonSceneSettings, *, rng: np.random.Generator) -> PolygonScene:
    """A scene from its settings; the same generator state gives the same scene."""
    tree = star_tree(settings.n_arms, settings.n_levels, settings.n_objects)
    # Motion first, so that clutter changes nothing about it.
    states = _motion(tree, settings, rng=rng)
    level_and_arm = _arm_and_level(settings)
    label = np.array(
        [1 if level == 0 else 2 + (3 * arm + level) % _N_ARM_COLOURS for level, arm in level_and_arm]
        * settings.n_objects,
        dtype=np.uint8,
    )
    return PolygonScene(settings, tree, states, label, _background(settings, rng=rng))


def _arm_and_level(settings: PolygonSceneSettings) -> list[tuple[int, int]]:
    """(level, arm) of the parts of one object in layout order."""
    return [(0, 0)] + [(k, a) for k in range(1, settings.n_levels) for a in range(settings.n_arms)]


def _motion(tree: PolygonTree, settings: PolygonSceneSettings, *, rng: np.random.Generator) -> Array:
    """States (T, D): every column a sum of sines around its home, played faster in the strong intervals."""
    frames = np.arange(settings.n_frames)
    is_strong = np.zeros(settings.n_frames, dtype=np.bool_)
    for first, last in settings.strong_frames:
        is_strong |= (frames >= first) & (frames <= last)
    speed = np.where(is_strong, settings.strong_factor, 1.0)
    time = np.concatenate([[0.0], np.cumsum(speed[1:])])
    states = np.empty((settings.n_frames, tree.layout.n_columns))
    for column, name in enumerate(tree.layout.names):
        if tree.layout.is_circular[column]:
            home = 0.0
            amplitude = _TURN_RAD if name.endswith("theta") else _JOINT_RAD
            rate = settings.speed_rad / amplitude
        else:
            amplitude, rate = _POSITION_PX, settings.speed_px / _POSITION_PX
            m = int(name.split("_")[0].removeprefix("object")) if settings.n_objects > 1 else 0
            home = settings.height / 2
            if name.endswith("x"):
                home = settings.width * (m + 0.5) / settings.n_objects
        states[:, column] = home + _waves(time, amplitude, rate, rng=rng)
    return states


def _waves(time: Array, amplitude: float, rate: float, *, rng: np.random.Generator) -> Array:
    """A sum of sines with standard deviation `amplitude` and, of its slope, amplitude * rate, over a long time."""
    frequency = rng.uniform(0.5, 1.5, _N_WAVES)
    frequency *= rate / np.sqrt(np.mean(frequency**2))
    phase = rng.uniform(0.0, 2 * np.pi, _N_WAVES)
    return amplitude * np.sqrt(2.0 / _N_WAVES) * np.cos(np.outer(time, frequency) + phase).sum(axis=1)


def _background(settings: PolygonSceneSettings, *, rng: np.random.Generator) -> NDArray[np.uint8]:
    """Palette indices (H, W): grey, with rectangles and other convex polygons in the objects' colours."""
    picture = np.zeros((settings.height, settings.width), dtype=np.uint8)
    for _ in range(settings.n_clutter):
        center = rng.uniform((0.0, 0.0), (settings.width, settings.height))
        if rng.random() < 0.5:
            half = rng.uniform(6.0, 25.0, 2)
            shape = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * half
        else:
            angles = np.sort(rng.uniform(0.0, 2 * np.pi, rng.integers(3, 8)))
            shape = rng.uniform(10.0, 25.0) * np.column_stack([np.cos(angles), np.sin(angles)])
        turn = rng.uniform(0.0, 2 * np.pi)
        rotation = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
        points = np.rint((center + shape @ rotation.T) * (1 << _SHIFT_BITS)).astype(np.int32)
        cv2.fillConvexPoly(picture, points, int(rng.integers(1, len(PALETTE))), cv2.LINE_8, _SHIFT_BITS)
    return picture


def draw_outline(
    picture: NDArray[np.uint8], tree: PolygonTree, state: Array, colour: tuple[int, int, int] = (0, 0, 0)
) -> NDArray[np.uint8]:
    """A copy of a picture (H, W, 3) with the outlines of a state (D,)."""
    out = picture.copy()
    corners = np.rint(corner_positions(tree, state)[0] * (1 << _SHIFT_BITS)).astype(np.int32)
    for p in range(tree.layout.n_parts):
        own = corners[tree.corner_start[p] : tree.corner_start[p + 1]]
        cv2.polylines(out, [own], True, colour, 1, cv2.LINE_AA, _SHIFT_BITS)
    return out


def write_scene(scene: PolygonScene, out: Path, *, as_video: bool) -> None:
    """Frames as PNG or MP4 (25 frames per second), true states and true corners as CSV."""
    out.mkdir(parents=True, exist_ok=True)
    n = scene.settings.n_frames
    if as_video:
        size = (scene.settings.width, scene.settings.height)
        writer = cv2.VideoWriter(str(out / "frames.mp4"), cv2.VideoWriter.fourcc(*"mp4v"), 25.0, size)
        for t in range(n):
            writer.write(np.ascontiguousarray(scene.frame(t)[..., ::-1]))
        writer.release()
    else:
        (out / "frames").mkdir(exist_ok=True)
        for t in range(n):
            cv2.imwrite(str(out / "frames" / f"{t:06d}.png"), scene.frame(t)[..., ::-1])
    part = np.repeat(np.arange(scene.tree.layout.n_parts), np.diff(scene.tree.corner_start))
    with (out / "states.csv").open("w", newline="", encoding="utf-8") as stream:
        rows = csv.writer(stream)
        rows.writerow(["frame", *scene.tree.layout.names])
        rows.writerows([t, *(f"{x:.6f}" for x in state)] for t, state in enumerate(scene.states))
    with (out / "corners.csv").open("w", newline="", encoding="utf-8") as stream:
        rows = csv.writer(stream)
        rows.writerow(["frame", "part", "corner", "u_px", "v_px"])
        for t in range(n):
            for s, (u, v) in enumerate(scene.corners[t]):
                p = part[s]
                own = s - scene.tree.corner_start[p]
                rows.writerow([t, scene.tree.layout.parts[p], own, f"{u:.4f}", f"{v:.4f}"])


def main(argv: Sequence[str] | None = None) -> int:
    """Write a scene to a folder."""
    parser = argparse.ArgumentParser(
        prog="python -m mocap.synth.polygons", description=__doc__.split("\n")[0]
    )
    parser.add_argument("out", type=Path)
    parser.add_argument("--arms", type=int, default=4, help="|P_j|")
    parser.add_argument("--levels", type=int, default=4, help="K: arms have K - 1 parts")
    parser.add_argument("--objects", type=int, default=1)
    parser.add_argument("--clutter", type=int, default=0, help="polygons on the background")
    parser.add_argument("--small", action="store_true", help="640 x 480 x 200 instead of 800 x 640 x 300")
    parser.add_argument("--frames", type=int, help="fewer or more frames")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--video", action="store_true", help="one MP4 instead of PNG files")
    args = parser.parse_args(argv)
    settings = SMALL if args.small else PolygonSceneSettings(n_arms=4, n_levels=4)
    settings = replace(
        settings,
        n_arms=args.arms,
        n_levels=args.levels,
        n_objects=args.objects,
        n_clutter=args.clutter,
        n_frames=args.frames or settings.n_frames,
    )
    scene = make_polygon_scene(settings, rng=np.random.default_rng(args.seed))
    write_scene(scene, args.out, as_video=args.video)
    layout = scene.tree.layout
    sys.stdout.write(f"{args.out}: {layout.n_parts} parts, {layout.n_columns} numbers per state\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
