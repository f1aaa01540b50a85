"""Scores of some states by a CUDA device, or by numba's simulator of one: `python device_scores.py OUT.npz`.

A process of its own, since numba learns when it is imported that it is to simulate.
"""

from __future__ import annotations

import sys
import warnings
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
from flesh_voxels import make_flesh
from numpy.typing import NDArray

from mocap.body import Body, LookUpTable, neutral_state
from mocap.likelihood.voxels import PackedVolume, PartScores
from mocap.likelihood.voxels.device import device_name, device_part_scores
from mocap.pose.volume import pack_volume

FIELDS = ("out", "double", "occupied", "surface")
# Name -> arguments of `device_part_scores` beside body, table, volume and states.
CASES: dict[str, dict[str, object]] = {
    "exact": {},
    "exact, some parts": {"parts": (4, 0, 3), "given": (2, 9)},
    "exact, no part": {"parts": (), "given": (1,)},
    "fast": {"n_points": 31},
    "fast, some parts": {"n_points": 31, "parts": (4, 0, 3), "given": (2, 9)},
    "fast, no part": {"n_points": 31, "parts": (), "given": (1,)},
}


def problem() -> tuple[Body, LookUpTable, PackedVolume, NDArray[np.float64]]:
    """A body, its table, a volume without its legs' ends, and states in and beside it: 7 of them."""
    flesh = make_flesh("whole", 1.7, 0.06)
    truth = neutral_state(flesh.body)
    volume = pack_volume(flesh.grid, flesh.hull(truth, without=(7, 9)), 1.0)
    rng = np.random.default_rng(5)
    states = truth + rng.normal(size=(7, len(truth))) * np.where(np.arange(len(truth)) < 3, 0.05, 0.4)
    states[0] = truth
    states[2, :3] = flesh.grid.upper - [0.3, 0.02, 0.9]  # half out of the room
    states[3, :3] = [50.0, -80.0, 9.0]
    states[4, 0] = np.nan
    states[5, 9] = np.nan
    # Limbs in the trunk: of seeds 0 to 29 it is 7 and 25 that have more than all of a part in others.
    states[6] = truth
    states[6, 3:] += np.random.default_rng(7).normal(size=len(truth) - 3) * 2.5
    return flesh.body, flesh.table, volume, states


def scores(of: Callable[..., PartScores]) -> dict[str, NDArray[np.float64]]:
    """Case -> scores (4, N, P'), of a function with the arguments of `device_part_scores`."""
    args = problem()
    found = {name: of(*args, **case) for name, case in CASES.items()}
    return {name: np.stack([getattr(one, field) for field in FIELDS]) for name, one in found.items()}


def _write(out: Path) -> None:
    from numba import config

    from mocap.likelihood.voxels import _cuda_kernels as kernels

    if config.ENABLE_CUDASIM:
        # Few threads, each of which is one of Python, and no divisor of anything; three blocks with two or three
        # states each, which renew their stamps.
        kernels._THREADS, kernels._N_TAGS, crop = 5, 3, problem()[2].crop
        kernels._STAMPS_BYTES = 3 * 4 * crop.size + 1
        for what in ("overflow", "invalid value"):  # tags are meant to; what is not a number is tested
            warnings.filterwarnings("ignore", f".*{what} encountered", RuntimeWarning)
    body, table, *where = problem()
    many = replace(table, joint=np.zeros(kernels.MAX_JOINTS + 1, dtype=np.int64))
    try:
        device_part_scores(body, many, *where)
    except ValueError as error:
        refused = str(error)
    np.savez(out, name=str(device_name()), refused=refused, **scores(device_part_scores))


if __name__ == "__main__":
    _write(Path(sys.argv[1]))
