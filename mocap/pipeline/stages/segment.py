"""Segmentation: from pictures to foreground masks in the store."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from mocap.arrays import largest_channel
from mocap.data import Camera
from mocap.errors import MocapError
from mocap.foreground import (
    ForegroundMask,
    ForegroundSettings,
    MaskQuality,
    Segmenter,
    empty_picture,
    mask_quality,
)
from mocap.foreground.quality import Triple
from mocap.io.session import Session
from mocap.io.session.reading import masks_of, pictures_of
from mocap.io.store import StageStore
from mocap.io.video import in_size_of, iter_clip
from mocap.pipeline.backgrounds import learn_backgrounds
from mocap.pipeline.shade import with_shadows_of
from mocap.pipeline.stage import (
    Ending,
    FrameWork,
    Job,
    Row,
    Seen,
    Sources,
    Stage,
    StageReport,
)
from mocap.products import empty as empty_product
from mocap.products.masks import PRODUCT, mask_row, masks_from_arrays
from mocap.volume import SecondLook, choose_grid
from mocap.volume.second_look import LEAST_CAMERAS

_QUALITY_FRAMES = 40  # looked at closely for the quality of the masks
# Voxels of the second look. IoU 0.938, 0.937, 0.937 with 2.5, 3 and 4 cm (furnished, every sixth of ten frames).
_LOOK_VOXEL_M = 0.04


@dataclass(frozen=True, eq=False)
class _Segmenting:
    """One segmenter per camera, which learn as they go; none where masks are taken over.

    look : at all masks of a frame together; None = every camera on its own.  empty : the empty scene as the cameras see
    it.  never_empty : names of those of whose picture a part was never seen empty.
    """

    segmenters: tuple[Segmenter, ...]
    warnings: tuple[str, ...]
    each: Callable[..., Iterable[Any]]
    look: SecondLook | None = None
    empty: tuple[NDArray[np.uint8], ...] = ()
    never_empty: tuple[str, ...] = ()


def _reads(job: Job) -> Sources:
    session = job.session
    if session.mask_sources:
        return {"masks": masks_of(session)}
    return {"pictures": pictures_of(session)}


def _start(job: Job) -> _Segmenting:
    session, settings = job.session, job.config.segmentation
    if session.mask_sources:
        return _Segmenting((), (), job.each)
    warnings: list[str] = []
    backgrounds = learn_backgrounds(session, settings, warnings, job.each)
    foreground = ForegroundSettings(
        method=settings.method, hold_frames=max(1, round(settings.hold_s * session.fps))
    )
    foreground = with_shadows_of(session, backgrounds, foreground, job.each)
    segmenters = tuple(
        Segmenter(b, foreground, roi=region_of_interest(session, camera))
        for b, camera in zip(backgrounds, session.rig, strict=True)
    )
    # The halves of a step keep two threads busy; a live engine does one after the other.
    each = map if job.n_threads == 2 and not job.is_endless else job.each
    return _Segmenting(
        segmenters,
        tuple(warnings),
        each,
        second_look(session) if settings.second_look else None,
        tuple(map(empty_picture, backgrounds)),
        tuple(c.name for b, c in zip(backgrounds, session.rig, strict=True) if b.holds_somebody),
    )


def second_look(session: Session) -> SecondLook | None:
    """A second look at the masks of a session; None where its cameras are too few or share no room."""
    if len(session.rig) < LEAST_CAMERAS:
        return None
    try:
        return SecondLook(
            session.rig, choose_grid(session.rig, _LOOK_VOXEL_M, bounds_m=session.room_bounds_m)
        )
    except ValueError:
        return None  # the stage that carves says why


def _step(state: _Segmenting, seen: Seen) -> tuple[_Segmenting, Seen, Sequence[Row]]:
    if seen.masks is not None:
        n = len(seen.masks)
        row = mask_row(seen.masks, np.full(n, np.nan, dtype=np.float32), np.ones(n, dtype=np.bool_))
        return state, seen, [Row(PRODUCT, seen.frame, row)]
    assert seen.pictures is not None
    found = list(state.each(_segmented, state.segmenters, seen.pictures))
    return state, replace(seen, masks=[m.mask for m in found], begun=found), []


def _then(state: _Segmenting, seen: Seen) -> tuple[Seen, Sequence[Row]]:
    """Look at the masks of all cameras together."""
    if seen.begun is None:
        return seen, ()  # they were taken over
    assert seen.masks is not None
    masks, found, look = seen.masks, seen.begun, state.look
    usable = np.array([m.is_usable for m in found])
    shadow = np.array([m.shadow_share for m in found], dtype=np.float32)
    if 2 * np.count_nonzero(usable) < len(usable):
        # The light went out, or all lenses are covered: a few cameras tell nobody from the room, and the full masks
        # of the rest would fill it.
        masks = [np.zeros_like(mask) for mask in masks]
    elif look is not None:
        shadows, doubtful, boxes = (
            [getattr(m, part) for m in found] for part in ("shadow", "doubtful", "box")
        )
        masks = look.masks(masks, shadows, doubtful, boxes)
    row = Row(PRODUCT, seen.frame, mask_row(masks, shadow, usable))
    return replace(seen, masks=masks, empty=state.empty if seen.index == 0 else ()), [row]


def _segmented(segmenter: Segmenter, picture: NDArray[np.uint8]) -> ForegroundMask:
    """The foreground of a camera's next picture; a camera without one sees nothing that can be used."""
    if len(picture):
        return segmenter.segment(picture)
    nothing = np.zeros(segmenter.shape[:2], dtype=np.bool_)
    return ForegroundMask(nothing, nothing, nothing, 0.0, 0.0, is_usable=False, box=(0, -1, 0, -1))


