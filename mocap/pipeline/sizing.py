"""The height of a person who may never stand upright: the size at which refined poses explain the volumes best."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mocap.body import build_look_up_table
from mocap.body.stretch import resize_body
from mocap.likelihood.residuals import OutlineProblem, SurfaceProblem
from mocap.likelihood.voxels import VoxelProblem
from mocap.pipeline.pose_problem import FrameProblem, PoseTools

Array = NDArray[np.float64]

# The head's top is a lower bound of the height, but for the hull's grain; how far below it a person may hold the head
# is not known.
_BELOW_STD = 0.01
_ABOVE_STD = 0.04
_UNSEEN_STD = 0.06  # of a usual height, taken for someone whose head was never high enough to say anything
_GIRTH_STD = 0.08
# Body and person differ in more than size, in all frames alike: however many frames, they count as so many.
_FRAMES_WORTH = 2.0
_STEP = 0.03
_GIRTH_STEP = 0.08
_FURTHEST = 5  # steps
_REFINEMENTS = 8


@dataclass(frozen=True)
class SizeFit:
    """factor : of all lengths.  girth : of the radii.  n_frames : that were fitted."""

    factor: float
    girth: float
    n_frames: int


def resized_tools(tools: PoseTools, factor: float, girth: float | None = None) -> PoseTools:
    """The tools with a body of another size.  girth : factor of the radii, None = as the lengths."""
    body = resize_body(tools.body, factor, factor if girth is None else girth)
    table = build_look_up_table(body, tools.grid.voxel_size_m * tools.pose.table_density)
    return replace(tools, body=body, table=table)


def fit_size(
    frames: Sequence[FrameProblem], states: Sequence[Array], *, is_head_seen: bool = True
) -> SizeFit:
    """How much larger a person is than the body of these frames, each with a pose (D,) of that body.

    is_head_seen : the body's height is the highest place of the head, not just a usual height.

    Poses are refined at every size tried. Girth is fitted too, so that a slim person is not taken for a short one, but
    it is not to be kept: clothes and masks that are a little too wide count as girth (decision 19).
    Raises ValueError without frames.
    """
    if not frames:
        raise ValueError("frames is empty: no size can be fitted")

    below, above = (_BELOW_STD, _ABOVE_STD) if is_head_seen else (_UNSEEN_STD, _UNSEEN_STD)

    def cost(log_factor: float, log_girth: float) -> float:
        tools = resized_tools(frames[0].tools, float(np.exp(log_factor)), float(np.exp(log_girth)))
        misfits = []
        for frame, state in zip(frames, states, strict=True):
            other = _with_tools(frame, tools)
            misfits.append(float(other.misfit([other.refined(state, _REFINEMENTS)])[0]))
        prior = (log_factor / (below if log_factor < 0 else above)) ** 2
        return _FRAMES_WORTH * float(np.mean(misfits)) + 0.5 * (prior + (log_girth / _GIRTH_STD) ** 2)

    size, _ = _lowest(lambda s: cost(s, 0.0), 0.0, _STEP)
    girth, _ = _lowest(lambda g: cost(size, g), 0.0, _GIRTH_STEP, furthest=1)
    size, _ = _lowest(lambda s: cost(s, girth), size, _STEP)
    return SizeFit(float(np.exp(size)), float(np.exp(girth)), len(frames))


def _with_tools(frame: FrameProblem, tools: PoseTools) -> FrameProblem:
    body, table = tools.body, tools.table
    old = frame.voxels
    return FrameProblem(
        tools=tools,
        voxels=VoxelProblem(body, table, old.volume, old.settings, n_threads=old.n_threads),
        surface=SurfaceProblem(body, table, frame.surface.hull, frame.surface.settings),
        outlines=None
        if frame.outlines is None
        else OutlineProblem(body, table, frame.outlines.outlines, frame.outlines.settings),
    )


def _lowest(
    cost: Callable[[float], float], start: float, step: float, *, furthest: int = _FURTHEST
) -> tuple[float, float]:
    """Where a cost of one variable is lowest, by walking downhill and a parabola through the last three places."""
    known = {k: cost(start + k * step) for k in (-1, 0, 1)}
    best = min(known, key=lambda k: known[k])
    while abs(best) < furthest and best in (min(known), max(known)):
        k = best + (1 if best > 0 else -1)
        known[k] = cost(start + k * step)
        best = min(known, key=lambda k: known[k])
    if best in (min(known), max(known)):
        return start + best * step, known[best]
    a, b, c = known[best - 1], known[best], known[best + 1]
    bend = a - 2 * b + c
    shift = 0.5 * (a - c) / bend if bend > 0 else 0.0
    return start + (best + shift) * step, b
