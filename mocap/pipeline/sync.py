"""Clocks of a session: when each clip began is found from people, light or sound, and written to session.toml."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Literal, TypeVar

import numpy as np
from numpy.typing import NDArray

from mocap.arrays import Image, Mask
from mocap.data import CameraRig
from mocap.errors import MocapError, did_you_mean
from mocap.io._files import atomic_text, writing
from mocap.io.session import OpenedClips, open_clips, read_session_settings
from mocap.io.session.settings import with_tables
from mocap.io.session.timeline import TIMESTAMPS_FILE, differing_rates, own_times
from mocap.io.sound import loudness_of
from mocap.io.tables import write_timestamps_csv
from mocap.io.video import MaskReader, iter_clip, times_in_container
from mocap.pipeline.empty_clips import fitted, frames_to_fit
from mocap.pipeline.silhouettes import foreground
from mocap.progress import Progress, no_progress
from mocap.threads import in_parallel
from mocap.volume.shared_signals import SOUND, Signal, light_settings, synchronise_signals
from mocap.volume.synchrony import Silhouettes, Synchrony, SynchronySettings, silhouette_hull, synchronise

if TYPE_CHECKING:
    from mocap.view.clock_curves import ClockCurve

Array = NDArray[np.float64]

_IRREGULAR = 0.5  # of a frame: time stamps further from an even rate are those of a clip of varying rate
_Told = TypeVar("_Told")
By = Literal["people", "light", "sound"]
_DRAWN: dict[By, str] = {"people": "tangent, m", "light": "brightness", "sound": "loudness"}
_NOTHING: dict[By, str] = {
    "people": "nobody moves where two cameras see it",
    "light": "no flash or lamp stands out in two cameras",
    "sound": "nothing stands out that two cameras heard",
}
_INSTEAD: dict[By, str] = {
    "people": "film somebody who walks through the room",
    "light": "flash a light into all cameras, or switch the lamp, once or at uneven intervals",
    "sound": "clap where all cameras hear it, once or at uneven intervals",
}
_COARSE = 8  # every so many pixels tell how bright a picture is


@dataclass(frozen=True, eq=False)
class SessionClocks:
    """The clocks that were found.

    fps : of the session.  own_times : camera -> (n,) s of its pictures on its own clock.  has_varying_rate : those
    whose containers say that their pictures do not follow at one rate.  by : what tells them.
    """

    found: Synchrony
    fps: float
    own_times: dict[str, Array]
    has_varying_rate: tuple[str, ...]
    by: By = "people"

    @property
    def off(self) -> tuple[str, ...]:
        """Cameras whose clock differs from the reference's."""
        return tuple(name for name, clock in self.found.clocks.items() if clock.is_off)

    def rate_of(self, name: str) -> float:
        """Pictures per second of the session."""
        times = self.own_times[name]
        own = (len(times) - 1) / (times[-1] - times[0]) if len(times) > 1 else self.fps
        return own / (1 + self.found.clocks[name].drift)