def _finish(state: _Segmenting) -> Ending:
    if not state.segmenters:
        return Ending(attrs={PRODUCT: {"source": "masks"}})
    attrs = {
        "source": "images",
        "warnings": list(state.warnings),
        "never_empty": list(state.never_empty),
        "shadow_darkest": state.segmenters[0].settings.shadow_darkest,
    }
    rows = [Row(empty_product.PRODUCT, c, arrays) for c, arrays in empty_product.empty_rows(state.empty)]
    return Ending(rows, {PRODUCT: attrs})


def region_of_interest(session: Session, camera: Camera) -> NDArray[np.bool_] | None:
    """Where persons can be, (H, W) bool: roi/CAM.png or [roi_px] in session.toml; None = everywhere.

    Raises MocapError for a picture of another size than the camera's, or a region that is empty.
    """
    width, height = size = camera.filmed_size or camera.size
    region = np.zeros((height, width), dtype=np.uint8)
    path = session.root / "session.toml"
    if camera.name in session.roi_sources:
        path = session.roi_sources[camera.name]
        picture = next(iter_clip(path, size=size, camera=camera.name))
        region = largest_channel(picture)
    elif camera.name in session.roi_px:
        corners = np.round(np.array(session.roi_px[camera.name]).clip(-1e5, 1e5)).astype(np.int32)
        cv2.fillPoly(region, [corners], 255)
    else:
        return None
    if not region.any():
        raise MocapError(
            "the region of interest holds no pixel",
            path=path,
            camera=camera.name,
            remedy="paint the part of the picture white in which persons can be, or remove it",
        )
    return in_size_of(camera, region > 0)


def segment_report(job: Job) -> StageReport:
    """Advice about the masks of every camera, and their numbers; see foreground.mask_quality."""
    store, session = job.store, job.session
    reader = store.reader(PRODUCT)
    warnings = list(reader.attrs.get("warnings", []))
    names = ("share", "shadow", "usable")
    rows = [arrays for _, arrays in reader.rows(*names)]
    share, shadow, usable = (np.array([row[name] for row in rows]) for name in names)
    qualities = mask_quality(
        session.rig.names,
        _sampled_triples(store, session),
        foreground_share=share,
        shadow_share=shadow,
        is_usable=usable,
    )
    warnings += [advice for quality in qualities for advice in quality.advice]
    return StageReport(
        tuple(warnings),
        {
            "mean_foreground_share": round(float(share.mean()), 4),
            "source": reader.attrs["source"],
            "shadow_darkest": reader.attrs.get("shadow_darkest"),
            "cameras": {quality.camera: quality_numbers(quality) for quality in qualities},
        },
    )


def quality_numbers(quality: MaskQuality) -> dict[str, float | None]:
    """The numbers of one camera, rounded, with None for what is not known."""
    values = asdict(quality)
    return {
        key: round(values[key], 4) if np.isfinite(values[key]) else None
        for key in values
        if key not in ("camera", "advice")
    }


def _sampled_triples(store: StageStore, session: Session) -> Iterator[Triple]:
    """Some frames, evenly spread, with their neighbours."""
    reader = store.reader(PRODUCT)
    frames = reader.frames
    middles = np.unique(np.linspace(1, len(frames) - 2, _QUALITY_FRAMES).round().astype(int))
    for i in middles if len(frames) >= 3 else ():
        before, now, after = (
            masks_from_arrays(reader.read(int(frames[j])), session) for j in (i - 1, i, i + 1)
        )
        yield before, now, after


SEGMENT = Stage(
    name="segment",
    until="segment",
    products=(PRODUCT, empty_product.PRODUCT),
    # Foreground masks of every frame: computed, or taken over from masks/. Source: CF 2.2.3.
    work=FrameWork(_reads, _start, _step, _finish, finds=("masks", "empty"), then=_then, apart=("masks",)),
    report=segment_report,
    sections=("segmentation",),
    facts=("fps", "roi_px", "room_bounds_m"),
)
