"""Masks from what is known beforehand: GrabCut between what surely is background and what likely is not."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from mocap.arrays import Image, Mask

# Of a picture 640 pixels wide. A mask without colours may have gaps as wide as a trunk, and lacks rims of a few pixels.
# Farther from it shade is taken for a person: outlines anywhere in the volume of others made a second one of it
# (decision 118).
_GREY_GAP_PX, _GREY_RIM_PX = 31, 7
_MARGIN_PX = 24  # picture beyond what is uncertain that GrabCut learns the surroundings from


def refine_mask(
    image: Image,
    allowed: Mask,
    likely: Mask,
    sure: Mask | None = None,
    *,
    n_looks: int = 2,
) -> Mask:
    """The person's outline in a picture, found by colours and edges from a guess.

    image : (H, W, 3) uint8 RGB.  allowed : (H, W) bool, outside is surely background: the reprojected hull of other
    cameras with a margin.  likely : (H, W) bool, the guess; what is allowed and not likely may still become person.
    sure : (H, W) bool, what stays person whatever its colour, as far as it is allowed; None = nothing.
    n_looks : how often the colours of both are learnt anew from the outline; each takes as long as the first.
    Nothing likely, or nothing that is surely background: the guess comes back, as far as it is allowed.
    Raises ValueError for shapes that do not match. The result does not depend on earlier calls.
    """
    sure = np.zeros_like(allowed) if sure is None else sure
    _check_shapes(image, allowed=allowed, likely=likely, sure=sure)
    guess = allowed & likely
    x, y, w, h = cv2.boundingRect(allowed.astype(np.uint8))
    rows = slice(max(y - _MARGIN_PX, 0), y + h + _MARGIN_PX)
    columns = slice(max(x - _MARGIN_PX, 0), x + w + _MARGIN_PX)
    classes = np.where(allowed[rows, columns], cv2.GC_PR_BGD, cv2.GC_BGD).astype(np.uint8)
    classes[guess[rows, columns]] = cv2.GC_PR_FGD
    classes[(allowed & sure)[rows, columns]] = cv2.GC_FGD
    picture = np.ascontiguousarray(image[rows, columns])
    is_person = _is_person(classes)
    if not is_person.any() or is_person.all():
        return guess
    cv2.setRNGSeed(0)  # GrabCut starts its colour models from a random clustering
    cv2.grabCut(picture, classes, None, np.zeros((1, 65)), np.zeros((1, 65)), n_looks, cv2.GC_INIT_WITH_MASK)
    out = np.zeros(image.shape[:2], dtype=np.bool_)
    out[rows, columns] = _is_person(classes)
    return out & allowed


def grey_outline(brightness: NDArray[np.uint8], empty: NDArray[np.uint8], mask: Mask) -> Mask:
    """A mask found once more in a picture without colours: by its brightness, by that of the empty scene, and by how
    they differ.

    brightness, empty : (H, W) grey levels.  mask : (H, W) bool, what was found; its inside stays, and nothing far from
    it is added, because shade lies there.
    Raises ValueError for shapes that do not match.
    """
    # A person as bright as the wall behind him ends where his brightness or the wall's does.
    told = np.dstack([brightness, empty, cv2.convertScaleAbs(cv2.absdiff(brightness, empty), alpha=2)])
    scale = mask.shape[1] / 640
    gap, rim = (
        np.ones((round(length * scale) | 1,) * 2, np.uint8) for length in (_GREY_GAP_PX, _GREY_RIM_PX)
    )
    whole = cv2.morphologyEx(mask.astype(np.uint8), cv2.MORPH_CLOSE, gap)
    allowed = cv2.dilate(whole, rim) > 0
    inside = cv2.erode(mask.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
    return refine_mask(told, allowed, mask, inside, n_looks=1)


def _is_person(classes: NDArray[np.uint8]) -> Mask:
    return (classes == cv2.GC_FGD) | (classes == cv2.GC_PR_FGD)


def _check_shapes(image: Image, **masks: NDArray[np.bool_]) -> None:
    """ValueError for a picture or a mask of the wrong kind."""
    height, width = image.shape[:2]
    if image.shape != (height, width, 3) or image.dtype != np.uint8:
        raise ValueError(f"image: expected (H, W, 3) uint8, got {image.shape} {image.dtype}")
    for name, other in masks.items():
        if other.shape != (height, width) or other.dtype != np.bool_:
            raise ValueError(
                f"{name}: expected bool of shape {(height, width)}, got {other.dtype} {other.shape}"
            )
