"""All pose filters in one table, and their settings from a budget."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from mocap.data.problem import StateLayout
from mocap.filters.apf import APF, SIR
from mocap.filters.apsopf import APSOPF
from mocap.filters.budget import FilterBudget, FilterSettings
from mocap.filters.chapsopf import CHAPSOPF, CHAPSOPF_PRINTED
from mocap.filters.ddma import DDMA_PF, SHBM_DDMA_PF
from mocap.filters.hapsopf import HAPSOPF, HAPSOPF_PRINTED
from mocap.filters.hpso import HPSO
from mocap.filters.pfcr import PFCR, PFCR_EQUAL
from mocap.filters.ps import PARALLEL_PS, PS
from mocap.filters.psapf import PSAPF, SBAPF
from mocap.filters.psipf import PSIPF
from mocap.filters.pso import PSO
from mocap.filters.record import Filter
from mocap.filters.sbps import SBPS
from mocap.filters.shbm import SHBM_APF

Array = NDArray[np.float64]

# In the order in which they are listed to people. `rbpf_step` is not among them: it needs a
# `ConditionallyLinearProblem`, and a body is none.
FILTERS: dict[str, Filter[Any]] = {
    one.name: one
    for one in (
        SIR,
        APF,
        SHBM_APF,
        DDMA_PF,
        SHBM_DDMA_PF,
        PS,
        PARALLEL_PS,
        SBPS,
        PFCR,
        PFCR_EQUAL,
        PSAPF,
        SBAPF,
        PSIPF,
        PSO,
        HPSO,
        APSOPF,
        CHAPSOPF,
        CHAPSOPF_PRINTED,
        HAPSOPF,
        HAPSOPF_PRINTED,
    )
}


def filter_settings(budget: FilterBudget, layout: StateLayout, std: Array) -> FilterSettings:
    """Settings with which the budget's filter spends about its n_evaluations in every frame.

    std : (D,) noise of one frame, m and rad.
    Raises ValueError for an unknown name, and for a hierarchy or limbs that do not fit the layout.
    """
    if budget.name not in FILTERS:
        raise ValueError(f"filter {budget.name!r} is none of {', '.join(FILTERS)}")
    if std.shape != (layout.n_columns,):
        raise ValueError(f"std has shape {std.shape}, expected ({layout.n_columns},)")
    settings: FilterSettings = FILTERS[budget.name].settings_from_budget(budget, layout, std)
    return settings
