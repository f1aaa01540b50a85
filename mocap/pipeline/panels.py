"""Panels of the report: a few frames in a few cameras, from the picture to the fitted body."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np
from numpy.typing import NDArray

from mocap.data import Camera, Hull
from mocap.pipeline.config import OutputConfig
from mocap.pipeline.pictures import chosen_frames
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
# Frame -> camera -> picture as filmed.
Whole = Mapping[int, Mapping[str, Image]]

_PANEL_HEIGHT_PX = 420


def frame_panels(found: Found, settings: OutputConfig, whole: Whole) -> Iterator[FramePanel]:
    """Pictures of a few frames, with what the poses were found from.  whole : pictures of at least these frames."""
    panels = _volume_panels if found.hulls is not None else marker_panels
    return panels(found, settings, whole)


def _volume_panels(found: Found, settings: OutputConfig, whole: Whole) -> Iterator[FramePanel]:
    """Image, silhouette, hull and fitted body."""
    session, store = found.session, found.store
    hulls, masks = store.reader(hulls_product.PRODUCT), store.reader(masks_product.PRODUCT)
    grid = grid_from_attrs(hulls.attrs)
    for frame in chosen_frames(found, settings.report_frames):
        hull = hull_from_arrays(grid, hulls.read(frame))
        mask = masks_from_arrays(masks.read(frame), session)
        rows = rows_at(found.poses, frame)
        rig = session.rig_at(frame)
        for c in _chosen_cameras(found, settings):
            name = rig[c].name
            images = tuple(_views(rig[c], whole[frame][name], mask[c], hull, rows))
            yield FramePanel(frame=frame, title=name, images=images)


def marker_panels(found: Found, settings: OutputConfig, whole: Whole) -> Iterator[FramePanel]:
    """Pictures of a few frames: image, detections and fitted body in a few cameras."""
    from mocap.view import crop, draw_body, draw_skeleton, person_window
    from mocap.view.detections import draw_detections

    session = found.session
    for frame in chosen_frames(found, settings.report_frames):
        read = keypoints_at if found.kind == "keypoints" else detections_at
        detections = read(found.store, session, frame)
        rows = rows_at(found.poses, frame)
        for c in _chosen_cameras(found, settings):
            camera = session.rig[c]
            image = whole[frame][camera.name]
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
                frame=frame,
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


def _chosen_cameras(found: Found, settings: OutputConfig) -> list[int]:
    """Cameras evenly spread over the rig."""
    n = len(found.session.rig)
    step = max(1, -(-n // settings.report_cameras))
    return list(range(0, n, step))[: settings.report_cameras]
