"""Point fit: a body moved to places of points on its joints."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from mocap.body import Body
from mocap.body.kinematics import point_jacobian
from mocap.data import StateLayout

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class PointFit:
    """A body fitted to places (K, 3) m of points on its joints: implements `ResidualProblem`.

    root_weight : (K, 1), square root of the weight of each point; 1 = all weigh alike.
    """

    body: Body
    joint: NDArray[np.int64]
    offset: Array
    places: Array
    root_weight: Array | float = 1.0

    @cached_property
    def layout(self) -> StateLayout:
        return self.body.layout

    def cost(self, state: Array) -> float:
        points, _, _ = point_jacobian(self.body, state, self.joint, self.offset)
        return 0.5 * float(((self.root_weight * (points - self.places)) ** 2).sum())

    def normal_equations(self, state: Array) -> tuple[float, Array, Array]:
        points, J, _ = point_jacobian(self.body, state, self.joint, self.offset)
        r = (self.root_weight * (points - self.places)).ravel()
        A = (np.reshape(self.root_weight, (-1, 1, 1)) * J).reshape(len(r), -1)
        return 0.5 * float(r @ r), A.T @ A, A.T @ r
