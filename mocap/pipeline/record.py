"""The record of a run: what was run, with what, what came out in numbers; run.json is its file."""

from __future__ import annotations

import platform
import sys
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

from mocap.data import Motion, Tracks
from mocap.errors import DISTRIBUTION
from mocap.io.session import Session
from mocap.io.store import StageStore
from mocap.pipeline.config import Config, config_hash
from mocap.pose.kinematics import Kinematics
from mocap.pose.method import Method
from mocap.pose.result import PersonPoses

# Besides the stages, outputs take time: tables, exports, scene and report.
OUTPUTS = "report"
# What stands among the stages of a run that was joined from runs of pieces.
JOIN = "join"


@dataclass(frozen=True)
class StageRecord:
    """One stage of a run.  wall_s : that it worked, beside others perhaps; None = it was reused.  numbers : of its
    report."""

    name: str
    key: str
    wall_s: float | None
    numbers: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class RunRecord:
    """Everything about a run but its arrays: settings, timings, numbers, warnings, scores.

    kind : `voxels` or `markers`, what poses were found from.  until : the word it ended with.  stages : those it went
    through, in order.  product_keys : product in the store -> the key that it was made under.  scores : as `mocap
    eval`, None without truth.  files : the outputs that were written.  hashes : those that are read again -> what they
    hold, as of `mocap.products.one_run`.  removed : those of an earlier run that were not written anew.  outputs_s :
    for tables, exports and report.
    """

    session: str
    kind: str
    until: str
    command: str
    frames: range
    fps: float
    cameras: tuple[str, ...]
    seed: int
    config: Config
    code: str
    stages: tuple[StageRecord, ...]
    product_keys: Mapping[str, str]
    warnings: tuple[str, ...]
    scores: dict[str, Any] | None
    files: tuple[str, ...] = ()
    hashes: Mapping[str, str] = field(default_factory=dict)
    removed: tuple[str, ...] = ()
    outputs_s: float = 0.0
    peak_memory_mb: float | None = None
    versions: Mapping[str, str] = field(default_factory=dict)

    @property
    def status(self) -> str:
        """`complete`, or where it ended."""
        return "complete" if self.until == OUTPUTS else f"complete until {self.until}"

    @property
    def timings_s(self) -> dict[str, float]:
        """Stage -> seconds, outputs last; a stage that was reused is absent."""
        timings = {stage.name: stage.wall_s for stage in self.stages if stage.wall_s is not None}
        return {**timings, OUTPUTS: self.outputs_s}

    @property
    def reused(self) -> tuple[str, ...]:
        """Stages that were not computed anew."""
        return tuple(stage.name for stage in self.stages if stage.wall_s is None)

    @property
    def is_joined(self) -> bool:
        """Whether it was joined from runs of pieces; no stage can be run again then."""
        return any(stage.name == JOIN for stage in self.stages)

    @property
    def numbers(self) -> dict[str, Mapping[str, Any]]:
        """Stage -> the numbers of its report."""
        return {stage.name: stage.numbers for stage in self.stages}


@dataclass(frozen=True, eq=False)
class Found:
    """What a run has found, out of its store.  tracks : None when it ended before them.  method : of the run."""

    session: Session
    store: StageStore
    kind: str
    tracks: Tracks | None
    poses: tuple[PersonPoses, ...]
    method: Method

    @cached_property
    def people(self) -> list[Kinematics]:
        """What follows from the poses of every person."""
        return [Kinematics(p, self.session.fps, self.method) for p in self.poses]

    @property
    def motions(self) -> list[Motion]:
        """Landmarks of every person."""
        return [person.motion for person in self.people]

    @property
    def hulls(self) -> StageStore | None:
        """The store, where it holds hulls: not in a run on markers or keypoints alone."""
        return None if self.kind in ("markers", "keypoints") else self.store


