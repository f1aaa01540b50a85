"""Sizes, frames and frame rate of a session: what its clips have in common."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mocap.data import Camera, CameraRig
from mocap.errors import MocapError
from mocap.io.calibration import CalibrationFile
from mocap.io.keypoints import count_frames
from mocap.io.session.timeline import Timeline
from mocap.io.tables import read_detections_csv
from mocap.io.video import ClipInfo, Size, size_error

DEFAULT_FPS = 30.0
# Between slower pictures people who walk have changed places (python -m eval.frame_rate).
SLOWEST_FPS = 1.0
# Headers of sound videos promise a few frames more than can be decoded; more than that means a damaged file.
MAX_HEADER_DIFFERENCE = 5
MAX_HEADER_DIFFERENCE_SHARE = 0.01
_BLOCK_PX = 16  # side of a macroblock of MPEG-4 and H.264
_MOST_LONGER = (
    2.0  # frames by which clips of different rates end apart though they were started and stopped together
)


def rig_with_true_sizes(rig: CameraRig, found: CalibrationFile, clips: Mapping[str, ClipInfo]) -> CameraRig:
    """Where the calibration file gave no size, or that of padded pictures, the pictures do."""
    cameras = [
        Camera(c.name, clips[c.name].size, c.K, c.dist, c.R, c.t, c.is_fisheye)
        if c.name in clips and (c.name in found.guessed_sizes or _is_padding(c.size, clips[c.name].size))
        else c
        for c in rig
    ]
    return CameraRig(tuple(cameras))


def _is_padding(stated: Size, found: Size) -> bool:
    """Whether a size is another one, (width, height) px, with its sides padded to whole blocks of a codec.

    Codecs store 1088 rows for 1080, below or to the right; what is shown keeps its place.
    """
    return stated != found and stated == tuple(-(-side // _BLOCK_PX) * _BLOCK_PX for side in found)


def check_clip_size(clip: ClipInfo, camera: Camera) -> None:
    """MocapError unless the pictures of a clip are as large as the calibration says."""
    # An archive of packed masks does not always know its width; the reader checks it again.
    is_packed = clip.path.suffix.lower() == ".npz" and clip.size[0] == (camera.size[0] + 7) // 8
    if clip.size != camera.size and not (is_packed and clip.size[1] == camera.size[1]):
        raise size_error(clip.size, camera.size, clip.path, camera.name)


def choose_frames(
    root: Path,
    clips: Mapping[str, ClipInfo],
    detections: Mapping[str, Path],
    wanted: tuple[int | None, int | None] | None,
) -> range:
    """The frames to work on: those that all clips have, or the wanted part of them.

    clips : by name; without any, the files of detections or keypoints tell.  wanted : (start, stop), None = from the
    first, to the last.
    Raises MocapError for a range outside the clips, clips of different length, and a clip that was cut off.
    """
    counts = frame_counts(clips, detections)
    shortest = min(counts.values())
    start, stop = wanted or (None, None)
    last = shortest if stop is None else stop
    if last < 1 or not 0 <= (start or 0) < last:
        raise _bad_range(root, start, stop, "is empty", shortest)
    if stop is not None and stop > shortest:
        short = min(counts, key=counts.__getitem__)
        where = f"ends after frame {shortest - 1} of camera {short}, which has {shortest} frames"
        raise _bad_range(root, start, stop, f"goes beyond the clips: the session {where}", shortest, short)
    if stop is None:
        _check_cut_off(clips, shortest)
        _check_equal(root, counts)
    return range(start or 0, last)


def frames_of_timeline(root: Path, clocks: Timeline, wanted: tuple[int | None, int | None] | None) -> range:
    """The frames that all cameras show at their times, or the wanted part of them.

    Raises MocapError for a range outside of them.
    """
    start, stop = wanted or (None, None)
    chosen = range(clocks.first if start is None else start, clocks.stop if stop is None else stop)
    if not clocks.first <= chosen.start < chosen.stop <= clocks.stop:
        text = f"{'' if start is None else start}:{'' if stop is None else stop}"
        raise MocapError(
            f"the frame range {text} is empty or goes beyond what all clips show",
            path=root,
            remedy=f"choose it within `--frames {clocks.first}:{clocks.stop}`",
        )
    return chosen


def check_durations(
    root: Path, clips: Mapping[str, ClipInfo], times: Mapping[str, NDArray[np.float64]]
) -> None:
    """MocapError when clips of different rates, of which nobody said when they began, are not equally long."""
    last = {name: float(t[-1]) for name, t in times.items()}
    shortest, longest = min(last, key=last.__getitem__), max(last, key=last.__getitem__)
    if last[longest] - last[shortest] > _MOST_LONGER / min(c.fps or DEFAULT_FPS for c in clips.values()):
        raise MocapError(
            f"the clip is {last[shortest]:.2f} s long, that of {longest} {last[longest]:.2f} s; were they started "
            "together?",
            path=root,
            camera=shortest,
            remedy="let `mocap sync` find when each began, or say it in session.toml: [offset_s]",
        )


def frame_counts(clips: Mapping[str, ClipInfo], detections: Mapping[str, Path]) -> dict[str, int]:
    """Frames by clip; where there are only detections, as many as the longest table of them has.

    Raises MocapError when all of them are empty.
    """
    if clips:
        return {name: clip.n_frames for name, clip in clips.items()}
    longest = max(_detected_frames(path) for path in detections.values())
    if not longest:
        first = min(detections, key=detections.__getitem__)
        raise MocapError(
            "no camera's file has a frame in it",
            path=detections[first],
            camera=first,
            remedy="write the files again with the tool they come from",
        )
    return dict.fromkeys(detections, longest)


def _check_equal(root: Path, counts: Mapping[str, int]) -> None:
    shortest = min(counts.values())
    if max(counts.values()) > shortest:
        # One lost frame shifts the rest of a clip: only the user can say which frames belong together.
        pairs = ", ".join(f"{n}: {c}" for n, c in counts.items())
        raise MocapError(
            f"the clips have different numbers of frames ({pairs}); were they started together?",
            path=root,
            camera=min(counts, key=counts.__getitem__),
            remedy=f"if they are synchronised from the first frame on, say so with `--frames 0:{shortest}`; if not, "
            "let `mocap sync` find when each began",
        )


def _check_cut_off(clips: Mapping[str, ClipInfo], shortest: int) -> None:
    """A header that promises far more than can be decoded means a damaged file."""
    for name, clip in clips.items():
        if clip.header_frames is None:
            continue
        promised = clip.header_frames
        if promised - clip.n_frames > max(MAX_HEADER_DIFFERENCE, MAX_HEADER_DIFFERENCE_SHARE * promised):
            raise MocapError(
                f"the video is truncated or damaged: {promised} frames are promised, {clip.n_frames} can be decoded",
                path=clip.path,
                camera=name,
                frame=clip.n_frames,
                remedy=f"copy the file again, or use what is there with `--frames 0:{shortest}`",
            )


def _bad_range(
    root: Path, start: int | None, stop: int | None, what: str, n: int, camera: str | None = None
) -> MocapError:
    text = f"{'' if start is None else start}:{'' if stop is None else stop}"
    return MocapError(
        f"the frame range {text} {what}",
        path=root,
        camera=camera,
        remedy=f"choose it within `--frames 0:{n}`",
    )


def _detected_frames(path: Path) -> int:
    """Frames of a file of keypoints or detections, which their columns tell apart."""
    if path.is_dir() or path.parent.name != "detections":
        return count_frames(path)
    frame, _ = read_detections_csv(path)
    return int(frame[-1]) + 1 if len(frame) else 0


def choose_fps(fps: float | None, clips: Mapping[str, ClipInfo]) -> tuple[float, list[str]]:
    """Frames per second, and what is to be warned of.  fps : of session.toml, which counts most."""
    rates = {name: clip.fps for name, clip in clips.items() if clip.fps is not None}
    if fps is not None:
        return fps, []
    if not rates:
        is_film = any(clip.n_frames > 1 for clip in clips.values()) or not clips
        text = f"no frame rate is known: {DEFAULT_FPS:g} per second assumed (session.toml: fps)"
        return DEFAULT_FPS, [text] if is_film else []
    values = list(rates.values())
    # Among differing headers the most frequent rate is the best guess.
    most = max(sorted(set(values)), key=values.count)
    if max(values) - min(values) <= 1e-3 * most:
        return most, []
    pairs = ", ".join(f"{n}: {v:g}" for n, v in rates.items())
    return most, [
        f"the videos have different frame rates ({pairs}): {most:g} is used, each frame with every camera's picture "
        "nearest in time (session.toml: fps, [clip_fps])"
    ]
