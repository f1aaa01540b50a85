"""How dark the shadows of a recording get, from some of its pictures."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from mocap.arrays import Image
from mocap.foreground import Background, ForegroundSettings, Segmenter
from mocap.io.session import Session
from mocap.io.session.reading import pictures_of
from mocap.volume import Shade, choose_grid, darkest_shadow
from mocap.volume.shade import DARKEST

# Instants that are looked at, or up to twice as many, and the seconds that they are spread over: what lies between is
# decoded for nothing.
_INSTANTS, _WITHIN_S = 8, 30.0
_VOXEL_M = 0.04  # of the grid whose floor is asked


def with_shadows_of(
    session: Session,
    backgrounds: Sequence[Background],
    settings: ForegroundSettings,
    each: Callable[..., Iterable[Any]] = map,
) -> ForegroundSettings:
    """The settings with the darkness that shadows have in a recording; as they are where its cameras do not tell.

    each : `map`, perhaps over threads.  Raises MocapError for pictures that cannot be read.
    """
    if not all(camera.name in session.image_sources for camera in session.rig):
        return settings
    n = min(len(session.frames), round(_WITHIN_S * session.fps))
    with pictures_of(session, session.frames[: n : max(1, n // _INSTANTS)]) as reader:
        return with_shadows_in((seen for _, seen in reader), session, backgrounds, settings, each)


def with_shadows_in(
    instants: Iterable[Sequence[Image]],
    session: Session,
    backgrounds: Sequence[Background],
    settings: ForegroundSettings,
    each: Callable[..., Iterable[Any]] = map,
) -> ForegroundSettings:
    """The same from some pictures.  instants : (H, W, 3) uint8 per camera, of length 0 where one has none."""
    if settings.method != "gaussian":
        return settings  # OpenCV's models have tests of their own
    try:
        grid = choose_grid(session.rig, _VOXEL_M, bounds_m=session.room_bounds_m)
    except ValueError:
        return settings  # cameras that share no room
    deep = replace(settings, shadow_darkest=DARKEST)
    segmenters = [Segmenter(background, deep) for background in backgrounds]
    shades = (list(each(_shade, segmenters, backgrounds, pictures)) for pictures in instants)
    darkest = darkest_shadow(session.rig, grid, shades, settings.shadow_darkest)
    return replace(settings, shadow_darkest=darkest)


def _shade(segmenter: Segmenter, background: Background, picture: Image) -> Shade | None:
    """Shadows, persons and light of a camera's next picture; None where nothing can be used."""
    if not len(picture):
        return None
    found = segmenter.segment(picture)
    free = ~(found.mask | found.shadow)[::8, ::8]
    if not found.is_usable or not free.any():
        return None
    light = np.zeros(found.shadow.shape, dtype=np.float32)
    usual = _light(picture[::8, ::8][free], background.mean[::8, ::8][free])
    soft, shadow = cv2.blur(picture, (3, 3)), found.shadow
    light[shadow] = _light(soft[shadow], background.mean[shadow]) / np.median(usual)
    return Shade(shadow, found.mask, light)


def _light(picture: NDArray[Any], background: NDArray[Any]) -> NDArray[np.float32]:
    """Light (N,) of colours (N, 3) relative to those of the empty scene."""
    left, full = (colours.sum(axis=1, dtype=np.float32) for colours in (picture, background))
    light: NDArray[np.float32] = (left + 1) / (full + 1)
    return light
