"""Pose filters as functions on an articulated problem; they know no body and no image."""

from collections.abc import Callable

from mocap.filters.apf import (
    ApfSettings,
    FilterInfo,
    ParticleState,
    apf_step,
    initial_particles,
    sir_step,
)
from mocap.filters.budget import FilterSettings, settings_for
from mocap.filters.ddma import (
    DdmaSettings,
    DdmaState,
    LimbSettings,
    ShbmDdmaSettings,
    ddma_step,
    shbm_ddma_step,
)
from mocap.filters.partitioned import PartitionedSettings
from mocap.filters.pfcr import pfcr_step
from mocap.filters.ps import parallel_ps_step, ps_step
from mocap.filters.psapf import PsapfSettings, psapf_step, sbapf_step
from mocap.filters.psipf import PsipfSettings, psipf_step
from mocap.filters.rbpf import (
    ConditionallyLinearProblem,
    LinearMeasurement,
    MixtureState,
    RbpfSettings,
    mixture_covariance,
    rbpf_step,
)
from mocap.filters.refine import RefineInfo, RefineSettings, refine
from mocap.filters.sbps import sbps_step
from mocap.filters.scout import ScoutInfo, ScoutSettings, scout_limbs
from mocap.filters.shbm import ShbmInfo, ShbmSettings, shbm_settings, shbm_step
from mocap.filters.swarm import (
    SwarmSettings,
    apsopf_step,
    chapsopf_step,
    hapsopf_step,
    hpso_step,
    pso_step,
)

FilterStep = Callable[..., tuple[ParticleState, FilterInfo]]

# Every pose filter by the name that the command line takes; `settings_for` makes the settings of each. `rbpf_step` is
# not among them: it needs a `ConditionallyLinearProblem`, and a body is none.
FILTERS: dict[str, FilterStep] = {
    "sir": sir_step,
    "apf": apf_step,
    "shbm-apf": shbm_step,
    "ddma-pf": ddma_step,
    "shbm-ddma-pf": shbm_ddma_step,
    "ps": ps_step,
    "parallel-ps": parallel_ps_step,
    "sbps": sbps_step,
    "pfcr": pfcr_step,
    "psapf": psapf_step,
    "sbapf": sbapf_step,
    "psipf": psipf_step,
    "pso": pso_step,
    "hpso": hpso_step,
    "apsopf": apsopf_step,
    "chapsopf": chapsopf_step,
    "hapsopf": hapsopf_step,
}

# Those of them that need one log-likelihood for each part, so not a global one.
PART_BY_PART = frozenset(
    {"ps", "parallel-ps", "sbps", "pfcr", "psapf", "sbapf", "psipf", "hpso", "chapsopf", "hapsopf"}
)

__all__ = [
    "FILTERS",
    "PART_BY_PART",
    "ApfSettings",
    "ConditionallyLinearProblem",
    "DdmaSettings",
    "DdmaState",
    "FilterInfo",
    "FilterSettings",
    "FilterStep",
    "LimbSettings",
    "LinearMeasurement",
    "MixtureState",
    "ParticleState",
    "PartitionedSettings",
    "PsapfSettings",
    "PsipfSettings",
    "RbpfSettings",
    "RefineInfo",
    "RefineSettings",
    "ScoutInfo",
    "ScoutSettings",
    "ShbmDdmaSettings",
    "ShbmInfo",
    "ShbmSettings",
    "SwarmSettings",
    "apf_step",
    "ddma_step",
    "initial_particles",
    "mixture_covariance",
    "rbpf_step",
    "refine",
    "scout_limbs",
    "settings_for",
    "shbm_ddma_step",
    "shbm_settings",
    "shbm_step",
    "sir_step",
]
