"""When cameras were started, and how fast their clocks run, told from silhouettes of people who move.

The planes through the centres of two cameras are a pencil about the line between them, and the two outermost planes
that touch the people are the same for both cameras: each sees them as epipolar tangents of its silhouettes. The angles
of these planes are curves over time that both cameras draw, each on its own clock, without a correspondence, a volume
or a body. Clocks are right when the curves of all pairs lie on each other.
After Sinha and Pollefeys, "Synchronization and calibration of camera networks from silhouettes" (ICPR 2004).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

from mocap.data import Camera, CameraRig
from mocap.volume import _kernels, _mask_kernels

Array = NDArray[np.float64]

_EDGE_PX = 3.0  # a silhouette that reaches so near to the border of the picture is cut off there
_LEAST_SHARE = 0.1  # of the area of the largest region; smaller ones are no person
_LEAST_AREA = 2e-4  # of the picture
_SWEEPS = 3  # over all cameras, each against all others
_LEAST_MOMENTS = 10
_FINEST_M = 1e-3  # nothing is known better of a tangent
_DONE_S = 1e-6  # a step that moves clocks by less is the last
_NO_DRIFT, _ANY_DRIFT = 1e-9, 1e-2
_RIDGE = 1e-3  # settles clocks that nothing is said about; the information of one clear curve is 1e4 and more
_WIDEST_RAD = 1.2  # people who stand so near to the line between two cameras have no tangents of use


@dataclass(frozen=True)
class SynchronySettings:
    """Numbers of the search; chosen on the development sessions of `python -m eval.synchrony`.

    step_s : between the lags that are tried first.  max_lag_s : the largest of them.  least_overlap_s : that two clips
    must have at a lag.  far_m : curves that lie further apart count as this far.  smooth_frames : standard deviation of
    the Gaussian that smooths a curve, and slow_s of the one that tells what changes too slowly to count.  alike :
    frames of which tangents are off alike, so that they count as one.  drift : standard deviation of the speed of
    clocks before anything is seen.  most_uncertain_s : clocks that are known worse are not told.  certain : deviations
    that a clock must be off by to count as off, and harmless_s : seconds that it must exceed.  least_motion_m : by
    which curves must vary to tell anything.
    """

    step_s: float = 1 / 60
    max_lag_s: float = 10.0
    least_overlap_s: float = 1.5
    far_m: float = 0.08
    smooth_frames: float = 1.0
    slow_s: float = 0.4
    drift: float = 2e-4
    alike: float = 10.0
    most_uncertain_s: float = 0.03
    certain: float = 4.0
    harmless_s: float = 0.005
    least_motion_m: float = 0.02
    n_steps: int = 30


@dataclass(frozen=True, eq=False)
class Silhouettes:
    """What one camera saw of the people.

    times_s : (n,) of its pictures on its own clock.  hulls : (P, 2) px, corners of the convex hull of the silhouettes,
    empty where there is none.
    """

    times_s: Array
    hulls: Sequence[Array]


@dataclass(frozen=True)
class ClockEstimate:
    """A camera's clock against the reference: a picture of its own time s was taken at offset_s + (1 + drift) s.

    offset_std_s, drift_std : standard deviations.  is_certain : whether the camera's curves say anything at all.
    is_off : whether the clock differs from the reference by more than chance.
    """

    offset_s: float
    drift: float
    offset_std_s: float
    drift_std: float
    is_certain: bool
    is_off: bool

    def on_clock(self, times_s: Array) -> Array:
        """Times (n,) s of the camera's own clock, on that of the reference."""
        return self.offset_s + (1 + self.drift) * times_s


class Curve(NamedTuple):
    """Position of one of the two outermost planes of a pair, as one camera sees it, or a signal that both share.

    camera, other : places in the rig.  side : -1 lower, 1 upper, 0 a signal.  times_s : (n,).  values : (n,) m at the
    distance of the people, or of the signal; NaN = not seen.
    """

    camera: int
    other: int
    side: int
    times_s: Array
    values: Array


@dataclass(frozen=True, eq=False)
class Synchrony:
    """clocks : by name of the camera.  reference : the camera whose clock counts.  pairs : the curves (of i, of j) that
    were compared, on the cameras' own clocks.  residual_m : root mean square distance of the curves afterwards."""

    clocks: Mapping[str, ClockEstimate]
    reference: str
    pairs: Sequence[tuple[Curve, Curve]] = field(repr=False)
    residual_m: float


