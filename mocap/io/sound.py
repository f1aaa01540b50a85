"""Sound of clips: how loud it is, millisecond by millisecond."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from mocap.arrays import Array
from mocap.errors import MissingExtra, MocapError
from mocap.io.video import clip_info, list_chapters

STEP_S = 0.001
_RATE = 8000  # samples per second that are looked at: a clap is as clear in them, and they cost less
_LONGEST_S = 12 * 3600  # of a clip
_SILENCE = 1e-4  # of the loudest that can be recorded; what is less is noise of the recorder
_OTHERWISE = "use --by light or --by people"


def loudness_of(path: Path, *, camera: str = "") -> tuple[Array, Array]:
    """Times (n,) s from the first picture on, and loudness (n,), decibels of the loudest possible.

    Needs the extra `sound` (PyAV). Raises MocapError for a clip without sound, one that cannot be read, and where PyAV
    is missing.
    """
    if chapters := list_chapters(path):
        return _of_chapters(chapters, camera)
    if path.is_dir():
        raise MocapError("pictures in a folder have no sound", path=path, camera=camera, remedy=_OTHERWISE)
    begins, wave = _wave(path, camera)
    per_step = round(STEP_S * _RATE)
    n_steps = len(wave) // per_step
    if n_steps < 2:
        raise MocapError("the clip has no sound", path=path, camera=camera, remedy=_OTHERWISE)
    power = np.square(wave[: n_steps * per_step].reshape(n_steps, per_step)).mean(axis=1)
    level = np.asarray(10 * np.log10(power + _SILENCE**2), dtype=np.float64)
    times = begins + STEP_S * (np.arange(n_steps, dtype=np.float64) + 0.5)
    return np.asarray(times, dtype=np.float64), level


def _of_chapters(chapters: Sequence[Path], camera: str) -> tuple[Array, Array]:
    """Of videos that follow each other without a gap."""
    times, levels, begins = [], [], 0.0
    for chapter in chapters:
        own_times, own_level = loudness_of(chapter, camera=camera)
        info = clip_info(chapter, camera=camera)
        length = info.n_frames / info.fps if info.fps else float(own_times[-1])
        # Sound may go on for a moment after the last picture; the next chapter has it too.
        is_own = own_times < length
        times.append(begins + own_times[is_own])
        levels.append(own_level[is_own])
        begins += length
    return np.concatenate(times), np.concatenate(levels)


def _wave(path: Path, camera: str) -> tuple[float, Array]:
    """When the sound begins, s after the first picture, and samples (n,) of -1 to 1 at `_RATE`; (0,) without sound."""
    try:
        import av
    except ImportError as error:
        raise MissingExtra(
            "sound needs PyAV, which is not installed", "sound", otherwise=_OTHERWISE
        ) from error
    parts: list[Array] = []
    begins = pictures_begin = 0.0
    try:
        with av.open(str(path)) as container:
            if container.streams.video and container.streams.video[0].start_time:
                video = container.streams.video[0]
                pictures_begin = float(video.start_time * video.time_base)
            resampler = av.AudioResampler(format="flt", layout="mono", rate=_RATE)
            for frame in container.decode(audio=0) if container.streams.audio else ():
                if not parts:
                    begins = float(frame.time or 0.0)
                parts += [part.to_ndarray().ravel().astype(np.float64) for part in resampler.resample(frame)]
                if (frame.time or 0.0) > _LONGEST_S:
                    raise MocapError(
                        "its sound is longer than 12 hours", path=path, camera=camera, remedy="cut it"
                    )
    except (av.FFmpegError, OSError, ValueError) as error:
        raise MocapError(
            f"its sound cannot be read: {error}", path=path, camera=camera, remedy=_OTHERWISE
        ) from error
    return begins - pictures_begin, np.concatenate(parts) if parts else np.zeros(0)