def find_clocks(
    session: Path | str,
    *,
    calibration: Path | str | None = None,
    by: By = "people",
    max_lag_s: float = SynchronySettings.max_lag_s,
    reference: str | None = None,
    n_threads: int | None = None,
    progress: Progress = no_progress,
) -> SessionClocks:
    """When the clips of a session began, and how fast their clocks run.

    by : "people" = silhouettes of people who move, which needs to know where cameras stand; "light" = a flash, or a
    lamp that is switched, in the pictures; "sound" = a clap, or whatever all cameras recorded.  The clips may differ in
    length and rate; what session.toml says of clocks is not looked at.  max_lag_s : largest lag that is looked for.
    reference : camera on whose clock frames are counted; None = the one that most others agree with.  n_threads : None
    = up to 2; the result does not depend on it.
    Raises MocapError for a session that cannot be opened, when no two cameras share anything that tells clocks, and for
    a reference that shares nothing.
    Source: Sinha and Pollefeys 2004 (people); cross-correlation of what stands out (light, sound).
    """
    clips = open_clips(session, calibration=calibration)
    if reference is not None and reference not in clips.rig.names:
        raise MocapError(
            f"the session has no camera {reference}{did_you_mean(reference, clips.rig.names)}",
            path=clips.root,
            remedy=f"use one of {', '.join(clips.rig.names)}",
        )
    times, varying = _own_times(clips)
    n_threads = n_threads or min(2, os.cpu_count() or 1)
    if by == "people":
        seen = _of_each_camera("silhouettes", _silhouettes, clips, times, n_threads, progress)
        found = synchronise(clips.rig, seen, SynchronySettings(max_lag_s=max_lag_s), reference=reference)
    else:
        signal = _brightness if by == "light" else _loudness
        signals = _of_each_camera(by, signal, clips, times, n_threads, progress)
        settings = SOUND if by == "sound" else light_settings(clips.fps)
        found = synchronise_signals(
            clips.rig.names, signals, settings, max_lag_s=max_lag_s, reference=reference
        )
    unsure = [name for name, clock in found.clocks.items() if not clock.is_certain]
    if len(unsure) == len(clips.rig):
        raise MocapError(
            f"no clock can be told: {_NOTHING[by]}",
            path=clips.root,
            remedy=f"{_INSTEAD[by]}, or write [offset_s] into session.toml by hand",
        )
    if reference in unsure:
        raise MocapError(
            f"its clock cannot be the reference: {_NOTHING[by]}",
            path=clips.root,
            camera=reference,
            remedy=f"leave --reference out, or name one of {', '.join(n for n in clips.rig.names if n not in unsure)}",
        )
    return SessionClocks(found, clips.fps, times, varying, by)


def _of_each_camera(
    stage: str,
    tells: Callable[[OpenedClips, str, Array], _Told],
    clips: OpenedClips,
    times: dict[str, Array],
    n_threads: int,
    progress: Progress,
) -> list[_Told]:
    """What each camera has to say of its clock, and word of it as `stage`."""
    done = iter(range(len(clips.rig)))

    def told(name: str) -> _Told:
        found = tells(clips, name, times[name])
        progress(stage, next(done) + 1, len(clips.rig))
        return found

    return in_parallel(told, clips.rig.names, n_threads)


def _silhouettes(clips: OpenedClips, name: str, times: Array) -> Silhouettes:
    """What a camera sees of people."""
    hulls = [silhouette_hull(mask) for mask in _masks(clips, name)]
    n = min(len(hulls), len(times))
    return Silhouettes(times[:n], hulls[:n])


def _brightness(clips: OpenedClips, name: str, times: Array) -> Signal:
    """How bright the pictures of a camera are."""
    if name not in clips.images:
        raise MocapError(
            "there are masks and no pictures, so that nothing tells how bright it was",
            path=clips.root,
            camera=name,
            remedy="leave --by light out: people tell clocks from masks too",
        )
    pictures = iter_clip(clips.images[name], size=clips.rig[name].size, camera=name)
    level = [float(picture[::_COARSE, ::_COARSE].mean()) for picture in pictures]
    n = min(len(level), len(times))
    return Signal(times[:n], np.array(level[:n]))


def _loudness(clips: OpenedClips, name: str, times: Array) -> Signal:
    """How loud it is in the clip of a camera; its first picture is the beginning of its clock."""
    del times
    if name not in clips.images:
        raise MocapError(
            "there is no clip with sound", path=clips.root, camera=name, remedy="use --by people"
        )
    return Signal(*loudness_of(clips.images[name], camera=name))


def write_clocks(session: Path | str, clocks: SessionClocks) -> tuple[Path, ...]:
    """Write what was found to session.toml, which every stage goes by, and time stamps of clips of varying rate.

    Tables [offset_s] and [clip_fps] of an earlier time are replaced, everything else stays as it is. Returns what was
    written; nothing is, when all clocks agree and no table has to go.
    """
    root = Path(session)
    written = []
    if clocks.has_varying_rate:
        write_timestamps_csv(root / TIMESTAMPS_FILE, clocks.own_times)
        written.append(root / TIMESTAMPS_FILE)
    path = root / "session.toml"
    before = path.read_text(encoding="utf-8") if path.exists() else ""
    after = with_tables(before, _tables(clocks))
    if after != before:
        atomic_text(path, after)
        read_session_settings(path)
        written.append(path)
    return tuple(written)


