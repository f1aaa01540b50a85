"""Owners, product `track-owners`: the person that holds each voxel of the hull.

Per frame `owner` (N,) uint16 in the order of the hull's voxels, 0 = nobody.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mocap.io.store import StageReader

PRODUCT = "track-owners"


def owner_row(owner: NDArray[np.uint16]) -> dict[str, NDArray[np.generic]]:
    """The arrays of one frame."""
    return {"owner": owner}


def owners_at(reader: StageReader, frame: int) -> NDArray[np.uint16]:
    """Owners of one frame, (N,)."""
    return reader.read(frame)["owner"]
