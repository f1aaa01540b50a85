"""How dark shadows get in a recording, told by cameras that see the same floor.

Dark trousers before a dark floor look like the floor in deep shadow. But a shadow lies on the floor, and whoever sees
the place sees it dark; behind trousers another camera sees it lit. One pixel is often wrong; many of them, of all
cameras and some instants, say below which brightness it is people and above which it is shade.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from mocap.arrays import Mask
from mocap.data import CameraRig, VoxelGrid
from mocap.volume.carve import pixels_in_all
from mocap.volume.floor import floor_behind

# Of the light of the empty scene: lighter shadows are too faint for some cameras.
DARKEST, LIGHTEST = 0.3, 0.7
_STEP = 0.02
_SAME_LIGHT = 0.1  # a shadow is as dark from everywhere; somebody's trousers before and behind him are not
_PIXELS = 4000  # of a camera and instant: of more, every second or third is asked about
# Share of the pictures' pixels that another limit must tell better than the usual one, in pixels of 640 x 480. It was
# 420 in dev:furnished and 300 in dark_trousers, where trousers have the floor's colour, 1,500 in dev:walk with shadows
# made as dark as in the sun; 33 at most in 44 other sessions and scenes (decision 89).
_LEAST_TOLD = 40.0 / (640 * 480)


class Shade(NamedTuple):
    """What a camera shows in an instant: shadows and persons, (H, W) bool, and the light of the empty scene that is
    left, (H, W) float32.
    """

    shadow: Mask
    person: Mask
    light: NDArray[np.float32]


def darkest_shadow(
    rig: CameraRig, grid: VoxelGrid, instants: Iterable[Sequence[Shade | None]], usual: float
) -> float:
    """The brightness relative to the empty scene from which on what could be a shadow is one.

    instants : what every camera shows, None for one that shows nothing that can be used; shadows reach down to
    DARKEST.  usual : the answer where cameras do not tell, or that tells about as well.
    """
    edges = np.arange(DARKEST, LIGHTEST + _STEP / 2, _STEP)
    lying, standing = np.zeros((2, len(edges) - 1))
    n_seen = 1
    for seen in instants:
        for c, shade in enumerate(seen):
            if shade is not None:
                light, on_floor, each = _told(rig, grid, seen, c, shade)
                lying += each * np.histogram(light[on_floor > 0], edges)[0]
                standing += each * np.histogram(light[on_floor < 0], edges)[0]
                n_seen += shade.shadow.size
    # Shadows below the limit are taken for persons, persons above it for shadows.
    wrong = np.append(0, lying.cumsum()) + np.append(0, standing[::-1].cumsum())[::-1]
    best, at_usual = int(wrong.argmin()), int(np.abs(edges - usual).argmin())
    is_told = wrong[at_usual] - wrong[best] >= _LEAST_TOLD * n_seen
    return float(edges[best]) if is_told else usual


def _told(
    rig: CameraRig, grid: VoxelGrid, seen: Sequence[Shade | None], c: int, shade: Shade
) -> tuple[NDArray[np.float32], NDArray[np.int64], int]:
    """The light (N,) of camera c's shadows, how many more of the others see the floor there dark than lit, and for how
    many pixels each stands.
    """
    inside = cv2.erode(shade.shadow.view(np.uint8), np.ones((3, 3), np.uint8)).view(np.bool_)
    pixels = np.flatnonzero(inside & (shade.light >= DARKEST) & (shade.light < LIGHTEST))
    each = 1 + len(pixels) // _PIXELS
    pixels, floor = floor_behind(rig[c], grid, pixels[::each])
    light, more_dark = shade.light.ravel()[pixels], np.zeros(len(pixels), dtype=np.int64)
    for other, (place, look) in enumerate(zip(pixels_in_all(rig, floor), seen, strict=True)):
        if other != c and look is not None:
            in_picture = place >= 0
            is_shadow, is_person = look.shadow.ravel()[place], look.person.ravel()[place]
            is_same = np.abs(look.light.ravel()[place] - light) < _SAME_LIGHT
            more_dark += in_picture * np.where(is_shadow, is_same, np.where(is_person, 0, -1))
    return light, more_dark, each
