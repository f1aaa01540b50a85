"""Panels of the report: a few frames in a few cameras, from the picture to the fitted body."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from mocap.data import Camera, Hull
from mocap.io.session.reading import pictures_of
from mocap.pipeline.config import OutputConfig
from mocap.pipeline.record import Found
from mocap.pipeline.scene_frames import body_parts, rows_at
from mocap.pose.result import PersonPoses
from mocap.products import hulls as hulls_product
from mocap.products import masks as masks_product
from mocap.products.detections import detections_at
from mocap.products.hulls import grid_from_attrs, hull_from_arrays
from mocap.products.keypoints import keypoints_at
from mocap.products.masks import masks_from_arrays
from mocap.view import FramePanel

Image = NDArray[np.uint8]

_PANEL_HEIGHT_PX = 420


def frame_panels(found: Found, settings: OutputConfig) -> Iterator[FramePanel]:
    """Pictures of a few frames, with what the poses were found from."""
    return _volume_panels(found, settings) if found.hulls is not None else marker_panels(found, settings)


def _volume_panels(found: Found, settings: OutputConfig) -> Iterator[FramePanel]:
    """Image, silhouette, hull and fitted body."""
    session, store = found.session, found.store
    hulls, masks = store.reader(hulls_product.PRODUCT), store.reader(masks_product.PRODUCT)
    grid = grid_from_attrs(hulls.attrs)
    for frame, images in images_of(found, chosen_frames(found, hulls.frames, settings.report_frames)):
        hull = hull_from_arrays(grid, hulls.read(int(frame)))
        mask = masks_from_arrays(masks.read(int(frame)), session)
        rows = rows_at(found.poses, int(frame))
        rig = session.rig_at(int(frame))
        for c in _chosen_cameras(found, settings):
            yield FramePanel(
                frame=int(frame),
                title=f"{rig[c].name}",
                images=tuple(_views(rig[c], images[c], mask[c], hull, rows)),
            )


def marker_panels(found: Found, settings: OutputConfig) -> Iterator[FramePanel]:
    """Pictures of a few frames: image, detections and fitted body in a few cameras."""
    from mocap.view import crop, draw_body, draw_skeleton, person_window
    from mocap.view.detections import draw_detections

    session = found.session
    frames = np.array(session.frames, dtype=np.int64)
    for frame, images in images_of(found, chosen_frames(found, frames, settings.report_frames)):
        read = keypoints_at if found.kind == "keypoints" else detections_at
        detections = read(found.store, session, int(frame))
        rows = rows_at(found.poses, int(frame))
        for c in _chosen_cameras(found, settings):
            camera, image = session.rig[c], images[c]
            points = [p.landmarks[i] for p, i in rows]
            window = person_window(camera, np.concatenate(points)) if points else (0, 0, *camera.size)
            scale = _PANEL_HEIGHT_PX / max(1, window[3] - window[1])
            body, skeleton = image, draw_detections(image, camera, detections[c])
            for p, i in rows:
                body = draw_body(body, camera, body_parts(p.body, p.states[i]))
                skeleton = draw_skeleton(
                    skeleton, camera, p.landmarks[i], p.observed[i], label=f"person {p.person}"
                )
            views = (
                *((("image", image),) if session.image_sources else ()),
                ("detections", draw_detections(image, camera, detections[c])),
                ("fitted body", body),
                ("skeleton and detections", skeleton),
            )
            yield FramePanel(
                frame=int(frame),
                title=camera.name,
                images=tuple((label, crop(picture, window, scale=scale)) for label, picture in views),
            )


def _views(
    camera: Camera,
    image: Image,
    mask: NDArray[np.bool_],
    hull: Hull,
    rows: list[tuple[PersonPoses, int]],
) -> Iterator[tuple[str, Image]]:
    from mocap.view import crop, draw_body, draw_hull, draw_mask, draw_skeleton, person_window

    points = hull.centers if len(hull) else np.zeros((0, 3))
    window = person_window(camera, points) if len(points) else (0, 0, *camera.size)
    scale = _PANEL_HEIGHT_PX / max(1, window[3] - window[1])
    body, skeleton = image, image
    for p, i in rows:
        body = draw_body(body, camera, body_parts(p.body, p.states[i]))
        skeleton = draw_skeleton(skeleton, camera, p.landmarks[i], p.observed[i], label=f"person {p.person}")
    for label, picture in (
        ("image", image),
        ("silhouette", draw_mask(image, mask)),
        ("hull", draw_hull(image, camera, hull)),
        ("fitted body", body),
        ("skeleton", skeleton),
    ):
        yield label, crop(picture, window, scale=scale)


def images_of(
    found: Found, frames: Sequence[int] | NDArray[np.int64]
) -> Iterator[tuple[int, tuple[Image, ...]]]:
    """Ascending frames with their pictures, read in one go; grey ones when the session has only masks."""
    session, numbers = found.session, [int(frame) for frame in frames]
    if not session.image_sources:
        grey = tuple(np.full((c.size[1], c.size[0], 3), 90, dtype=np.uint8) for c in session.rig)
        yield from ((frame, grey) for frame in numbers)
        return
    with pictures_of(session, numbers) as reader:
        yield from reader


def _chosen_cameras(found: Found, settings: OutputConfig) -> list[int]:
    """Cameras evenly spread over the rig."""
    n = len(found.session.rig)
    step = max(1, -(-n // settings.report_cameras))
    return list(range(0, n, step))[: settings.report_cameras]


def chosen_frames(found: Found, frames: NDArray[np.int64], n: int) -> NDArray[np.int64]:
    """Frames evenly spread over those in which somebody was found, or over the clip."""
    seen = sorted({int(f) for p in found.poses for f in p.frames})
    pool = np.array(seen if seen else frames, dtype=np.int64)
    return pool[np.unique(np.linspace(0, len(pool) - 1, n).round().astype(int))]