def write_picture(path: Path, clocks: SessionClocks) -> None:
    """Write a PNG: what each camera whose clock is off saw of its clearest plane, beside the other of that pair."""
    from mocap.view.clock_curves import plot_clocks

    with writing(path):
        path.write_bytes(plot_clocks([_clearest(clocks, name) for name in clocks.off]))


def _clearest(clocks: SessionClocks, name: str) -> ClockCurve:
    """The pair of curves of a camera that vary most, for as much of the time as is seen."""
    from mocap.view.clock_curves import ClockCurve

    names = tuple(clocks.found.clocks)
    c = names.index(name)
    mine = [(a, b) if a.camera == c else (b, a) for a, b in clocks.found.pairs if c in (a.camera, b.camera)]
    both = max(mine, key=lambda pair: min(np.isfinite(x.values).sum() * np.nanstd(x.values) for x in pair))
    found = [clocks.found.clocks[names[curve.camera]] for curve in both]
    return ClockCurve(
        names=(name, names[both[1].camera]),
        times_s=(both[0].times_s, both[1].times_s),
        on_clock_s=(found[0].on_clock(both[0].times_s), found[1].on_clock(both[1].times_s)),
        values=(both[0].values, both[1].values),
        what=_DRAWN[clocks.by],
        said=f"moved by {found[0].offset_s:+.3f} s",
    )


def _tables(clocks: SessionClocks) -> dict[str, str]:
    """Tables of session.toml by name, empty where there is nothing to say."""
    reference, off = clocks.found.reference, clocks.off
    offsets = [
        f"[offset_s]  # when each clip begins, on the clock of {reference}; found by `mocap sync`",
        *(f'"{name}" = {clocks.found.clocks[name].offset_s:.4f}' for name in off),
    ]
    is_drifting = any(clocks.found.clocks[name].drift for name in off) and not clocks.has_varying_rate
    rates = [
        f"[clip_fps]  # pictures per second on the clock of {reference}",
        *(f'"{name}" = {clocks.rate_of(name):.6f}' for name in clocks.found.clocks),
    ]
    return {
        "offset_s": "\n".join(offsets if off else ()),
        "clip_fps": "\n".join(rates if is_drifting else ()),
    }


def _own_times(clips: OpenedClips) -> tuple[dict[str, Array], tuple[str, ...]]:
    """Times of all pictures on their cameras' own clocks, and the cameras of varying rate."""
    counts = {name: clip.n_frames for name, clip in clips.clips.items()}
    times = own_times(clips.root, counts, differing_rates(clips.settings, clips.clips), clips.fps)
    even = times or {name: np.arange(n) / clips.fps for name, n in counts.items()}
    if (clips.root / TIMESTAMPS_FILE).exists():
        return even, ()
    varying = []
    for name, clip in clips.clips.items():
        stamps = times_in_container(clip.path)
        if stamps is not None and np.abs(stamps - even[name][: len(stamps)]).max() * clips.fps > _IRREGULAR:
            even[name] = stamps
            varying.append(name)
    return even, tuple(varying)


def _masks(clips: OpenedClips, name: str) -> Iterator[Mask]:
    """The foreground of one camera's whole clip."""
    camera = clips.rig[name]
    if name in clips.masks:
        with MaskReader(clips.masks, CameraRig((camera,)), range(clips.clips[name].n_frames)) as reader:
            yield from (masks[0] for _, masks in reader)
        return

    def pictures() -> Iterator[Image]:
        yield from iter_clip(clips.images[name], size=camera.size, camera=name)

    empty = None
    if name in clips.background:
        wanted = frames_to_fit(clips.clips[name].n_frames, clips.fps)
        some = list(islice(pictures(), wanted.start, wanted.stop, wanted.step))
        empty = fitted(clips.background[name], camera, some)
    yield from foreground(pictures, empty)
