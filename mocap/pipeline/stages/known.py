"""Whom keypoints know in the pictures of a clip, asked before its volume is carved.

Keypoints of other moments than the pictures would put their persons into every silhouette, and those with left and
right exchanged turn every pose about: they know nobody.
"""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import NDArray

from mocap.data.keypoints import NOBODY
from mocap.pipeline.stage import Job
from mocap.products import masks as masks_product
from mocap.products.keypoints import PRODUCT, known_points
from mocap.products.masks import masks_from_arrays
from mocap.tracking.figure_faults import FaultSettings, FigureFault, find_picture_fault
from mocap.volume.known_persons import BesideSilhouettes

_MIRRORED = FigureFault(
    "volumes are carved, and poses found, without keypoints whose left and right seem exchanged",
    "exchange the names; --observation keypoints takes them as they are",
)


def known_in_pictures(job: Job) -> tuple[dict[int, NDArray[np.float64]], FigureFault | None]:
    """Frame -> the points (P, K, 3) m of known persons, and what is wrong with keypoints that know nobody for it."""
    known = known_points(job.store, job.session.fps)
    reader, rig = job.store.reader(masks_product.PRODUCT), job.session.rig

    @cache
    def silhouettes(frame: int) -> BesideSilhouettes:
        return BesideSilhouettes.of(masks_from_arrays(reader.read(frame), job.session), rig)

    def beside_m(frame: int, shown: int) -> float:
        return silhouettes(frame).mean_m(known.get(shown, NOBODY))

    is_mirrored = job.store.reader(PRODUCT).attrs.get("is_mirrored", False)
    fault = _MIRRORED if is_mirrored else find_picture_fault(beside_m, job.session.frames, FaultSettings())
    return known if fault is None else dict.fromkeys(known, NOBODY), fault
