"""The common clock: both sides numbered by the same frames, and which of those are scored."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from mocap.compare.options import CompareOptions
from mocap.compare.side import Side
from mocap.data.motion import at_times
from mocap.errors import MocapError

_SAME_RATE = 0.005  # rates this close, relatively, are one: 29.97 is not 30, but 30.00001 of rounded times is


@dataclass(frozen=True, eq=False)
class OnOneClock:
    """Both sides numbered by the same frames.

    fps : of those, None = not known.  notes : what was shifted or resampled.
    """

    estimate: Side
    truth: Side
    fps: float | None
    notes: tuple[str, ...] = ()


def on_one_clock(estimate: Side, truth: Side, options: CompareOptions) -> OnOneClock:
    """Both sides numbered by the same frames; at two rates the faster is read at the times of the slower.

    Raises MocapError for a time offset where neither side has a rate.
    """
    rate, true_rate = estimate.reading.fps, truth.reading.fps
    if rate is None or true_rate is None or abs(rate - true_rate) <= _SAME_RATE * true_rate:
        fps = true_rate if true_rate is not None else rate
        shift = shift_in_frames(options, fps, remedy="use --frame-offset, or say --estimate-fps")
        return OnOneClock(_shifted(estimate, shift), truth, fps, shift_notes(shift))
    shift_s = options.time_offset_s + options.frame_offset / rate
    estimate = replace(
        estimate.with_motions([replace(m, time_s=m.time_s + shift_s) for m in estimate.motions]), tracks=None
    )
    truth = replace(truth, tracks=None)
    notes = (f"{shift_s:+.4f} s added to the estimate's times",) if shift_s else ()
    fast, slow = (estimate, truth) if rate > true_rate else (truth, estimate)
    resampled = _resampled(fast, slow)
    if rate > true_rate:
        estimate = resampled
    else:
        truth = resampled
    how = (
        f"{max(rate, true_rate):g} and {min(rate, true_rate):g} frames per second: the {fast.name} is interpolated "
        f"at the times of the {slow.name}, whose frame numbers count"
    )
    return OnOneClock(estimate, truth, min(rate, true_rate), (*notes, how))


def shift_notes(shift: int) -> tuple[str, ...]:
    """The note about a shift by whole frames; none for no shift."""
    return (f"{shift:+d} frames added to the estimate's frame numbers",) if shift else ()


def shift_in_frames(options: CompareOptions, fps: float | None, *, remedy: str) -> int:
    """Frames to add to the estimate's. Raises MocapError, with the remedy, for a time offset and an unknown rate."""
    if not options.time_offset_s:
        return options.frame_offset
    if fps is None:
        raise MocapError("a time offset needs a frame rate, and neither side has one", remedy=remedy)
    return options.frame_offset + round(options.time_offset_s * fps)


def _shifted(side: Side, shift: int) -> Side:
    if not shift:
        return side
    tracks = side.tracks
    return replace(
        side.with_motions([replace(m, frames=m.frames + shift) for m in side.motions]),
        tracks=None if tracks is None else replace(tracks, frame=tracks.frame + shift),
        frames=None if side.frames is None else tuple(f + shift for f in side.frames),
    )


def _resampled(fast: Side, slow: Side) -> Side:
    """The fast side at the instants of the slow one."""
    frames, index = np.unique(np.concatenate([m.frames for m in slow.motions]), return_index=True)
    times = np.concatenate([m.time_s for m in slow.motions])[index]
    fps = fast.reading.fps
    assert fps is not None  # it is the faster one
    motions = [at_times(m, frames, times, fps) for m in fast.motions if len(m) > 1]
    return replace(fast.with_motions(motions), frames=None)


def frames_to_score(estimate: Side, truth: Side) -> tuple[list[int], str | None]:
    """Frames of the truth that the estimate worked on, and a note when those are not all.

    A person missing in one of them counts as missed. Raises MocapError when the two have no frame in common.
    """
    true_frames = truth.pose_frames
    if estimate.frames is not None:
        worked_on = np.array(estimate.frames, dtype=np.int64)
        common = np.intersect1d(true_frames, worked_on)
    else:
        worked_on = estimate.pose_frames
        first, last = (worked_on[0], worked_on[-1]) if len(worked_on) else (1, 0)
        common = true_frames[(true_frames >= first) & (true_frames <= last)]
    if not len(common) and len(worked_on) and len(true_frames):
        raise MocapError(
            f"estimate and truth have no frame in common: frames {worked_on.min()} to {worked_on.max()} of "
            f"{estimate.path.name}, {true_frames.min()} to {true_frames.max()} of {truth.path.name}",
            remedy="shift the estimate with --frame-offset N or --time-offset S, or check the frame rates "
            "(--estimate-fps, --truth-fps)",
        )
    note = None
    if len(common) < max(len(true_frames), len(worked_on)):
        note = (
            f"{len(common)} common frames are scored; "
            f"the estimate has {len(worked_on)}, the truth {len(true_frames)}"
        )
    return [int(f) for f in common], note
