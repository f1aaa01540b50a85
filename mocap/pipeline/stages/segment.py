"""Segmentation: from pictures to foreground masks in the store."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict
from itertools import islice

import cv2
import numpy as np
from numpy.typing import NDArray

from mocap.data import Camera
from mocap.errors import MocapError
from mocap.foreground import (
    Background,
    ForegroundSettings,
    MaskQuality,
    Segmenter,
    learn_background,
    mask_quality,
    median_background,
)
from mocap.foreground.quality import Triple
from mocap.io.session import Session
from mocap.io.store import StageStore, StageWriter
from mocap.io.video import FrameReader, MaskReader, iter_clip
from mocap.pipeline.config import Config, SegmentationConfig
from mocap.pipeline.stages.report import Progress, StageReport

_QUALITY_FRAMES = 40  # looked at closely for the quality of the masks


def learn_backgrounds(session: Session, config: SegmentationConfig, warnings: list[str]) -> list[Background]:
    """One background per camera, from background/, the first frames, or the temporal median.

    Raises MocapError when there is nothing to learn from, saying how to help.
    """
    backgrounds = []
    n_frames = len(session.frames)
    for camera in session.rig:
        source = config.background
        if source == "auto":
            source = "clip" if camera.name in session.background_sources else "median"
        if source == "clip":
            if camera.name not in session.background_sources:
                raise MocapError(
                    "there is no clip of the empty scene",
                    camera=camera.name,
                    path=session.root / "background",
                    remedy="record one, or set segmentation.background to median or first",
                )
            clip = iter_clip(session.background_sources[camera.name], size=camera.size, camera=camera.name)
            background = learn_background(clip)
        else:
            if n_frames < 3:
                raise MocapError(
                    f"no background to learn from: {n_frames} frame(s) and no background/ folder",
                    camera=camera.name,
                    path=session.root,
                    remedy="add pictures of the empty scene as background/CAMERA.png, or masks/CAMERA/*.png",
                )
            clip = iter_clip(session.image_sources[camera.name], size=camera.size, camera=camera.name)
            clip = islice(clip, session.frames.start, session.frames.stop)
            if source == "first":
                background = learn_background(islice(clip, config.first_frames))
            else:
                step = max(1, n_frames // config.median_frames)
                background = median_background(islice(clip, 0, None, step))
        warnings += [f"camera {camera.name}: {w}" for w in background.warnings]
        backgrounds.append(background)
    if config.background in ("auto", "median"):
        missing = [
            c.name
            for c in session.rig
            if config.background == "median" or c.name not in session.background_sources
        ]
        if missing:
            warnings.append(
                f"the background of {', '.join(missing)} was learnt as the temporal median of {n_frames} frames; a "
                "person who stays in place, or a short clip, is lost this way. Remedy: record an empty scene as "
                "background/CAMERA.mp4"
            )
    return backgrounds


def segment_stage(
    session: Session, config: Config, store: StageStore, key: str, *, n_threads: int, progress: Progress
) -> None:
    """Foreground masks of every frame into the store: computed, or taken over from masks/.

    Store: per frame `m0 .. mC-1`, (H, ceil(W / 8)) uint8, bits of the masks along rows in rig order; `share`
    (C,) foreground share; `shadow` (C,) shadow share, NaN for masks taken over; `usable` (C,) bool.
    Source: CF 2.2.3.
    """
    warnings: list[str] = []
    rig, frames = session.rig, session.frames
    n = len(frames)
    if session.mask_sources:
        with (
            store.writer("segment", key, {"source": "masks"}) as out,
            MaskReader(session.mask_sources, rig, frames) as reader,
        ):
            for i, (frame, masks) in enumerate(reader):
                unknown = np.full(len(rig), np.nan, dtype=np.float32)
                _append_masks(out, frame, masks, unknown, np.ones(len(rig), dtype=np.bool_))
                progress("segment", i + 1, n)
        return
    backgrounds = learn_backgrounds(session, config.segmentation, warnings)
    settings = ForegroundSettings(
        method=config.segmentation.method, hold_frames=max(1, round(config.segmentation.hold_s * session.fps))
    )
    segmenters = [
        Segmenter(b, settings, roi=region_of_interest(session, camera))
        for b, camera in zip(backgrounds, rig, strict=True)
    ]
    attrs: dict[str, object] = {"source": "images", "warnings": warnings}
    with (
        store.writer("segment", key, attrs) as out,
        FrameReader(session.image_sources, rig, frames) as images_of,
        ThreadPoolExecutor(max(1, n_threads)) as pool,
    ):
        for i, (frame, images) in enumerate(images_of):
            found = list(pool.map(lambda s, image: s.segment(image), segmenters, images))
            usable = np.array([m.is_usable for m in found])
            shadow = np.array([m.shadow_share for m in found], dtype=np.float32)
            _append_masks(out, frame, [m.mask for m in found], shadow, usable)
            progress("segment", i + 1, n)


def _append_masks(
    out: StageWriter,
    frame: int,
    masks: Sequence[NDArray[np.bool_]],
    shadow: NDArray[np.float32],
    usable: NDArray[np.bool_],
) -> None:
    packed = {f"m{c}": np.packbits(mask, axis=1) for c, mask in enumerate(masks)}
    share = np.array([float(m.mean()) for m in masks], dtype=np.float32)
    out.append(frame, share=share, shadow=shadow, usable=usable, **packed)


def read_masks(store: StageStore, session: Session) -> Iterator[tuple[int, list[NDArray[np.bool_]]]]:
    """Frames and masks, one (H, W) bool per camera in rig order, from the store."""
    for frame, arrays in store.reader("segment"):
        yield frame, masks_from_arrays(arrays, session)


def masks_from_arrays(arrays: dict[str, NDArray[np.uint8]], session: Session) -> list[NDArray[np.bool_]]:
    """Masks of one frame of the `segment` product."""
    return [
        np.unpackbits(arrays[f"m{c}"], axis=1, count=camera.size[0]).view(np.bool_)
        for c, camera in enumerate(session.rig)
    ]


def region_of_interest(session: Session, camera: Camera) -> NDArray[np.bool_] | None:
    """Where persons can be, (H, W) bool: roi/CAM.png or [roi_px] in session.toml; None = everywhere.

    Raises MocapError for a picture of another size than the camera's, or a region that is empty.
    """
    width, height = camera.size
    region = np.zeros((height, width), dtype=np.uint8)
    path = session.root / "session.toml"
    if camera.name in session.roi_sources:
        path = session.roi_sources[camera.name]
        picture = next(iter_clip(path, size=camera.size, camera=camera.name))
        region = picture.max(axis=2)
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
    return region > 0


def segment_report(store: StageStore, session: Session) -> StageReport:
    """Advice about the masks of every camera, and their numbers; see foreground.mask_quality."""
    reader = store.reader("segment")
    warnings = list(reader.attrs.get("warnings", []))
    rows = [(arrays["share"], arrays["shadow"], arrays["usable"]) for _, arrays in reader]
    share, shadow, usable = (np.array([row[i] for row in rows]) for i in range(3))
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
    reader = store.reader("segment")
    frames = reader.frames
    middles = np.unique(np.linspace(1, len(frames) - 2, _QUALITY_FRAMES).round().astype(int))
    for i in middles if len(frames) >= 3 else ():
        before, now, after = (
            masks_from_arrays(reader.read(int(frames[j])), session) for j in (i - 1, i, i + 1)
        )
        yield before, now, after