def silhouette_hull(mask: NDArray[np.bool_]) -> Array:
    """Corners (P, 2) px of the convex hull of the large regions of a mask (H, W); (0, 2) when there is none."""
    bits = np.ascontiguousarray(mask).view(np.uint8)
    u0, u1, v0, v1 = _mask_kernels.rectangle_of(bits)
    h, w = v1 + 1 - v0, u1 + 1 - u0
    seen = bits[v0 : v1 + 1, u0 : u1 + 1]
    runs, ends = np.empty((h * (w // 2 + 1), 4), dtype=np.int32), np.empty((h, 3), dtype=np.int32)
    n = _kernels.ends_of_regions(seen, _LEAST_AREA * mask.size, _LEAST_SHARE, runs, ends)
    if n == 0:
        return np.zeros((0, 2))
    # The ends of rows are enough for the hull.
    at_ends = np.empty((2, n, 2), dtype=np.float32)
    at_ends[:, :, 0] = ends[:n, 1:].T + u0
    at_ends[:, :, 1] = ends[:n, 0] + v0
    corners = cv2.convexHull(at_ends.reshape(-1, 2))
    return np.asarray(corners.reshape(-1, 2), dtype=np.float64)


def focus_of(rig: CameraRig) -> Array:
    """The point (3,) m nearest to all optical axes."""
    A, b = np.zeros((3, 3)), np.zeros(3)
    for camera in rig:
        across = np.eye(3) - np.outer(camera.R[2], camera.R[2])
        A += across
        b += across @ camera.center
    return np.asarray(np.linalg.lstsq(A, b, rcond=None)[0])


class Planes(NamedTuple):
    """The pencil of planes through two cameras: distance m of the people from the line between them, and two axes
    (3, 2) across that line, towards the people and aside."""

    distance: float
    axes: Array


def spanned_planes(center: Array, other: Array, focus: Array) -> Planes | None:
    """The planes through two places (3,) m; None where these are one place, or in line with the people."""
    baseline = other - center
    if np.linalg.norm(baseline) < 1e-6:
        return None
    baseline = baseline / np.linalg.norm(baseline)
    towards = focus - center
    towards = towards - (towards @ baseline) * baseline
    distance = float(np.linalg.norm(towards))
    if distance < 0.1:
        return None
    axes = np.stack([towards / distance, np.cross(baseline, towards / distance)], axis=1)
    return Planes(distance, axes)


def tangent_curves(rig: CameraRig, seen: Sequence[Silhouettes]) -> list[tuple[Curve, Curve]]:
    """Upper and lower curves of all pairs of cameras, (of the one, of the other)."""
    focus = focus_of(rig)
    rays = [[camera.rays(hull) for hull in s.hulls] for camera, s in zip(rig, seen, strict=True)]
    inside = [[is_inside(camera, hull) for hull in s.hulls] for camera, s in zip(rig, seen, strict=True)]
    pairs = []
    for i, j in combinations(range(len(rig)), 2):
        planes = spanned_planes(rig[i].center, rig[j].center, focus)
        if planes is None:
            continue
        distance, axes = planes
        i_both, j_both = (
            np.array([_extremes(r, ok, axes) for r, ok in zip(rays[c], inside[c], strict=True)]).reshape(
                -1, 2
            )
            for c in (i, j)
        )
        for k, side in enumerate((-1, 1)):
            pairs.append(
                (
                    Curve(i, j, side, seen[i].times_s, distance * i_both[:, k]),
                    Curve(j, i, side, seen[j].times_s, distance * j_both[:, k]),
                )
            )
    return pairs


def is_inside(camera: Camera, hull: Array) -> NDArray[np.bool_]:
    """Which corners (P, 2) px of a hull the border of the picture does not cut off."""
    w, h = camera.size
    u, v = hull.T
    return (u > _EDGE_PX) & (u < w - 1 - _EDGE_PX) & (v > _EDGE_PX) & (v < h - 1 - _EDGE_PX)


def _extremes(rays: Array, is_inside: NDArray[np.bool_], axes: Array) -> tuple[float, float]:
    """Smallest and largest angle, rad, of the planes through rays (P, 3); NaN for one that the picture cuts off."""
    if not len(rays):
        return np.nan, np.nan
    along, across = (rays @ axes).T
    if along.min() <= 0:
        return np.nan, np.nan
    angle = np.arctan2(across, along)
    low, high = int(angle.argmin()), int(angle.argmax())
    if angle[high] - angle[low] > _WIDEST_RAD:
        return np.nan, np.nan
    return (
        float(angle[low]) if is_inside[low] else np.nan,
        float(angle[high]) if is_inside[high] else np.nan,
    )


def synchronise(
    rig: CameraRig,
    seen: Sequence[Silhouettes],
    settings: SynchronySettings | None = None,
    *,
    reference: str | None = None,
) -> Synchrony:
    """The clocks of all cameras, from their silhouettes.

    seen : in the order of the rig.  reference : camera whose clock counts; None = the one that most others agree with.
    Raises ValueError for fewer than two cameras or another number of them than the rig has.
    Source: Sinha and Pollefeys 2004, with robust joint refinement of all clocks.
    """
    if len(rig) < 2 or len(seen) != len(rig):
        raise ValueError(
            f"synchronise: {len(seen)} silhouettes for {len(rig)} cameras, expected two or more each"
        )
    s = settings or SynchronySettings()
    curves = tangent_curves(rig, seen)
    pairs = [(_smoothed(a, s.smooth_frames), _smoothed(b, s.smooth_frames)) for a, b in curves]
    pairs = [(a, b) for a, b in pairs if min(_motion(a), _motion(b)) >= s.least_motion_m]
    coarse = _coarse(pairs, len(rig), s)
    return _refined(rig, pairs, coarse, s, reference)


def _motion(curve: Curve) -> float:
    known = curve.values[np.isfinite(curve.values)]
    return float(known.std()) if len(known) >= 10 else 0.0


def _smoothed(curve: Curve, frames: float) -> Curve:
    """A Gaussian over what is known; what is not known stays so."""
    known = np.isfinite(curve.values)
    value = gaussian_filter1d(np.where(known, curve.values, 0.0), frames, mode="constant")
    weight = gaussian_filter1d(known.astype(np.float64), frames, mode="constant")
    # Next to a gap, or to an end, the mean of the neighbours is one-sided: it would lag.
    sure = known & (weight > 0.9 * min(1.0, weight.max()))
    return curve._replace(values=np.where(sure, value / np.maximum(weight, 1e-9), np.nan))


def _coarse(pairs: Sequence[tuple[Curve, Curve]], n_cameras: int, s: SynchronySettings) -> Array:
    """Offsets (C,) s on the grid of lags, NaN for cameras that no pair says anything about."""
    n = round(s.max_lag_s / s.step_s)
    cost: dict[tuple[int, int], Array] = {}
    for a, b in pairs:
        cost[a.camera, b.camera] = cost.get((a.camera, b.camera), 0.0) + _cost_of_lags(a, b, n, s)
    steps = _tree(cost, n_cameras, n)
    for _ in range(_SWEEPS):
        for c in np.flatnonzero(np.isfinite(steps)):
            # What every other camera says of this one, as a function of its offset.
            said = [
                _shifted(curve if j == c else curve[::-1], round(steps[j if i == c else i]))
                for (i, j), curve in cost.items()
                if c in (i, j) and np.isfinite(steps[j if i == c else i])
            ]
            steps[c] = int(np.sum(said, axis=0).argmin()) - n
    return steps * s.step_s


def _tree(cost: Mapping[tuple[int, int], Array], n_cameras: int, n: int) -> Array:
    """Offsets (C,) in steps along the pairs whose lag is clearest; NaN for cameras that none reaches."""
    clear = {pair: float(c.min() / np.median(c)) for pair, c in cost.items()}
    steps = np.full(n_cameras, np.nan)
    if clear:
        steps[min(clear, key=clear.__getitem__)[0]] = 0.0
    while edges := [pair for pair in clear if np.isfinite(steps[list(pair)]).sum() == 1]:
        i, j = min(edges, key=clear.__getitem__)
        lag = int(cost[i, j].argmin()) - n
        if np.isnan(steps[j]):
            steps[j] = steps[i] + lag
        else:
            steps[i] = steps[j] - lag
    return steps


def _shifted(curve: Array, shift: int) -> Array:
    """curve moved by `shift` places to the right; what comes in is as bad as the worst."""
    out = np.full(len(curve), curve.max())
    n = len(curve)
    if abs(shift) < n:
        out[max(0, shift) : min(n, n + shift)] = curve[max(0, -shift) : min(n, n - shift)]
    return out


def _cost_of_lags(a: Curve, b: Curve, n: int, s: SynchronySettings) -> Array:
    """Mean distance (2 n + 1,) of the curves, at most far_m, when b's clock is moved by -n .. n steps against a's."""
    lo = min(a.times_s[0], b.times_s[0]) - n * s.step_s
    hi = max(a.times_s[-1], b.times_s[-1]) + n * s.step_s
    grid = np.arange(lo, hi + s.step_s, s.step_s)
    on_a, on_b = _sampled(a, grid), _sampled(b, grid)
    out = np.full(2 * n + 1, s.far_m)
    least = max(10, round(s.least_overlap_s / s.step_s))
    for k in range(-n, n + 1):
        first, second = (on_a[k:], on_b[: len(on_b) - k]) if k >= 0 else (on_a[:k], on_b[-k:])
        apart = first - second
        apart = apart[np.isfinite(apart)]
        if len(apart) >= least:
            out[k + n] = np.minimum(np.abs(apart - np.median(apart)), s.far_m).mean()
    return out


def _sampled(curve: Curve, times_s: Array) -> Array:
    """The curve at other times (n,) of its clock; NaN where a neighbour is not known."""
    return np.interp(times_s, curve.times_s, curve.values, left=np.nan, right=np.nan)


def _refined(
    rig: CameraRig,
    pairs: Sequence[tuple[Curve, Curve]],
    coarse: Array,
    s: SynchronySettings,
    wanted: str | None,
) -> Synchrony:
    """Gauss-Newton over all clocks; they run equally fast unless it is certain that they do not."""
    told = np.isfinite(coarse)
    used = [(a, b) for a, b in pairs if told[a.camera] and told[b.camera]]
    start = np.column_stack([np.where(told, coarse, 0.0), np.zeros(len(rig))])
    clock, spread, residual = _fitted(used, start, np.zeros(len(rig), dtype=np.bool_), s)
    told &= spread[:, 0] < s.most_uncertain_s
    free, deviation, _ = _fitted(used, clock, told, s)
    lasts = np.zeros(len(rig))
    for curve in (curve for pair in used for curve in pair):
        lasts[curve.camera] = max(lasts[curve.camera], curve.times_s[-1])
    drift = free[:, 1] - np.median(free[told, 1]) if told.any() else free[:, 1]
    drifts = told & (np.abs(drift) > s.certain * deviation[:, 1]) & (np.abs(drift) * lasts > s.harmless_s)
    if drifts.any():
        clock, spread, residual = _fitted(used, clock, drifts, replace(s, drift=_ANY_DRIFT))
    reference = _reference(clock[:, 0], told) if wanted is None else rig.names.index(wanted)
    clock = np.where(told[:, None], clock - clock[reference], 0.0)
    clock[~drifts, 1] = 0.0
    is_off = drifts | (told & (np.abs(clock[:, 0]) > np.maximum(s.harmless_s, s.certain * spread[:, 0])))
    clocks = {
        name: ClockEstimate(
            float(clock[c, 0]),
            float(clock[c, 1]),
            float(spread[c, 0]),
            float(spread[c, 1]),
            is_certain=bool(told[c]),
            is_off=bool(is_off[c]),
        )
        for c, name in enumerate(rig.names)
    }
    return Synchrony(clocks, rig.names[reference], used, residual)


def _fitted(
    pairs: Sequence[tuple[Curve, Curve]], clock: Array, may_drift: NDArray[np.bool_], s: SynchronySettings
) -> tuple[Array, Array, float]:
    """Clocks (C, 2) offset and drift, their deviations (C, 2) against the mean of all, and the residual in m."""
    for _ in range(s.n_steps):
        gradient, information, residual = _normal_equations(pairs, clock, s)
        step, spread = _solved(gradient, information, clock, may_drift, s)
        clock = clock + step
        if np.abs(step[:, 0]).max() < _DONE_S:
            break
    return clock, spread, residual


def _reference(offset: Array, told: NDArray[np.bool_]) -> int:
    """The camera that most others agree with: the one nearest to the median."""
    middle = np.median(offset[told]) if told.any() else 0.0
    return int(np.where(told, np.abs(offset - middle), np.inf).argmin()) if told.any() else 0


def _solved(
    gradient: Array, information: Array, clock: Array, may_drift: NDArray[np.bool_], s: SynchronySettings
) -> tuple[Array, Array]:
    """The step (C, 2) of the clocks towards smaller residuals, and deviations (C, 2); only some may change speed."""
    C = len(clock)
    prior = np.zeros((C, 2))
    prior[:, 1] = np.where(may_drift, s.drift, _NO_DRIFT) ** -2
    H = information + np.diag(prior.ravel() + _RIDGE)
    # All clocks may be moved together: the mean step of the offsets is none.
    H[::2, ::2] += max(1.0, float(np.trace(information[::2, ::2]))) / C**2
    covariance = np.linalg.inv(H)
    step = (covariance @ (gradient - (prior * clock).ravel())).reshape(C, 2)
    return step, np.sqrt(np.diagonal(covariance)).reshape(C, 2)


def _normal_equations(
    pairs: Sequence[tuple[Curve, Curve]], clock: Array, s: SynchronySettings
) -> tuple[Array, Array, float]:
    """Gradient (2C,) and information (2C, 2C) of the clocks, and the root mean square residual, m."""
    C = len(clock)
    gradient, information = np.zeros(2 * C), np.zeros((2 * C, 2 * C))
    squares, count = 0.0, 0
    for a, b in pairs:
        apart, J, weight = _residuals(a, b, clock, s)
        if not len(apart):
            continue
        at = np.array([2 * a.camera, 2 * a.camera + 1, 2 * b.camera, 2 * b.camera + 1])
        information[np.ix_(at, at)] += (J * weight[:, None]).T @ J
        gradient[at] -= J.T @ (weight * apart)
        squares += float((apart[weight > 0] ** 2).sum())
        count += int((weight > 0).sum())
    return gradient, information, float(np.sqrt(squares / count)) if count else float("nan")


def _residuals(a: Curve, b: Curve, clock: Array, s: SynchronySettings) -> tuple[Array, Array, Array]:
    """How far two curves are apart (n,) m, its derivative (n, 4) after offset and drift of a and of b, weights (n,).

    Only what changes fast counts: calibration, shadows and frayed masks move a tangent too, but slowly.
    """
    spans = [clock[x.camera, 0] + (1 + clock[x.camera, 1]) * x.times_s[[0, -1]] for x in (a, b)]
    step = float(np.median(np.diff(a.times_s)))
    times = np.arange(max(span[0] for span in spans), min(span[1] for span in spans), step)
    nothing = np.zeros(0), np.zeros((0, 4)), np.zeros(0)
    if len(times) < _LEAST_MOMENTS:
        return nothing
    (value_a, slope_a, own_a), (value_b, slope_b, own_b) = (
        _on_clock(x, clock[x.camera], times, step) for x in (a, b)
    )
    columns = [value_a - value_b, -slope_a, -slope_a * own_a, slope_b, slope_b * own_b]
    table = np.column_stack(columns)
    known = np.asarray(np.isfinite(table).all(axis=1))
    if known.sum() < _LEAST_MOMENTS:
        return nothing
    table = np.where(known[:, None], table, 0.0)
    share = gaussian_filter1d(known.astype(np.float64), s.slow_s / step, mode="constant")
    slow = (
        gaussian_filter1d(table, s.slow_s / step, axis=0, mode="constant") / np.maximum(share, 1e-9)[:, None]
    )
    table = np.where(known[:, None], table - slow, 0.0)
    apart = table[:, 0]
    scale = max(1.4826 * float(np.median(np.abs(apart[known]))), _FINEST_M)
    weight = np.where(known, scale**-2 / s.alike / (1 + (apart / (2 * scale)) ** 2), 0.0)
    return apart, table[:, 1:], weight


def _on_clock(curve: Curve, clock: Array, times: Array, step: float) -> tuple[Array, Array, Array]:
    """Value and slope (per s) of a curve at times of the reference, and the times on the camera's own clock."""
    own = (times - clock[0]) / (1 + clock[1])
    value = _sampled(curve, own)
    slope = (_sampled(curve, own + step) - _sampled(curve, own - step)) / (2 * step)
    return value, slope, own
