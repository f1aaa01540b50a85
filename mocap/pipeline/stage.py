"""A stage of a run: what it needs, what decides its result, and how it computes, frame by frame or on the whole clip.

The loop over frames, with the store, progress and threads around it, is `mocap.pipeline.walk`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mocap.data import Hull
from mocap.data.keypoints import NOBODY
from mocap.io.session import Session
from mocap.io.store import StageStore, StageWriter
from mocap.pipeline.config import Config
from mocap.progress import Progress, no_progress

Arrays = Mapping[str, NDArray[Any]]


@dataclass(frozen=True)
class StageReport:
    """What a stage has to say: warnings for the user and numbers for run.json."""

    warnings: tuple[str, ...] = ()
    numbers: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Job:
    """What a stage is given to work on.

    key : of its products.  each : `map` over threads; the result does not depend on their number.  is_endless : frames
    come until somebody stops, and nothing is kept for their end.  unedited_key : what the key would be without edits.
    is_resumed : what an earlier run has left of a stage may be taken over.  presumed : stages that walk along, and of
    which it is to be presumed that they find nothing.
    """

    session: Session
    config: Config
    store: StageStore
    key: str = ""
    seed: int = 0
    n_threads: int = 1
    progress: Progress = no_progress
    each: Callable[..., Iterable[Any]] = map
    is_endless: bool = False
    unedited_key: str = ""
    is_resumed: bool = False
    presumed: frozenset[str] = frozenset()

    def writer(self, product: str, attrs: dict[str, Any] | None = None) -> StageWriter:
        """A product of the stage, to be written; use as context manager."""
        return self.store.writer(product, self.key, attrs)


@dataclass(frozen=True, eq=False)
class Seen:
    """One frame as a step is shown it: what its work reads, and what the stages before it have found in it.

    index : place in the clip.  pictures : (H, W, 3) uint8 RGB of every camera, empty of one that gives none now.
    masks : (H, W) bool of every camera.  depth : (H, W) float32 m of every camera with depth maps, 0 = no reading.
    empty : (h, w, 4) uint8 of every camera in the first frame, as of `foreground.empty_picture`; none in others.
    known : (P, K, 3) m keypoints of the persons on whom cameras agree, NaN = not known.
    tracks : those of the tracker in this frame, as they are called until now.  owner : (N,) serial + 1 of the track
    that holds each voxel of the hull, 0 = nobody.  begun : what the first half of a step leaves to the second.
    is_refuted : a stage has found what those behind it presume not to be: they leave the frame to another walk.
    """

    index: int
    frame: int
    pictures: Sequence[NDArray[np.uint8]] | None = None
    masks: Sequence[NDArray[np.bool_]] | None = None
    depth: Sequence[NDArray[np.float32]] | None = None
    empty: Sequence[NDArray[np.uint8]] = ()
    known: NDArray[np.float64] = field(default_factory=lambda: NOBODY)
    hull: Hull | None = None
    tracks: Sequence[Any] | None = None
    owner: NDArray[np.uint32] | None = None
    begun: Any = None
    is_refuted: bool = False


@dataclass(frozen=True, eq=False)
class Row:
    """One frame of one product."""

    product: str
    frame: int
    arrays: Arrays


@dataclass(frozen=True, eq=False)
class Ending:
    """What is known when all frames have been seen.

    rows : of frames whose product had to wait.  attrs : product -> attributes.  again : the state of another walk over
    the clip, which takes the place of this one; None = done.
    """

    rows: Sequence[Row] = ()
    attrs: Mapping[str, dict[str, Any]] = field(default_factory=dict)
    again: Any = None


Sources = Mapping[str, Iterable[tuple[int, Any]]]


@dataclass(frozen=True)
class FrameWork:
    """A stage as steps over frames, with everything that it remembers in a state.

    reads : what a step is shown: field of `Seen` -> (frame, value) in order; opened and closed by the loop.
    step : gives the frame with what was found in it, for the stages that walk along, and the rows that are certain by
    now, of this frame or earlier.
    finds : fields of `Seen` that a step fills in; a stage that walks along reads them from no file.
    then : the second half of a step, at work on a frame while the first half is on the next one. It is shown the state
    that the walk began with, and what it is to know of the frame is `Seen.begun`.
    apart : the first half leaves nothing in its state that the second half or the end needs, so another process may do
    it: what of `reads` the second half looks at. None = it does.
    """

    reads: Callable[[Job], Sources]
    start: Callable[[Job], Any]
    step: Callable[[Any, Seen], tuple[Any, Seen, Sequence[Row]]]
    finish: Callable[[Any], Ending]
    finds: tuple[str, ...] = ()
    then: Callable[[Any, Seen], tuple[Seen, Sequence[Row]]] | None = None
    apart: tuple[str, ...] | None = None


@dataclass(frozen=True)
class ClipWork:
    """A stage that needs the whole clip: it reads products of earlier stages in any order, and writes its own."""

    run: Callable[[Job], None]


@dataclass(frozen=True)
class Stage:
    """A stage.

    until : the word that ends a run after it.  products : what it writes; all of them, or it has not been run.
    needs : stages before it.  needs_whole : those of them whose whole product its first frame needs.
    sections : of the configuration, that decide its result.  facts : of the session, besides its files and cameras.
    is_random : whether the seed decides, by configuration.
    found_nothing : of a stage that mostly finds nothing, whether it did, when its product is there. Who needs it whole
    walks along on that presumption, and once more where it was wrong. None = it is waited for.
    """

    name: str
    until: str
    products: tuple[str, ...]
    work: FrameWork | ClipWork
    report: Callable[[Job], StageReport]
    needs: tuple[str, ...] = ()
    needs_whole: tuple[str, ...] = ()
    sections: tuple[str, ...] = ()
    facts: tuple[str, ...] = ()
    is_random: Callable[[Config], bool] = lambda config: False
    found_nothing: Callable[[Job], bool] | None = None

    @property
    def module(self) -> str:
        """Where the work is written: its imports are the code that can change a result."""
        return (self.work.run if isinstance(self.work, ClipWork) else self.work.reads).__module__


def is_done(stage: Stage, store: StageStore, key: str) -> bool:
    """Whether every product of the stage is complete under this very key."""
    return all(store.is_complete(product, key) for product in stage.products)
