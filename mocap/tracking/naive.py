"""The naive tracker: the centroid of the voxels in an ellipsoid of influence.

It has no filter: what `claims` finds about the predicted positions is its estimate.  Source: CF 4.3.1, Eq. 4.4, 4.5.
"""

from __future__ import annotations

import numpy as np

from mocap.tracking.claims import Claim, Frame
from mocap.tracking.state import Track


def start(track: Track, frame: Frame, claim: Claim, *, rng: np.random.Generator) -> Track:
    """The track with nothing to remember."""
    return track


def estimate(track: Track, others: np.ndarray, frame: Frame, *, rng: np.random.Generator) -> Track:
    """The predicted track: the ellipsoid stands there. CF Eq. 4.4."""
    return track.replace(efficiency=1.0)
