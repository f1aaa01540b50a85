"""Size of a person who may never stand upright: that at which refined poses explain the volumes best."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mocap.pose.volume import VolumeEvidence

Array = NDArray[np.float64]


@dataclass(frozen=True)
class SizeFit:
    """factor : of all lengths.  girth : of the radii.  n_frames : that were fitted."""

    factor: float
    girth: float
    n_frames: int


def fit_size(
    frames: Sequence[VolumeEvidence], states: Sequence[Array], *, is_head_seen: bool = True
) -> SizeFit:
    """How much larger a person is than the body of these frames, each with a pose (D,) of that body.

    is_head_seen : the body's height is the highest place of the head, not just a usual height.

    Poses are refined at every size tried. Girth is fitted too, so that a slim person is not taken for a short one, but
    it is not to be kept: clothes and masks that are a little too wide count as girth (decision 19). The floor should
    have no say: whoever stands straight on shadows that lengthen his outlines would be taken for a short one.
    Raises ValueError without frames.
    """
    if not frames:
        raise ValueError("frames is empty: no size can be fitted")

    numbers = frames[0].tools.settings.method.size
    below, above = numbers.below_std, numbers.above_std
    if not is_head_seen:
        below = above = numbers.unseen_std

    def cost(log_factor: float, log_girth: float) -> float:
        tools = frames[0].tools.resized(float(np.exp(log_factor)), float(np.exp(log_girth)))
        misfits = []
        for frame, state in zip(frames, states, strict=True):
            other = frame.with_tools(tools)
            refined = other.refined(state, numbers.n_refinements)
            misfits.append(float(other.misfit([refined])[0]))
        prior = (log_factor / (below if log_factor < 0 else above)) ** 2
        girth_prior = (log_girth / numbers.girth_std) ** 2
        return numbers.frames_worth * float(np.mean(misfits)) + 0.5 * (prior + girth_prior)

    step, furthest = numbers.step, numbers.furthest_steps
    size, _ = _lowest(lambda s: cost(s, 0.0), 0.0, step, furthest=furthest)
    girth, _ = _lowest(lambda g: cost(size, g), 0.0, numbers.girth_step, furthest=1)
    size, _ = _lowest(lambda s: cost(s, girth), size, step, furthest=furthest)
    return SizeFit(float(np.exp(size)), float(np.exp(girth)), len(frames))


def _lowest(
    cost: Callable[[float], float], start: float, step: float, *, furthest: int
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
