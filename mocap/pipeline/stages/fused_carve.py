"""Carving beside keypoints, which say where silhouettes lack somebody, and where nobody is."""

from __future__ import annotations

from dataclasses import replace

from mocap.pipeline.stage import FrameWork, Job, Sources, StageReport
from mocap.pipeline.stages.carve import CARVE, carve_report
from mocap.pipeline.stages.known import known_in_pictures

_ALONE = CARVE.work
assert isinstance(_ALONE, FrameWork)
_reads_alone = _ALONE.reads


def _reads(job: Job) -> Sources:
    (points, _), frames = known_in_pictures(job), job.session.frames
    return {**_reads_alone(job), "known": ((frame, points[frame]) for frame in frames)}


def fused_carve_report(job: Job) -> StageReport:
    """That of the volumes, and whether keypoints and pictures are of the same recording."""
    report, (_, fault) = carve_report(job), known_in_pictures(job)
    said = () if fault is None else (f"{fault.message}. Remedy: {fault.remedy}",)
    return StageReport((*said, *report.warnings), report.numbers)


FUSED_CARVE = replace(
    CARVE,
    work=replace(_ALONE, reads=_reads),
    report=fused_carve_report,
    needs=("segment", "occluders", "keypoints"),
    # Whom keypoints know is told by the masks of the whole clip.
    needs_whole=("segment", "occluders"),
    facts=("fps", "room_bounds_m", "depth"),
)
