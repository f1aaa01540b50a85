"""The engine: sets of pictures in, frame results out, with bounded memory and latency.

The stages' own steps segment, carve and track a frame while the poses of the frame before are solved.
"""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import dataclass
from types import TracebackType

import numpy as np

from mocap.data import Hull, Occluders
from mocap.errors import MocapError
from mocap.io.session import Session
from mocap.io.store import StageStore
from mocap.pipeline.config import Config
from mocap.pipeline.live.capture import Image
from mocap.pipeline.live.pairing import PictureSet
from mocap.pipeline.live.persons import Following, PersonResult, SeenPersons
from mocap.pipeline.stage import Arrays, Job, Seen
from mocap.pipeline.stages.carve import CARVE
from mocap.pipeline.stages.segment import SEGMENT
from mocap.pipeline.stages.track import TRACK
from mocap.pipeline.walk import Walker
from mocap.pose.forward import ForwardSettings
from mocap.products import hulls as hulls_product
from mocap.products import masks as masks_product
from mocap.products import occluders as occluders_product
from mocap.threads import Ahead
from mocap.tracking.state import TENTATIVE

ENDLESS = range(2**31 - 1)
"""Frames of a session that has no end."""
_STAGES = (SEGMENT, CARVE, TRACK)
_NO_PICTURE = np.zeros((0, 0, 3), dtype=np.uint8)


@dataclass(frozen=True, eq=False)
class FrameResult:
    """What was found in one set of pictures.

    time_s : that it shows, since the first set.  latency_s : from when the latest picture was taken over to the result.
    n_cameras : that took part.  persons, things : who was tracked, and those among them that are no persons.  hull : of
    everybody.  pictures : one per camera, None of a camera that was silent.
    """

    frame: int
    time_s: float
    latency_s: float
    n_cameras: int
    persons: tuple[PersonResult, ...]
    things: tuple[PersonResult, ...] = ()
    hull: Hull | None = None
    pictures: tuple[Image | None, ...] = ()


@dataclass(frozen=True, eq=False)
class _Tracked:
    """A frame as far as the tracker.  time_s : since the first set.  rows : product -> arrays of this frame."""

    seen: Seen
    time_s: float
    rows: dict[str, Arrays]
    pictures: PictureSet


class Engine:
    """Segments, carves, tracks and follows persons; use as context manager.

    session : with rig, backgrounds and fps; its frames are not read.  store : for what stages keep of the room.
    occluders : what stands before people.  n_threads : with more than one, poses are solved while the next frame is
    tracked, and first poses are looked for while frames go on; with one everything waits for everything, so that the
    results are the same every time.  forward : how persons are taken up; None = the usual.
    """

    def __init__(
        self,
        session: Session,
        config: Config,
        store: StageStore,
        occluders: Occluders,
        *,
        seed: int = 0,
        n_threads: int = 2,
        forward: ForwardSettings | None = None,
    ) -> None:
        self.session, self.config = session, config
        self._n_threads = n_threads
        self._stack = ExitStack()
        following = Following(session, config, occluders, seed, n_threads, forward)
        self._poses = self._stack.enter_context(following.poses())
        with store.writer(
            occluders_product.PRODUCT, "live", occluders_product.occluder_attrs(occluders)
        ) as out:
            for row, arrays in occluders_product.occluder_rows(occluders, session.rig):
                out.append(row, **arrays)
        pool = self._stack.enter_context(ThreadPoolExecutor(n_threads))
        job = Job(session, config, store, "live", seed, n_threads, each=pool.map, is_endless=True)
        self._walkers = [Walker(stage, job) for stage in _STAGES]

    def __enter__(self) -> Engine:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stack.close()

    def results(self, sets: Iterable[PictureSet]) -> Iterator[FrameResult]:
        """The result of every set, in order."""
        tracked: Iterator[_Tracked] = self._tracked(sets)
        with ExitStack() as stack:
            if self._n_threads > 1:
                tracked = stack.enter_context(Ahead(tracked, 1))
            for found in tracked:
                posed = self._posed(found)
                yield FrameResult(
                    frame=found.seen.frame,
                    time_s=found.time_s,
                    latency_s=time.monotonic() - found.pictures.taken_s,
                    n_cameras=sum(shot is not None for shot in found.pictures.shots),
                    persons=tuple(one for one in posed if not one.is_thing),
                    things=tuple(one for one in posed if one.is_thing),
                    hull=found.seen.hull,
                    pictures=tuple(None if s is None else s.picture for s in found.pictures.shots),
                )

    def _tracked(self, sets: Iterable[PictureSet]) -> Iterator[_Tracked]:
        """Every set as far as the tracker; frames count the time, those that were dropped too."""
        first_s, frame = None, -1
        for i, pictures in enumerate(sets):
            first_s = pictures.time_s if first_s is None else first_s
            time_s = pictures.time_s - first_s
            frame = max(frame + 1, round(time_s * self.session.fps))
            images = [_NO_PICTURE if shot is None else shot.picture for shot in pictures.shots]
            seen, rows = Seen(i, frame, pictures=images), {}
            for walker in self._walkers:
                seen, made = walker.step(seen)
                rows.update({row.product: row.arrays for row in made if row.frame == frame})
            yield _Tracked(seen, time_s, rows, pictures)

    def _posed(self, found: _Tracked) -> tuple[PersonResult, ...]:
        """The persons of a frame with their poses."""
        assert found.seen.tracks is not None
        assert found.seen.owner is not None
        tracks = [track for track in found.seen.tracks if track.status != TENTATIVE]
        hulls, masks = (found.rows[product] for product in (hulls_product.PRODUCT, masks_product.PRODUCT))
        try:
            return self._poses(SeenPersons(found.pictures.time_s, tracks, found.seen.owner, hulls, masks))
        except ChildProcessError as error:
            raise MocapError(
                "the process that follows people is gone: it was killed, or there was no memory left",
                remedy="end other programs, and begin again; with `--threads 1` all is done in one process",
            ) from error
