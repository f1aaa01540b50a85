"""The clocks of a session: which picture of each clip shows a frame of the session.

Frame k of a session is the moment k / fps on the clock of the session, which is that of the cameras without an offset.
Without word of clocks, picture k of every clip shows frame k. Otherwise every frame is shown by each camera's picture
that was taken nearest to it. What says so: `[offset_s]` and `[clip_fps]` of session.toml, `timestamps.csv`, and headers
of videos that have different frame rates. `mocap sync` finds the offsets and writes them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mocap.errors import MocapError
from mocap.io._files import natural_key
from mocap.io.session.settings import SessionSettings, bad_key
from mocap.io.tables import read_timestamps_csv
from mocap.io.video import SAME_RATE, ClipInfo

Array = NDArray[np.float64]
TIMESTAMPS_FILE = "timestamps.csv"

_NEAR = 0.5 + 1e-6  # of the time between two pictures: further away there is no picture of a frame


@dataclass(frozen=True, eq=False)
class Timeline:
    """Which pictures belong together.

    first, stop : frames of the session that all cameras show.  clip_frames : camera -> (stop,) the picture of its clip
    that shows each frame, ascending; those before `first` mean nothing.  apart_s : camera -> largest and mean time
    between a frame and the picture that shows it.
    """

    first: int
    stop: int
    clip_frames: dict[str, NDArray[np.int64]]
    apart_s: dict[str, tuple[float, float]]


def clip_times(
    root: Path, settings: SessionSettings, counts: Mapping[str, int], headers: Mapping[str, float], fps: float
) -> dict[str, Array] | None:
    """When each picture was taken, (n,) s on the clock of the session; None when nothing is said about clocks.

    counts : camera -> pictures of its clip.  headers : camera -> frame rate that its file states, where that counts.
    Raises MocapError for cameras that are not known, and for a timestamps.csv that does not fit the clips.
    """
    offsets, rates = settings.offset_s or {}, settings.clip_fps or {}
    for key, table in (("offset_s", offsets), ("clip_fps", rates)):
        if strangers := [name for name in table if name not in counts]:
            what = f"names no camera with a clip ({', '.join(counts)})"
            raise bad_key(root / "session.toml", f"{key}.{strangers[0]}", what)
    own = own_times(root, counts, {**headers, **rates}, fps)
    if own is None and not offsets:
        return None
    own = own or {name: np.arange(n) / fps for name, n in counts.items()}
    return {name: offsets.get(name, 0.0) + own[name] for name in counts}


def own_times(
    root: Path, counts: Mapping[str, int], rates: Mapping[str, float], fps: float
) -> dict[str, Array] | None:
    """When each picture was taken on its camera's own clock, (n,) s; None when all clips run at the session's rate."""
    if (root / TIMESTAMPS_FILE).exists():
        return _stamped(root / TIMESTAMPS_FILE, counts)
    if not rates:
        return None
    return {name: np.arange(n) / rates.get(name, fps) for name, n in counts.items()}


def differing_rates(settings: SessionSettings, clips: Mapping[str, ClipInfo]) -> dict[str, float]:
    """Frame rates of the headers, when they differ and the user has not said what holds for all."""
    found = {name: clip.fps for name, clip in clips.items() if clip.fps is not None}
    if settings.fps is not None or not found or len(found) < len(clips):
        return {}
    return found if max(found.values()) > (1 + SAME_RATE) * min(found.values()) else {}


def _stamped(path: Path, counts: Mapping[str, int]) -> dict[str, Array]:
    stamps = read_timestamps_csv(path)
    start = min(times[0] for times in stamps.values())
    out = {}
    for name, n in counts.items():
        times = stamps.get(name, stamps.get(name.removeprefix("cam_").removeprefix("port_")))
        if times is None:
            raise MocapError(
                f"there are no time stamps for it; the file has {', '.join(sorted(stamps, key=natural_key))}",
                path=path,
                camera=name,
                remedy="add its rows (cam_id, frame_time), or take the file away",
            )
        if len(times) != n:
            raise MocapError(
                f"{len(times)} time stamps for a clip of {n} frames",
                path=path,
                camera=name,
                remedy="use the time stamps of this very clip, one per frame",
            )
        out[name] = times - start
    return out


def timeline(root: Path, times: Mapping[str, Array], fps: float) -> Timeline:
    """Every frame that all cameras show, each camera by the picture taken nearest to it.

    times : camera -> (n,) s, ascending, on the clock of the session.
    Raises MocapError when there is no moment that all clips show.
    """
    begin = {name: t[0] - _NEAR * max(_period(t), 1 / fps) for name, t in times.items()}
    end = {name: t[-1] + _NEAR * max(_period(t), 1 / fps) for name, t in times.items()}
    first = max(0, int(np.ceil(max(begin.values()) * fps)))
    stop = int(np.floor(min(end.values()) * fps)) + 1
    if stop <= first:
        late, early = max(begin, key=begin.__getitem__), min(end, key=end.__getitem__)
        raise MocapError(
            f"no moment is in all clips: that of {early} ends {end[early]:.2f} s after the start of the session, that "
            f"of {late} begins at {begin[late]:.2f} s",
            path=root / "session.toml",
            camera=late,
            remedy="correct [offset_s], or leave a camera out with cameras = [...]",
        )
    moments = np.arange(stop) / fps
    clip_frames = {name: nearest(t, moments) for name, t in times.items()}
    apart = {name: np.abs(times[name][k] - moments)[first:] for name, k in clip_frames.items()}
    return Timeline(
        first, stop, clip_frames, {name: (float(a.max()), float(a.mean())) for name, a in apart.items()}
    )


def nearest(times: Array, moments: Array) -> NDArray[np.int64]:
    """Place (m,) of the time nearest to each moment; of two that are equally near, the earlier."""
    return np.searchsorted((times[1:] + times[:-1]) / 2, moments, side="left").astype(np.int64)


def _period(times: Array) -> float:
    return float(np.median(np.diff(times))) if len(times) > 1 else 0.0
