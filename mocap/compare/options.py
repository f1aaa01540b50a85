"""Options of a comparison: what a user may say about the two sides and about the scores."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from mocap.compare.detail import LEARN_SHARE
from mocap.io.poses import SideMap, read_map
from mocap.metrics.image import EPSILON_PX


@dataclass(frozen=True)
class CompareOptions:
    """What a user may say about a comparison; see `mocap eval --help`.

    estimate, truth : unit, axes, rate and landmarks of a side, before what its file says.  map_path : the same from a
    file, after it.  frame_offset, time_offset_s : added to the estimate's frames and times.
    """

    epsilon_mm: float = 100.0
    epsilon_px: float = EPSILON_PX
    estimate: SideMap = field(default_factory=SideMap)
    truth: SideMap = field(default_factory=SideMap)
    map_path: Path | None = None
    frame_offset: int = 0
    time_offset_s: float = 0.0
    actions_path: Path | None = None
    cameras_path: Path | None = None
    learn_share: float = LEARN_SHARE


def side_maps(options: CompareOptions) -> tuple[SideMap, SideMap]:
    """What is said about estimate and truth: the options first, the file of `map_path` where they say nothing."""
    mapped = {} if options.map_path is None else read_map(options.map_path)
    return (
        _merged(options.estimate, mapped.get("estimate", SideMap())),
        _merged(options.truth, mapped.get("truth", SideMap())),
    )


def _merged(first: SideMap, second: SideMap) -> SideMap:
    return SideMap(
        first.landmarks or second.landmarks,
        first.unit or second.unit,
        first.up or second.up,
        first.fps or second.fps,
    )
