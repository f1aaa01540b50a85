"""Size of a person who may never stand upright: that at which refined poses explain the volumes best."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mocap.body.stretch import covered_kinds, segment_kinds
from mocap.pose.volume import VolumeEvidence

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class SizeFit:
    """factor : of all lengths.  n_frames : that were fitted.

    girth : one factor of all radii, no further than a step from the usual ones, with which the size was found.
    radii : (G,) factors of the radii of each kind of segment that are kept; as the lengths where the girth is usual.
    """

    factor: float
    girth: float
    n_frames: int
    radii: Array


def fit_size(
    frames: Sequence[VolumeEvidence],
    states: Sequence[Array],
    *,
    is_head_seen: bool = True,
    is_given: bool = False,
) -> SizeFit:
    """How much larger a person is than the body of these frames, each with a pose (D,) of that body.

    is_head_seen : the body's height is the highest place of the head, not just a usual height.
    is_given : the body's height was stated: girths alone are fitted.

    Poses are refined at every size tried. Girth is fitted too, so that a slim person is not taken for a short one. It
    is kept where it is clearly another than usual, and then each kind of segment has its own (decision 119); a little
    is not, as masks that are a little too wide count as girth (decision 19). The floor should
    have no say: whoever stands straight on shadows that lengthen his outlines would be taken for a short one.
    Raises ValueError without frames.
    """
    if not frames:
        raise ValueError("frames is empty: no size can be fitted")

    fit = _Fit(frames, states, is_head_seen, is_given)
    numbers, is_covered, alike = fit.numbers, fit.is_covered, np.ones(fit.n_kinds)
    length, girth = np.append(1.0, 0.0 * alike), np.append(0.0, alike)

    def usual(x: Array) -> float:
        return float((x[1] / numbers.girth_std) ** 2)

    x = fit.downhill(0.0 * length, length, numbers.step, usual)
    x = fit.downhill(x, girth, numbers.girth_step, usual, furthest=1)
    x = fit.downhill(x, length, numbers.step, usual)
    found = SizeFit(float(np.exp(x[0])), float(np.exp(x[1])), len(frames), np.exp(x[0] * alike))
    if not fit.tells_girths:
        return found

    def covered(x: Array) -> float:
        return float((((x[1:] - x[0])[is_covered].mean()) / numbers.girth_std) ** 2)

    x = fit.downhill(x[0] * (length + girth), np.append(0.0, is_covered), numbers.girth_step, covered)
    common = x[1:] - x[0]
    if np.abs(common).max() < numbers.own_girth:
        return found

    def own(x: Array) -> float:
        return float((((x[1:] - x[0] - common) / numbers.apart_std) ** 2).sum())

    kinds = [np.append(0.0, kind) for kind in np.eye(fit.n_kinds)[fit.kinds]]
    for _ in range(numbers.n_girth_passes):
        x = fit.downhill(x, length + girth, numbers.own_step, own)
        for kind in kinds:
            x = fit.downhill(x, kind, numbers.girth_step, own, furthest=3)
    x = fit.downhill(x, length + girth, numbers.own_step, own)
    return replace(found, factor=float(np.exp(x[0])), radii=np.exp(x[1:]))


class _Fit:
    """What sizes and girths cost: misfits of refined poses, and how unusual they are.

    They are given as x : (1 + G,), logarithms of the factors of lengths and of the radii of each kind of segment.
    kinds : those that carry flesh.  is_covered : (G,), by clothes.  tells_girths : hulls of two cameras are too wide.
    """

    def __init__(
        self, frames: Sequence[VolumeEvidence], states: Sequence[Array], is_head_seen: bool, is_given: bool
    ) -> None:
        self._frames, self._states, self._usual = frames, states, frames[0].tools
        self.numbers = numbers = self._usual.settings.method.size
        self._stds = (numbers.below_std, numbers.above_std) if is_head_seen else (numbers.unseen_std,) * 2
        self._is_given = is_given
        n_cameras = max(frame.n_cameras for frame in frames)
        self.tells_girths = not 0 < n_cameras < numbers.girth_cameras
        body = self._usual.body
        self.is_covered = covered_kinds(body)
        self.n_kinds = len(self.is_covered)
        self.kinds = np.unique(segment_kinds(body)[body.cones.joint])

    def cost(self, x: Array, unusual: Callable[[Array], float]) -> float:
        """unusual : squared deviations of girths, in standard ones."""
        tools = self._usual.resized(float(np.exp(x[0])), np.exp(x[1:]))
        misfits = []
        for frame, state in zip(self._frames, self._states, strict=True):
            other = frame.with_tools(tools)
            refined = other.refined(state, self.numbers.n_refinements)
            misfits.append(float(other.misfit([refined])[0]))
        below, above = self._stds
        prior = (x[0] / (below if x[0] < 0 else above)) ** 2
        return self.numbers.frames_worth * float(np.mean(misfits)) + 0.5 * float(prior + unusual(x))

    def downhill(
        self,
        x: Array,
        direction: Array,
        step: float,
        unusual: Callable[[Array], float],
        *,
        furthest: int | None = None,
    ) -> Array:
        """The lowest place from x along a direction; x where a given size would change.

        furthest : steps; None = as for the size.
        """
        if self._is_given and direction[0]:
            return x
        furthest = self.numbers.furthest_steps if furthest is None else furthest
        by, _ = _lowest(lambda k: self.cost(x + k * direction, unusual), 0.0, step, furthest=furthest)
        return x + by * direction


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
