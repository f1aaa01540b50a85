"""The voxel likelihood on a CUDA device: the scores of many particles, a block of its threads for each."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import Any

import numpy as np

from mocap.arrays import Array
from mocap.body.flesh import LookUpTable
from mocap.body.model import Body
from mocap.likelihood.voxels.exact import (
    PackedVolume,
    PartScores,
    check_states,
    chosen_parts,
    counts_to_scores,
    selected,
)
from mocap.likelihood.voxels.fast import fast_sample, shares_to_scores


def device_part_scores(
    body: Body,
    table: LookUpTable,
    volume: PackedVolume,
    states: Array,
    *,
    n_points: int | None = None,
    parts: Sequence[int] | None = None,
    given: Sequence[int] = (),
) -> PartScores:
    """The scores that `part_scores` gives, or with n_points those of `fast_part_scores`, from a CUDA device.

    Table, sample, body and volume stay there from call to call. A device rounds otherwise: a score may differ by what
    the points weigh that lie within 1e-4 voxels of a border. It is the same in every run.
    Raises what these raise, and ValueError for a body of more than 64 joints or segments.
    """
    # It opens the device, and brings the packages of the extra `gpu`.
    from mocap.likelihood.voxels import _cuda_kernels as device

    s = check_states(body, states)
    chosen, placed = chosen_parts(body, parts, given)
    if max(len(body.parent), len(table.joint)) > device.MAX_JOINTS:
        raise ValueError(f"a device takes {device.MAX_JOINTS} joints and segments, got {len(table.joint)}")
    box, room, crop = _kept(_volume_of, volume)
    args = s, len(chosen), _kept(_chain_of, body), box, room, crop
    if n_points is not None:
        return shares_to_scores(
            device.fast_scores(*args, _kept(fast_sample, table, chosen, placed, n_points))
        )
    counts = device.exact_counts(*args, _kept(selected, table, chosen, placed)[0])
    return counts_to_scores(counts, *selected(table, chosen, placed)[1:])


def device_name() -> str | None:
    """What the CUDA device is called that would score; None where none answers, or the extra `gpu` is missing.

    Asking opens it.
    """
    try:
        from mocap.likelihood.voxels import _cuda_kernels as device
    except ImportError:
        return None
    return device.device_name()


@lru_cache(maxsize=64)
def _kept(make: Callable[..., Any], *args: Any) -> Any:
    """What a function makes of its arguments, on the device: filters ask for the same few in every layer."""
    from mocap.likelihood.voxels._cuda_kernels import uploaded

    return uploaded(make(*args))


def _chain_of(body: Body) -> Any:
    return body.chain


def _volume_of(volume: PackedVolume) -> Any:
    """Box, room (2, 3) in the crop's voxels, and crop (V,)."""
    box = volume.box
    room = (np.stack([box.room_lower, box.room_upper]) - box.lower) / box.voxel_size
    return box, room.astype(np.float32), volume.crop.reshape(-1)
