"""Segmentation: from pictures to foreground masks in the store."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, NamedTuple

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
    brightness_of,
    empty_picture,
    grey_outline,
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
from mocap.volume.second_look import least_cameras

_QUALITY_FRAMES = 40  # looked at closely for the quality of the masks
# Voxels of the second look. IoU 0.938, 0.937, 0.937 with 2.5, 3 and 4 cm (furnished, every sixth of ten frames).
_LOOK_VOXEL_M = 0.04


class _Begun(NamedTuple):
    """What the first half of a step leaves to the second.

    found : of every camera.  greys : brightness of its picture and of its empty scene, (H, W) uint8 each, where its
    outline is to be found once more.
    """

    found: Sequence[ForegroundMask]
    greys: Sequence[tuple[NDArray[np.uint8], NDArray[np.uint8]] | None]


@dataclass(frozen=True, eq=False)
class _Segmenting:
    """One segmenter per camera, which learn as they go; none where masks are taken over.

    look : at all masks of a frame together; None = every camera on its own.  cuts_again : outlines are found once more,
    in pictures without colours.  empty : the empty scene as the cameras see
    it.  never_empty : names of those of whose picture a part was never seen empty.
    """

    segmenters: tuple[Segmenter, ...]
    warnings: tuple[str, ...]
    each: Callable[..., Iterable[Any]]
    look: SecondLook | None = None
    cuts_again: bool = False
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
    are_grey = all(b.is_grey for b in backgrounds)
    look = second_look(session, are_grey=are_grey) if settings.second_look else None
    if grey := [c.name for b, c in zip(backgrounds, session.rig, strict=True) if b.is_grey]:
        warnings.append(_words_of_grey(grey, is_looked_at=look is not None))
    # The halves of a step keep two threads busy; a live engine does one after the other.
    each = map if job.n_threads == 2 and not job.is_endless else job.each
    return _Segmenting(
        segmenters,
        tuple(warnings),
        each,
        look,
        are_grey and look is not None and settings.grey_outlines,
        tuple(map(empty_picture, backgrounds)),
        tuple(c.name for b, c in zip(backgrounds, session.rig, strict=True) if b.holds_somebody),
    )


def _words_of_grey(names: Sequence[str], *, is_looked_at: bool) -> str:
    """What pictures without colours mean for the masks."""
    how = (
        "where cameras see him together and by soft edges"
        if is_looked_at
        else f"soft edges alone, as fewer than {least_cameras(are_grey=True)} cameras, or some without colours among "
        "others, do not say it together: much of a person may be missing"
    )
    return (
        f"no colours are seen by {', '.join(names)}: a person is told from his shadow by {how}. Remedy: colour "
        "cameras, or clothes that are brighter or darker than what is behind them"
    )


def second_look(session: Session, *, are_grey: bool = False) -> SecondLook | None:
    """A second look at the masks of a session; None where its cameras are too few or share no room.

    are_grey : they see no colours.
    """
    if len(session.rig) < least_cameras(are_grey=are_grey):
        return None
    try:
        grid = choose_grid(session.rig, _LOOK_VOXEL_M, bounds_m=session.room_bounds_m)
        return SecondLook(session.rig, grid, are_grey=are_grey)
    except ValueError:
        return None  # the stage that carves says why


def _step(state: _Segmenting, seen: Seen) -> tuple[_Segmenting, Seen, Sequence[Row]]:
    if seen.masks is not None:
        n = len(seen.masks)
        row = mask_row(seen.masks, np.full(n, np.nan, dtype=np.float32), np.ones(n, dtype=np.bool_))
        return state, seen, [Row(PRODUCT, seen.frame, row)]
    assert seen.pictures is not None
    found = list(state.each(_segmented, state.segmenters, seen.pictures))
    greys = [
        (brightness_of(picture), brightness_of(segmenter.background))
        if state.cuts_again and len(picture)
        else None
        for segmenter, picture in zip(state.segmenters, seen.pictures, strict=True)
    ]
    return state, replace(seen, masks=[m.mask for m in found], begun=_Begun(found, greys)), []


def _then(state: _Segmenting, seen: Seen) -> tuple[Seen, Sequence[Row]]:
    """Look at the masks of all cameras together."""
    if seen.begun is None:
        return seen, ()  # they were taken over
    assert seen.masks is not None
    masks, (found, greys), look = seen.masks, seen.begun, state.look
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
        if state.cuts_again:
            masks = list(state.each(_cut_again, greys, masks))
    row = Row(PRODUCT, seen.frame, mask_row(masks, shadow, usable))
    return replace(seen, masks=masks, empty=state.empty if seen.index == 0 else ()), [row]


def _cut_again(
    grey: tuple[NDArray[np.uint8], NDArray[np.uint8]] | None,
    mask: NDArray[np.bool_],
) -> NDArray[np.bool_]:
    """The outline of a camera's mask, found once more if it is to be.  grey : as of _Begun."""
    return grey_outline(*grey, mask) if grey is not None else mask


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
