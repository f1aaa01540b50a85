"""Renaming: tracks and owners of voxels given to other persons over some frames, as somebody who looked at them says.

Swaps, merges, splits and deletions are all of this kind: nothing is tracked anew.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from mocap.data import Tracks

Whole = TypeVar("Whole", bound=np.integer[Any])
# Whose track was deleted: still somebody to those beside him, and followed by nobody. The largest owner that is stored.
DELETED = 2**16 - 1


@dataclass(frozen=True)
class Renaming:
    """frames : in which it holds.  names : old number -> new one, all at once; DELETED = nobody."""

    frames: range
    names: Mapping[int, int] = field(default_factory=dict)


def renamed(
    person: NDArray[Whole], frame: NDArray[np.int64] | int, renamings: Sequence[Renaming]
) -> NDArray[Whole]:
    """Numbers of persons (N,) after renamings in order, each on the names that the one before has given.

    frame : of each, or of all.
    """
    out = person.copy()
    for renaming in renamings:
        before = out.copy()
        is_in = np.asarray((frame >= renaming.frames.start) & (frame < renaming.frames.stop))
        for old, new in renaming.names.items():
            out[(before == old) & is_in] = new
    return out


def renamed_tracks(tracks: Tracks, renamings: Sequence[Renaming]) -> Tracks:
    """The table of tracks after renamings, without the rows of who was deleted."""
    person = renamed(tracks.person, tracks.frame, renamings)
    order = np.lexsort((person, tracks.frame))
    named = replace(tracks, person=np.asarray(person, dtype=np.int64))
    return named.rows(order[person[order] != DELETED])


def sources_of(
    tracks: Tracks, renamings: Sequence[Renaming], person: int
) -> tuple[tuple[int, int, int], ...]:
    """What a person consists of after renamings: (first frame, stop, old number) of every stretch."""
    names = renamed(tracks.person, tracks.frame, renamings)
    rows = np.flatnonzero(names == person)
    frame, old = tracks.frame[rows], tracks.person[rows]
    cuts = np.flatnonzero((np.diff(frame) != 1) | (np.diff(old) != 0)) + 1
    return tuple(
        (int(frame[part[0]]), int(frame[part[-1]]) + 1, int(old[part[0]]))
        for part in np.split(np.arange(len(rows)), cuts)
        if len(part)
    )
