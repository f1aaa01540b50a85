"""Occluders: from masks to maps of what stands in front of people."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mocap.data import CameraRig
from mocap.foreground import EMPTY_REDUCTION
from mocap.io.session.reading import depth_of
from mocap.pipeline.stage import Ending, FrameWork, Job, Row, Seen, Sources, Stage, StageReport
from mocap.pipeline.stages.carve import grid_of
from mocap.products import masks as masks_product
from mocap.products.empty import stored_empty
from mocap.products.masks import read_masks
from mocap.products.occluders import PRODUCT, occluder_attrs, occluder_rows, stored_occluders
from mocap.volume import OccluderLearner, masks_by_cells, no_occluders, things_on_floor
from mocap.volume.occluders import MANY_CAMERAS, MIN_CAMERAS
from mocap.volume.standing import StandingScene, nearest_of

# Twice as many cost twice as much and know no more (knees and ankles in the hull 76 and 92 %, 76 and 90 % with these).
_LOOKS_PER_S = 15.0
_SOMEBODY = 0.0005  # of a picture: 150 of 640 x 480 pixels, a person 20 m away
_IDLE_SHARE, _FEW_FRAMES = 0.9, 5
# Cameras to whom the floor tells what stands there. Hulls of more forgive one, and are wider for what one more does not
# say; of three, those of things reach far before and behind them (decisions 81 and 98).
_FLOOR_TELLS = range(4, MANY_CAMERAS)
_MOST_LOOKS = 600  # frames of a clip that are looked at; a clip of an hour costs no more than one of a minute
# After so many looks it is asked whether anything stands there, so that others need not go on for nothing. It takes as
# long as a look, 7 to 9 ms by hand; `dev:furnished` shows it by the fourth look.
_LOOKS_TO_ASK = 15


@dataclass(frozen=True, eq=False)
class _Look:
    """Learning.  learner : None where nothing can be learnt.  scene : what depth cameras measure of the room, None
    without them.  stride : every so many frames are looked at.  has_found : whether something stands there, as far as
    it was asked by now."""

    job: Job
    learner: OccluderLearner | None
    scene: StandingScene | None
    stride: int
    has_found: bool = False


def _reads(job: Job) -> Sources:
    sources: dict[str, Any] = {"masks": read_masks(job.store, job.session), "empty": _read_empty(job)}
    return {**sources, "depth": depth_of(job.session)} if job.session.depth_sources else sources


def _read_empty(job: Job) -> Iterator[tuple[int, Sequence[NDArray[np.uint8]]]]:
    """The empty scene of a segmentation that is reused, with the first frame."""
    for i, frame in enumerate(job.session.frames):
        yield frame, stored_empty(job.store) if i == 0 else ()


def _start(job: Job) -> _Look:
    volume, rig = job.config.volume, job.session.rig
    # Who counts what lies outside a picture as empty cannot abstain inside it.
    is_wanted = volume.occluders == "learn" and volume.outside_view == "abstain" and len(rig) >= MIN_CAMERAS
    learner = OccluderLearner(rig, grid_of(job.session, job.config)) if is_wanted else None
    names = list(job.session.depth_sources)
    scene = StandingScene(rig, names, grid_of(job.session, job.config)) if is_wanted and names else None
    n = len(job.session.frames)
    return _Look(
        job, learner, scene, max(1, round(job.session.fps / _LOOKS_PER_S), math.ceil(n / _MOST_LOOKS))
    )


def _step(look: _Look, seen: Seen) -> tuple[_Look, Seen, Sequence[Row]]:
    assert seen.masks is not None
    session = look.job.session
    if look.learner is not None and len(seen.empty) and len(session.rig) in _FLOOR_TELLS:
        small = CameraRig(tuple(camera.reduced(EMPTY_REDUCTION) for camera in session.rig))
        look.learner.things = things_on_floor(small, grid_of(session, look.job.config), seen.empty)
    if look.learner is not None and seen.index % look.stride == 0:
        cells = masks_by_cells(seen.masks)
        look.learner.add(cells)
        if look.scene is not None and seen.depth is not None:
            look.scene.add(cells, seen.depth)
        if not look.has_found and (seen.index // look.stride) % _LOOKS_TO_ASK == _LOOKS_TO_ASK - 1:
            look = replace(look, has_found=look.learner.has_found)
    return look, replace(seen, is_refuted=look.has_found), ()


def _finish(look: _Look) -> Ending:
    rig = look.job.session.rig
    found = no_occluders() if look.learner is None else look.learner.occluders()
    if look.scene is not None:
        found = nearest_of(found, look.scene.occluders())
    return Ending(
        rows=[Row(PRODUCT, c, arrays) for c, arrays in occluder_rows(found, rig)],
        attrs={PRODUCT: occluder_attrs(found)},
    )


def occluders_report(job: Job) -> StageReport:
    """Share of each picture in which something can stand before people, and cameras that see next to nobody."""
    names = job.session.rig.names
    shares = stored_occluders(job.store, job.session.rig).shares
    masks = job.store.reader(masks_product.PRODUCT)
    foreground = np.array([arrays["share"] for _, arrays in masks.rows("share")])
    warnings = tuple(
        f"camera {name}: nobody is in its silhouettes where most other cameras see somebody: it looks at furniture, or "
        "people are not told from what is behind them. Remedy: look at its silhouettes in the report; place it "
        "where it sees the floor on which people walk"
        for name, is_idle in zip(names, idle_cameras(foreground), strict=True)
        if is_idle
    )
    return StageReport(warnings, {"picture_share": {name: round(shares.get(name, 0.0), 4) for name in names}})


def idle_cameras(foreground: NDArray[np.floating]) -> NDArray[np.bool_]:
    """Cameras, (C,), without foreground in nearly all frames in which most others have some.

    foreground : (T, C) share of each picture.
    """
    sees = foreground > _SOMEBODY
    n_others = foreground.shape[1] - 1
    is_asked = sees.sum(axis=1, keepdims=True) - sees >= max(2, (n_others + 1) // 2)
    n_asked, n_idle = is_asked.sum(axis=0), (is_asked & ~sees).sum(axis=0)
    return (n_asked >= _FEW_FRAMES) & (n_idle >= _IDLE_SHARE * n_asked)


OCCLUDERS = Stage(
    name="occluders",
    until="occluders",
    products=(PRODUCT,),
    # Where something stands between cameras and people, from their silhouettes.
    work=FrameWork(_reads, _start, _step, _finish),
    report=occluders_report,
    needs=("segment",),
    sections=("volume",),
    facts=("fps", "room_bounds_m", "depth"),
    found_nothing=lambda job: stored_occluders(job.store, job.session.rig).is_empty,
)
