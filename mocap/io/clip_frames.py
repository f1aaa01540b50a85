"""Which picture of a clip shows a frame of the session, for tables that count pictures."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

# Camera -> the picture of its clip that shows each frame of the session.
ClipFrames = Mapping[str, NDArray[np.int64]]


def shown_rows(
    pictures: NDArray[np.int64], frames: range, clip_frames: NDArray[np.int64] | None
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Frames (m,) of the session, ascending, and the rows (m,) of a table that belong to them.

    pictures : (n,) of the clip, ascending, one per row.  clip_frames : (frames.stop,), None = picture k shows frame k.
    """
    numbers = np.asarray(frames, dtype=np.int64)
    shown = numbers if clip_frames is None else clip_frames[numbers]
    first, last = np.searchsorted(pictures, shown, "left"), np.searchsorted(pictures, shown, "right")
    n = last - first
    starts = (
        np.repeat(first - np.concatenate([[0], np.cumsum(n)[:-1]]), n) if len(n) else np.zeros(0, np.int64)
    )
    return np.repeat(numbers, n), np.arange(n.sum()) + starts
