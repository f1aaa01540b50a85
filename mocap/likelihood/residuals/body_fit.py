"""Hull surface and outlines together: what the refinement of a pose minimises."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

from mocap.arrays import Array
from mocap.data.problem import StateLayout
from mocap.likelihood.residuals._descent_kernels import Bounds, FitTerms, descend, fit_equations
from mocap.likelihood.residuals.outlines import OutlineProblem, no_outline_terms
from mocap.likelihood.residuals.surface import SurfaceProblem
from mocap.threads import in_parallel


@dataclass(frozen=True, eq=False)
class BodyFit:
    """The weighted sum of the residuals of hull surface and outlines: a residual problem with a fast descent.

    outlines : None without masks.  usual_weight : m^2 per hull point and nat, the weight of what angles are usual;
    0 = any angle is as good.  usual_std : (D,) how far each angle usually is from 0, None = as of the body.
    """

    surface: SurfaceProblem
    outlines: OutlineProblem | None
    surface_weight: float = 1.0
    outline_weight: float = 1.0
    usual_weight: float = 0.0
    usual_std: Array | None = None

    @property
    def layout(self) -> StateLayout:
        return self.surface.layout

    def normal_equations(self, state: Array) -> tuple[float, Array, Array]:
        """Robust cost, its Gauss-Newton matrix (D, D) and gradient (D,) at a state (D,), m^2 summed over points."""
        D = self.layout.n_columns
        H, g, H_part, g_part = np.empty((D, D)), np.empty(D), np.empty((D, D)), np.empty(D)
        x = np.ascontiguousarray(state, dtype=np.float64)
        return float(fit_equations(x, self._terms(), H, g, H_part, g_part)), H, g

    def descended(
        self,
        states: Array,
        *,
        prior_std: Array,
        residual_std_m: float,
        n_iterations: int,
        tolerance: float,
        reach: float = 1.0,
        n_threads: int = 1,
    ) -> Array:
        """Each of the states (K, D) moved to a nearby minimum of the cost plus a Gaussian prior at its start.

        The arguments are those of `filters.RefineSettings`; `filters.refine` says the same in numpy, one state
        after the other. The result does not depend on n_threads.
        """
        layout = self.layout
        prior = (residual_std_m / prior_std) ** 2
        moved = np.array(states, dtype=np.float64, order="C", ndmin=2)
        terms, bounds = self._terms(), Bounds(layout.lower, layout.upper, layout.is_circular)

        def job(rows: slice) -> None:
            descend(moved[rows], terms, bounds, prior, n_iterations, tolerance, reach)

        # Whole blocks: rows with gaps between them would be compiled for apart.
        edges = np.linspace(0, len(moved), min(n_threads, len(moved)) + 1).astype(int)
        in_parallel(job, [slice(a, b) for a, b in itertools.pairwise(edges)], n_threads)
        return moved

    def _terms(self) -> FitTerms:
        """The fit as the kernels take it."""
        surface, outlines = self.surface, self.outlines
        has_outlines = outlines is not None and outlines.n_points > 0
        return FitTerms(
            surface.body.arrays,
            surface.terms,
            outlines.terms if outlines is not None and has_outlines else no_outline_terms(),
            (
                self.surface_weight if surface.n_points else 0.0,
                self.outline_weight if has_outlines else 0.0,
            ),
            self.usual_weight
            * surface.n_points
            / (surface.body.usual_std if self.usual_std is None else self.usual_std) ** 2,
        )
