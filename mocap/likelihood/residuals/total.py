"""Several kinds of residuals on one state."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mocap.arrays import Array
from mocap.data.problem import ResidualProblem, StateLayout


@dataclass(frozen=True, eq=False)
class SumProblem:
    """A weighted sum of residual problems: itself a residual problem.  terms : (weight, problem), at least one."""

    terms: tuple[tuple[float, ResidualProblem], ...]

    @property
    def layout(self) -> StateLayout:
        return self.terms[0][1].layout

    def normal_equations(self, state: Array) -> tuple[float, Array, Array]:
        """The weighted sums of costs, matrices and gradients."""
        D = self.layout.n_columns
        cost, H, g = 0.0, np.zeros((D, D)), np.zeros(D)
        for weight, problem in self.terms:
            if weight > 0:
                own_cost, own_H, own_g = problem.normal_equations(state)
                cost += weight * own_cost
                H += weight * own_H
                g += weight * own_g
        return cost, H, g
