"""Trackers by name, on clips of hulls: tracks and the time that a step takes."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from eval.tracking.hulls import HullClip
from mocap.data import Tracks
from mocap.pipeline.config import TrackingConfig
from mocap.pipeline.tracking import tracker_input, tracker_settings
from mocap.tracking import (
    FrameVoxels,
    Split,
    TrackerSettings,
    TrackerState,
    TrackInfo,
    track_step,
    tracks_from_history,
)
from mocap.tracking.features import person_tree

TREES = ("wide", "trained", "weight", "none")
SETTINGS = ("product", "published")
_WARM: set[tuple[str, bool, str]] = set()


@dataclass(frozen=True)
class Method:
    """A tracker and its settings.

    n_samples : particles or samples per person, 0 = the product's number.  settings : `product` or `published` (the
    filter's own estimate, no motion model, the ellipsoid alone, no repair of identities).
    on_cm : voxels that persons are tracked on, coarser than the hull's; 0 = the hull's.
    tree : person classifier: `wide` (the product's), `trained`, `weight` (15 kg and nothing else) or `none` (everything
        is a person).
    """

    tracker: str
    n_samples: int = 0
    colour: bool = False
    seed: int = 0
    settings: str = "product"
    on_cm: int = 0
    tree: str = "wide"

    @property
    def label(self) -> str:
        """As the source writes it: SS-Color."""
        short = {"naive": "Naive", "particle": "PF", "sparse": "SS"}[self.tracker]
        return f"{short}-{'Color' if self.colour else 'Raw'}"


@dataclass(frozen=True, eq=False)
class Outcome:
    """What a tracker did with a clip.

    tracks : offline, with what is known afterwards.  infos : of every step.  step_s : CPU seconds of all steps; of
    several runs the least, frame by frame.
    """

    tracks: Tracks
    infos: tuple[TrackInfo, ...]
    step_s: float


def observations(clip: HullClip, on_cm: int = 0) -> tuple[list[FrameVoxels], float]:
    """What the trackers are fed with, and the CPU seconds that it took.  on_cm : coarser voxels; 0 = the hull's."""
    started = time.process_time()
    seen = [tracker_input(frame, hull, on_cm / 100 or None).voxels for frame, hull in clip]
    return seen, time.process_time() - started


@cache
def tree_of(name: str) -> Split | bool:
    """A person classifier by name."""
    if name == "weight":
        return Split("weight_kg", 15.0, False, True)
    if name not in TREES:
        raise ValueError(f"tree must be one of {', '.join(TREES)}, got {name!r}")
    return True if name == "none" else person_tree(name)


def settings_of(method: Method, clip: HullClip) -> TrackerSettings:
    """The settings of a method for a clip, as `mocap` makes them."""
    config = TrackingConfig(
        tracker=method.tracker,  # type: ignore[arg-type]
        n_samples=method.n_samples or None,
        colour=method.colour,
        voxel_size_m=method.on_cm / 100 or None,
        published=method.settings == "published",
    )
    settings = tracker_settings(config, clip.hulls[0].grid, clip.fps, len(clip.frames))
    return replace(settings, person_tree=tree_of(method.tree))


def run_method(method: Method, seen: Sequence[FrameVoxels], clip: HullClip, *, n_runs: int = 1) -> Outcome:
    """One tracker over a clip; what is compiled on first use is compiled before the clock runs.

    n_runs : for the clock alone: the machine may do other work, and every run gives the same tracks.
    """
    kind = (method.tracker, method.colour, method.settings)
    if kind not in _WARM:
        _WARM.add(kind)
        run_method(method, seen[:: 1 + len(seen) // 40], clip)
    settings = settings_of(method, clip)
    least = np.full(len(seen), np.inf)
    for _ in range(n_runs):
        rng = np.random.default_rng(method.seed)
        state = TrackerState()
        infos = []
        for i, one in enumerate(seen):
            started = time.process_time()
            state, info = track_step(state, one, settings, rng=rng)
            least[i] = min(least[i], time.process_time() - started)
            infos.append(info)
    history = [(i.frame, i.tracks) for i in infos]
    tracks = tracks_from_history(history, clip.fps, min_seen=settings.confirm_frames)
    return Outcome(tracks, tuple(infos), float(least.sum()))