@dataclass(frozen=True, eq=False)
class RunResult:
    """A run: its record, and what it has found."""

    record: RunRecord
    out: Path
    found: Found

    @property
    def session(self) -> Session:
        """The session that was worked on."""
        return self.found.session

    @property
    def tracks(self) -> Tracks | None:
        """Who was where; None when the run ended before."""
        return self.found.tracks

    @property
    def poses(self) -> tuple[PersonPoses, ...]:
        """The poses of every person."""
        return self.found.poses

    @property
    def motions(self) -> list[Motion]:
        """Landmarks of every person."""
        return self.found.motions

    @property
    def status(self) -> str:
        """`complete`, or where the run ended."""
        return self.record.status

    @property
    def scores(self) -> dict[str, Any] | None:
        """As `mocap eval`, None without truth."""
        return self.record.scores

    @property
    def timings_s(self) -> dict[str, float]:
        """Stage -> seconds; a stage that was reused is absent."""
        return self.record.timings_s

    @property
    def reused(self) -> tuple[str, ...]:
        """Stages that were not computed anew."""
        return self.record.reused

    @property
    def warnings(self) -> tuple[str, ...]:
        """What the user should know before trusting the result."""
        return self.record.warnings


def record_to_json(record: RunRecord) -> dict[str, Any]:
    """The record as run.json holds it."""
    n_frames = len(record.frames)
    timings_s = {stage: round(seconds, 3) for stage, seconds in record.timings_s.items()}
    return {
        "status": record.status,
        "session": record.session,
        "kind": record.kind,
        "until": record.until,
        "command": record.command,
        "n_frames": n_frames,
        "frames": [record.frames.start, record.frames.stop],
        "fps": record.fps,
        "cameras": list(record.cameras),
        "seed": record.seed,
        "config": record.config.model_dump(mode="json"),
        "config_hash": config_hash(record.config),
        "code_hash": record.code,
        "stage_keys": {stage.name: stage.key for stage in record.stages},
        "product_keys": dict(record.product_keys),
        "stages": {
            stage: {
                "wall_s": seconds,
                "frames_per_s": round(n_frames / seconds, 2) if seconds > 0 else None,
            }
            for stage, seconds in timings_s.items()
        },
        "reused": list(record.reused),
        "total_s": round(sum(timings_s.values()), 3),
        "peak_memory_mb": record.peak_memory_mb,
        "files": list(record.files),
        "file_hashes": dict(record.hashes),
        "removed": list(record.removed),
        "warnings": list(record.warnings),
        "numbers": record.numbers,
        "scores": record.scores,
        "versions": dict(record.versions),
    }


def record_from_json(about: Mapping[str, Any]) -> RunRecord:
    """The record out of run.json, timings to the millisecond. Raises KeyError, TypeError or ValueError."""
    walls, reused = about["stages"], set(about["reused"])
    stages = tuple(
        StageRecord(
            name,
            str(key),
            None if name in reused else float(walls[name]["wall_s"]),
            about["numbers"].get(name, {}),
        )
        for name, key in about["stage_keys"].items()
    )
    return RunRecord(
        session=str(about["session"]),
        kind=str(about["kind"]),
        until=str(about["until"]),
        command=str(about["command"]),
        frames=range(int(about["frames"][0]), int(about["frames"][1])),
        fps=float(about["fps"]),
        cameras=tuple(about["cameras"]),
        seed=int(about["seed"]),
        config=Config.model_validate(about["config"]),
        code=str(about["code_hash"]),
        stages=stages,
        product_keys=dict(about["product_keys"]),
        warnings=tuple(about["warnings"]),
        scores=about["scores"],
        files=tuple(about["files"]),
        hashes=dict(about.get("file_hashes", {})),
        removed=tuple(about["removed"]),
        outputs_s=float(walls[OUTPUTS]["wall_s"]),
        peak_memory_mb=about["peak_memory_mb"],
        versions=about["versions"],
    )


def printable(text: str) -> str:
    """Text that any file can hold: bytes of a path that are no UTF-8 become a question mark in a lozenge."""
    return text.encode("utf-8", "surrogateescape").decode("utf-8", "replace")


def versions() -> dict[str, str]:
    """Versions of this package and what its results depend on."""
    from importlib.metadata import PackageNotFoundError, version

    found = {"python": platform.python_version(), "platform": sys.platform}
    for name in ("mocap", "numpy", "scipy", "numba", "opencv-python-headless", "zarr"):
        try:
            found[name] = version(DISTRIBUTION if name == "mocap" else name)
        except PackageNotFoundError:
            found[name] = "not installed"
    return found
