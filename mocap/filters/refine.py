"""Second-order refinement of one state: Levenberg-Marquardt inside the joint limits."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mocap.data.problem import ResidualProblem
from mocap.geometry.rigid import wrap_angle

Array = NDArray[np.float64]

_DAMPING_START = 1e-3
_DAMPING_MAX = 1e4


@dataclass(frozen=True, eq=False)
class RefineSettings:
    """Settings of the refinement.

    prior_std : (D,) how far a column may be expected to move, m and rad; a weak pull to the starting state.
    residual_std_m : standard deviation of one residual, which sets the prior's weight and the covariance.
    """

    prior_std: Array
    residual_std_m: float = 0.01
    n_iterations: int = 12
    tolerance: float = 1e-4
    """Relative decrease of the cost below which the refinement stops."""
    reach: float = 1.0
    """Factor on every step: those of reweighted least squares fall short where the loss bends away from the squares."""


@dataclass(frozen=True, eq=False)
class RefineInfo:
    """cost_before, cost_after : robust cost with prior.  n_iterations : steps tried.

    information : (D, D) Gauss-Newton matrix at the result, divided by the residual variance.
    """

    cost_before: float
    cost_after: float
    n_iterations: int
    information: Array


def refine(problem: ResidualProblem, state: Array, settings: RefineSettings) -> tuple[Array, RefineInfo]:
    """Move a state (D,) to a nearby minimum of the problem's cost plus a Gaussian prior at the start.

    Never returns a state of higher cost. Columns at a limit are held there while the step points outwards.
    """
    layout = problem.layout
    start = np.clip(np.asarray(state, dtype=np.float64), layout.lower, layout.upper)
    prior = (settings.residual_std_m / settings.prior_std) ** 2

    diagonal = np.arange(len(start))
    circular = np.flatnonzero(layout.is_circular)

    def evaluate(x: Array) -> tuple[float, Array, Array]:
        cost, H, g = problem.normal_equations(x)
        d = x - start
        d[circular] = wrap_angle(d[circular])
        H = H.copy()
        H[diagonal, diagonal] += prior
        return cost + 0.5 * float(np.sum(prior * d * d)), H, g + prior * d

    x = start.copy()
    cost, H, g = evaluate(x)
    cost_before = cost
    damping = _DAMPING_START
    n = 0
    for _ in range(settings.n_iterations):
        n += 1
        free = ~(((x <= layout.lower) & (g > 0)) | ((x >= layout.upper) & (g < 0)))
        A = H.copy()
        A[diagonal, diagonal] += damping * A[diagonal, diagonal]
        if free.all():
            step = -np.linalg.solve(A, g)
        else:
            step = np.zeros_like(x)
            step[free] = -np.linalg.solve(A[free][:, free], g[free])
        candidate = np.clip(x + settings.reach * step, layout.lower, layout.upper)
        new_cost, new_H, new_g = evaluate(candidate)
        if new_cost < cost:
            gain = (cost - new_cost) / max(cost, 1e-300)
            x, cost, H, g = candidate, new_cost, new_H, new_g
            damping = max(0.3 * damping, 1e-6)
            if gain < settings.tolerance:
                break
        else:
            damping *= 8.0
            if damping > _DAMPING_MAX:
                break
    return x, RefineInfo(cost_before, cost, n, H / settings.residual_std_m**2)
