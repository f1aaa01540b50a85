"""Masks from what is known beforehand: GrabCut between a sure inside and a sure outside."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from mocap.arrays import Image, Mask

_MARGIN_PX = 24  # picture beyond the uncertain band that GrabCut learns the surroundings from


def refine_mask(
    image: Image,
    prior: Mask,
    mask: Mask | None = None,
    *,
    inner_px: int = 4,
    outer_px: int = 6,
    n_iterations: int = 3,
) -> Mask:
    """The person's outline in a picture, found near a prior: the reprojected hull of other cameras, or a body.

    image : (H, W, 3) uint8 RGB.  prior : (H, W) bool.  Without a mask, the prior eroded by inner_px is surely
    foreground, what lies further than outer_px outside it surely background, and colours decide between.
    mask : (H, W) bool, a mask to be completed: it stays where it lies in the prior; colours decide in the rest of
    the prior, and nothing is added outside. Use it where clothes have the colour of the wall.
    A prior that is empty, or has no inside, comes back as it is (with `mask`: the mask does).
    Raises ValueError for shapes that do not match. The result does not depend on earlier calls.
    """
    height, width = image.shape[:2]
    _check_shapes(image, prior=prior, mask=mask)
    kept = prior if mask is None else mask
    x, y, w, h = cv2.boundingRect(prior.astype(np.uint8))
    margin = outer_px + _MARGIN_PX
    window = (slice(max(y - margin, 0), y + h + margin), slice(max(x - margin, 0), x + w + margin))
    inside = prior[window].astype(np.uint8)
    if mask is None:
        classes = _classes_of_prior(inside, inner_px, outer_px)
    else:
        known = mask[window].astype(np.uint8) & inside
        classes = np.where(inside > 0, cv2.GC_PR_BGD, cv2.GC_BGD).astype(np.uint8)
        classes[known > 0] = cv2.GC_FGD
    if not (classes == cv2.GC_FGD).any() or not (classes == cv2.GC_BGD).any():
        return kept.copy()
    cv2.setRNGSeed(0)  # GrabCut starts its colour models from a random clustering
    picture = np.ascontiguousarray(image[window])
    cv2.grabCut(
        picture, classes, None, np.zeros((1, 65)), np.zeros((1, 65)), n_iterations, cv2.GC_INIT_WITH_MASK
    )
    out = np.zeros((height, width), dtype=np.bool_)
    out[window] = (classes == cv2.GC_FGD) | (classes == cv2.GC_PR_FGD)
    return out


def _check_shapes(image: Image, **masks: Mask | None) -> None:
    """ValueError for a picture or a mask of the wrong kind."""
    height, width = image.shape[:2]
    if image.shape != (height, width, 3) or image.dtype != np.uint8:
        raise ValueError(f"image: expected (H, W, 3) uint8, got {image.shape} {image.dtype}")
    for name, other in masks.items():
        if other is not None and (other.shape != (height, width) or other.dtype != np.bool_):
            raise ValueError(
                f"{name}: expected bool of shape {(height, width)}, got {other.dtype} {other.shape}"
            )


def _classes_of_prior(inside: NDArray[np.uint8], inner_px: int, outer_px: int) -> NDArray[np.uint8]:
    """GrabCut's classes (h, w): sure inside the prior, sure far outside it, and two kinds of doubt between."""
    near = cv2.dilate(inside, _disc(outer_px)) > 0
    classes = np.where(near, cv2.GC_PR_BGD, cv2.GC_BGD).astype(np.uint8)
    classes[inside > 0] = cv2.GC_PR_FGD
    classes[cv2.erode(inside, _disc(inner_px)) > 0] = cv2.GC_FGD
    return classes


def _disc(radius: int) -> NDArray[np.uint8]:
    return cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * radius + 1, 2 * radius + 1))
