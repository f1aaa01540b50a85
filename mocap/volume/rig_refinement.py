"""Places of cameras put right by the people in a recording, told from tangents of their silhouettes.

The planes through the centres of two cameras are a pencil, and the two outermost ones that touch the people touch them
at one place each (a frontier point), which both cameras see on the outline of their silhouettes. So the two lines of
sight through these places meet. All cameras are turned and shifted together until all pairs of such lines of sight do,
at all times; no correspondence, volume or body is needed. What the whole rig may do unnoticed (shift, turn, scale) is
settled by where the cameras were said to stand.
After Sinha and Pollefeys, "Synchronization and calibration of camera networks from silhouettes" (ICPR 2004), and
Furukawa, Sethi, Ponce and Kriegman, "Robust structure and motion from outlines of smooth curved surfaces" (2006).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from mocap.data import Camera, CameraRig
from mocap.volume.synchrony import focus_of, is_inside, spanned_planes

Array = NDArray[np.float64]

_BLOCK = 6  # numbers of a camera: shift m, turn rad, both in the world
_DONE = 1e-5  # m, rad: a step that moves no camera by more is the last
_SCALE_HELD = 1e8  # information on the size of the rig, which its places alone decide
_WIDEST_RAD = 1.2  # people who stand so near to the line between two cameras have no tangents of use
_NEAREST_M = 0.3  # of a camera nobody stands
_TOP_SHARE = 0.95  # frames in which somebody stands less tall: knees bend in the middle of every step
# Of his height, that the tallest moments of a walker have: `walks_at` of `python -m eval.place_rig`.
_WALKING = 0.99
_TOP_POINTS = 4  # of a frame that agree on where its highest place is
_LEAST_FRAMES = 20


@dataclass(frozen=True)
class RefinementSettings:
    """Numbers of the refinement; chosen on the development sessions of `python -m eval.refine_rig`.

    turn_deg, shift_m : standard deviations per axis of what the calibration may be wrong by.  bias_m : standard
    deviation of what masks shift the tangents of one pair of cameras by, all the time: shadows, frayed outlines.
    alike : frames of which tangents are off alike, so that they count as one.  finest_m : nothing is known better of a
    tangent.  least_sine : of the angle between two lines of sight; more parallel ones are not compared.
    n_steps : at most.
    """

    turn_deg: float = 2.0
    shift_m: float = 0.03
    bias_m: float = 0.005
    alike: float = 10.0
    finest_m: float = 0.0015
    least_sine: float = 0.2
    n_steps: int = 40


@dataclass(frozen=True)
class CameraMove:
    """What became of one camera.

    turn_deg, shift_m : by which it was moved.  turn_std_deg, shift_std_m : standard deviations of what is left, root
    mean square over the axes, against the other cameras.  share_left : of the deviation that was assumed before.
    apart_before_m, apart_after_m : median distance between its lines of sight and those of others.
    n_tangents : that were compared.
    """

    turn_deg: float
    shift_m: float
    turn_std_deg: float
    shift_std_m: float
    share_left: float
    apart_before_m: float
    apart_after_m: float
    n_tangents: int


@dataclass(frozen=True, eq=False)
class Refinement:
    """rig : the cameras in their new places.  moves : of those that might move, by name.  apart_before_m,
    apart_after_m : median distance between lines of sight of all their pairs, NaN when none could be compared.
    points : (N, 3) m, world, where lines of sight meet afterwards, and frames : (N,) of them."""

    rig: CameraRig
    moves: Mapping[str, CameraMove]
    apart_before_m: float
    apart_after_m: float
    points: Array
    frames: NDArray[np.int64]


class _Pair(NamedTuple):
    """Lines of sight of cameras i and j along the planes on one side that touch the people.

    frames : (n,).  apart : (n,) m from the first to the second.  across : (n, 3) unit, in that direction.
    arm_i, arm_j : (n, 3) m from each camera to where its line is nearest to the other.
    """

    i: int
    j: int
    frames: NDArray[np.int64]
    apart: Array
    across: Array
    arm_i: Array
    arm_j: Array


class Outlines(NamedTuple):
    """Convex hulls of one camera's silhouettes, padded.

    rays : (T, P, 3) unit, camera frame, NaN beyond a hull's corners.  is_inside : (T, P) not cut off by the picture.
    """

    rays: Array
    is_inside: NDArray[np.bool_]


def refine_rig(
    rig: CameraRig,
    hulls: Sequence[Sequence[Array]],
    settings: RefinementSettings | None = None,
    moving: Sequence[str] | None = None,
) -> Refinement:
    """Cameras turned and shifted so that the tangents of all silhouettes meet; lenses are kept.

    hulls : per camera and frame the corners (P, 2) px of the convex hull of the silhouettes (`silhouette_hull`), empty
    where there is none; frames belong together.  moving : cameras that may move, None = all; the others are held where
    they are, and only lines of sight of those that may move are compared.
    Raises ValueError for fewer than two cameras, or another number of them or of frames.
    Source: Sinha and Pollefeys 2004; robust least squares over all cameras with a prior.
    """
    counts = {len(own) for own in hulls}
    if len(rig) < 2 or len(hulls) != len(rig) or len(counts) != 1:
        raise ValueError(
            f"refine_rig: hulls of {len(hulls)} cameras and {sorted(counts)} frames for {len(rig)} cameras, expected "
            "two cameras or more with as many frames each"
        )
    s = settings or RefinementSettings()
    seen = [outlines_of(camera, own) for camera, own in zip(rig, hulls, strict=True)]
    free = np.array([moving is None or name in moving for name in rig.names])
    prior = np.tile([s.shift_m**-2] * 3 + [np.radians(s.turn_deg) ** -2] * 3, len(rig))
    given = before = _pairs(rig, seen, s, free)
    found, moved, information = rig, np.zeros((len(rig), _BLOCK)), np.diag(prior)
    for _ in range(s.n_steps):
        gradient, told = _normal_equations(before, len(rig), s)
        information = told + np.diag(prior)
        step = _step(information, gradient - prior * moved.ravel(), found, free)
        found = CameraRig(tuple(_moved(camera, by) for camera, by in zip(found, step, strict=True)))
        moved = moved + step
        before = _pairs(found, seen, s, free)
        if np.abs(step).max() < _DONE:
            break
    left, assumed = (_covariance(told, prior, found, free) for told in (information, np.diag(prior)))
    return _told(rig, found, (given, before), left, assumed, free)


class Meeting(NamedTuple):
    """Lines of sight of a rig as it is.

    apart_m : (N,) distance between two that should meet.  cameras : (N, 2) places in the rig.  points : (N, 3) m where
    they are nearest.  frames : (N,).
    """

    apart_m: Array
    cameras: NDArray[np.int64]
    points: Array
    frames: NDArray[np.int64]


def meetings(rig: CameraRig, hulls: Sequence[Sequence[Array]]) -> Meeting:
    """Where lines of sight along the tangents of all pairs of cameras meet, and by how much they do not.

    hulls : as of `refine_rig`.
    """
    seen = [outlines_of(camera, own) for camera, own in zip(rig, hulls, strict=True)]
    pairs = _pairs(rig, seen, RefinementSettings(), np.ones(len(rig), dtype=np.bool_))
    if not pairs:
        return Meeting(np.zeros(0), np.zeros((0, 2), np.int64), np.zeros((0, 3)), np.zeros(0, np.int64))
    return Meeting(
        np.abs(np.concatenate([pair.apart for pair in pairs])),
        np.concatenate([np.tile([pair.i, pair.j], (len(pair.frames), 1)) for pair in pairs]),
        _meeting_points(rig, pairs),
        np.concatenate([pair.frames for pair in pairs]),
    )


def standing_height_m(points: Array, frames: NDArray[np.int64]) -> float:
    """Of the tallest person who walks, m above the floor as he would stand; NaN when it cannot be told.

    points, frames : as of `walking_height_m`.
    """
    return walking_height_m(points, frames) / _WALKING


def walking_height_m(points: Array, frames: NDArray[np.int64]) -> float:
    """What the tallest person who walks reaches in the tallest moments of his steps, m above the floor; NaN when it
    cannot be told.

    points : (N, 3) m, world, where lines of sight meet, and frames : (N,) of them.
    """
    tops = []
    for frame in np.unique(frames):
        heights = np.sort(points[frames == frame, 2])
        if len(heights) >= 2 * _TOP_POINTS:
            tops.append(np.median(heights[-_TOP_POINTS:]))
    return float(np.quantile(tops, _TOP_SHARE)) if len(tops) >= _LEAST_FRAMES else float("nan")


def _meeting_points(rig: CameraRig, pairs: Sequence[_Pair]) -> Array:
    meet = [(rig[p.i].center + p.arm_i + rig[p.j].center + p.arm_j) / 2 for p in pairs]
    return np.concatenate(meet) if meet else np.zeros((0, 3))


def scaled(rig: CameraRig, factor: float) -> CameraRig:
    """The rig made larger by a factor, about the place on the floor below its middle."""
    below = np.array([camera.center for camera in rig]).mean(axis=0) * (1, 1, 0)
    return CameraRig(
        tuple(
            replace(camera, t=-camera.R @ (below + factor * (camera.center - below)), filmed_size=None)
            for camera in rig
        )
    )


def outlines_of(camera: Camera, hulls: Sequence[Array]) -> Outlines:
    """Hulls (P, 2) px of one camera, frame by frame, as rays."""
    widest = max((len(hull) for hull in hulls), default=0)
    rays = np.full((len(hulls), max(1, widest), 3), np.nan)
    inside = np.zeros(rays.shape[:2], dtype=np.bool_)
    for t, hull in enumerate(hulls):
        if len(hull):
            rays[t, : len(hull)] = camera.rays(hull) @ camera.R.T
            inside[t, : len(hull)] = is_inside(camera, hull)
    return Outlines(rays, inside)


def _pairs(
    rig: CameraRig, seen: Sequence[Outlines], s: RefinementSettings, free: NDArray[np.bool_]
) -> list[_Pair]:
    """The tangents that two cameras both see, of all pairs with a camera that is free (C,), lower and upper."""
    focus = focus_of(rig)
    rays = [own.rays @ camera.R for camera, own in zip(rig, seen, strict=True)]
    found = []
    for i, j in combinations(range(len(rig)), 2):
        planes = spanned_planes(rig[i].center, rig[j].center, focus) if free[i] or free[j] else None
        if planes is None:
            continue
        places = [_touching(rays[c], seen[c].is_inside, planes.axes) for c in (i, j)]
        for (at_i, sees_i), (at_j, sees_j) in zip(*places, strict=True):
            frames = np.flatnonzero(sees_i & sees_j)
            line_i, line_j = rays[i][frames, at_i[frames]], rays[j][frames, at_j[frames]]
            found.append(_meeting(i, j, frames, line_i, line_j, rig[j].center - rig[i].center, s))
    return [pair for pair in found if len(pair.frames)]


def _touching(
    rays: Array, inside: NDArray[np.bool_], axes: Array
) -> list[tuple[NDArray[np.int64], NDArray[np.bool_]]]:
    """Which ray (T,) of rays (T, P, 3) lies on the lowest and on the highest plane, and whether that counts (T,)."""
    along, across = np.moveaxis(rays @ axes, -1, 0)
    is_there = np.isfinite(along)
    angle = np.arctan2(across, along)
    rows = np.arange(len(rays))
    low = np.where(is_there, angle, np.inf).argmin(axis=1)
    high = np.where(is_there, angle, -np.inf).argmax(axis=1)
    with np.errstate(invalid="ignore"):
        counts = is_there[:, 0] & ~(along <= 0).any(axis=1)
        counts &= angle[rows, high] - angle[rows, low] < _WIDEST_RAD
    return [(at, counts & inside[rows, at]) for at in (low, high)]


def _meeting(
    i: int,
    j: int,
    frames: NDArray[np.int64],
    line_i: Array,
    line_j: Array,
    baseline: Array,
    s: RefinementSettings,
) -> _Pair:
    """Where lines of sight (n, 3) of two cameras are nearest to each other; without those nearly parallel."""
    across = np.cross(line_i, line_j)
    sine = np.linalg.norm(across, axis=1)
    keep = sine > s.least_sine
    frames, line_i, line_j, across = frames[keep], line_i[keep], line_j[keep], across[keep]
    across /= sine[keep, None]
    cosine = np.einsum("nk,nk->n", line_i, line_j)
    depth_i = (line_i @ baseline - cosine * (line_j @ baseline)) / (1 - cosine**2)
    depth_j = (cosine * (line_i @ baseline) - line_j @ baseline) / (1 - cosine**2)
    keep = np.minimum(depth_i, depth_j) > _NEAREST_M
    arms = (line * depth[:, None] for line, depth in ((line_i, depth_i), (line_j, depth_j)))
    return _Pair(i, j, frames[keep], across[keep] @ baseline, across[keep], *(arm[keep] for arm in arms))


def _normal_equations(pairs: Sequence[_Pair], n_cameras: int, s: RefinementSettings) -> tuple[Array, Array]:
    """Gradient (6C,) and information (6C, 6C) of shifts and turns of all cameras.

    What masks shift the tangents of a pair by all the time is an unknown of its own, with standard deviation bias_m,
    and is eliminated: somebody who stands on one spot says little however long he does.
    """
    gradient, information = np.zeros(n_cameras * _BLOCK), np.zeros((n_cameras * _BLOCK,) * 2)
    scale = max(1.4826 * _median_apart(pairs), s.finest_m) if pairs else s.finest_m
    for pair in pairs:
        weight = scale**-2 / s.alike / (1 + (pair.apart / (2 * scale)) ** 2) ** 2
        J = np.hstack(
            [-pair.across, -np.cross(pair.arm_i, pair.across), pair.across, np.cross(pair.arm_j, pair.across)]
        )
        all_along = J.T @ weight
        share = s.bias_m**2 / (1 + s.bias_m**2 * weight.sum())
        at = np.concatenate([c * _BLOCK + np.arange(_BLOCK) for c in (pair.i, pair.j)])
        information[np.ix_(at, at)] += (J * weight[:, None]).T @ J - share * np.outer(all_along, all_along)
        gradient[at] -= J.T @ (weight * pair.apart) - share * all_along * (weight @ pair.apart)
    return gradient, information


def _step(information: Array, gradient: Array, rig: CameraRig, free: NDArray[np.bool_]) -> Array:
    """Shifts and turns (C, 6) towards the minimum; cameras that are not free stay, or else the size of the rig does."""
    step, at = np.zeros(len(information)), np.repeat(free, _BLOCK)
    if free.all():
        larger = _gauge(rig)[:, -1]
        information = information + _SCALE_HELD * np.outer(larger, larger)
    step[at] = np.linalg.solve(information[np.ix_(at, at)], gradient[at])
    return step.reshape(len(rig), _BLOCK)


def _gauge(rig: CameraRig) -> Array:
    """What cameras do when the world is shifted, turned or made larger, (6C, 7); columns of unit length."""
    centers = np.array([camera.center for camera in rig])
    arms = centers - centers.mean(axis=0)
    columns = np.zeros((len(rig), _BLOCK, 7))
    for axis in range(3):
        unit = np.eye(3)[axis]
        columns[:, axis, axis] = 1
        columns[:, :3, 3 + axis] = np.cross(unit, arms)
        columns[:, 3 + axis, 3 + axis] = 1
    columns[:, :3, 6] = arms
    flat = columns.reshape(-1, 7)
    return np.asarray(flat / np.linalg.norm(flat, axis=0))


def _covariance(information: Array, prior: Array, rig: CameraRig, free: NDArray[np.bool_]) -> Array:
    """The covariance (6C, 6C) of the cameras that are free, against those held; where none is, against each other."""
    at = np.ix_(np.repeat(free, _BLOCK), np.repeat(free, _BLOCK))
    covariance = np.zeros_like(information)
    covariance[at] = np.linalg.inv(information[at])
    return _free_of_gauge(covariance, prior, rig) if free.all() else covariance


def _free_of_gauge(covariance: Array, prior: Array, rig: CameraRig) -> Array:
    """The covariance (6C, 6C) of cameras against each other, whatever the whole rig does."""
    gauge = _gauge(rig)
    weighted = gauge.T * prior
    free = np.eye(len(covariance)) - gauge @ np.linalg.solve(weighted @ gauge, weighted)
    return np.asarray(free @ covariance @ free.T)


def _moved(camera: Camera, step: Array) -> Camera:
    """The camera shifted and turned about its centre; step : (6,) of the world."""
    R = camera.R @ Rotation.from_rotvec(step[3:]).as_matrix().T
    return replace(camera, R=R, t=-R @ (camera.center + step[:3]))


def _median_apart(pairs: Sequence[_Pair]) -> float:
    apart = np.concatenate([np.abs(pair.apart) for pair in pairs]) if pairs else np.zeros(0)
    return float(np.median(apart)) if len(apart) else float("nan")


def _told(
    given: CameraRig,
    found: CameraRig,
    pairs: tuple[list[_Pair], list[_Pair]],
    left: Array,
    assumed: Array,
    free: NDArray[np.bool_],
) -> Refinement:
    """The result with what became of every camera that is free (C,)."""
    moves = {}
    for c in np.flatnonzero(free):
        old, new = given[int(c)], found[int(c)]
        own = [[pair for pair in some if c in (pair.i, pair.j)] for some in pairs]
        at = slice(c * _BLOCK, (c + 1) * _BLOCK)
        after, before = np.diag(left)[at], np.diag(assumed)[at]
        moves[old.name] = CameraMove(
            turn_deg=float(np.degrees(Rotation.from_matrix(new.R @ old.R.T).magnitude())),
            shift_m=float(np.linalg.norm(new.center - old.center)),
            turn_std_deg=float(np.degrees(np.sqrt(after[3:].mean()))),
            shift_std_m=float(np.sqrt(after[:3].mean())),
            share_left=float(
                np.sqrt(max(after[:3].sum() / before[:3].sum(), after[3:].sum() / before[3:].sum()))
            ),
            apart_before_m=_median_apart(own[0]),
            apart_after_m=_median_apart(own[1]),
            n_tangents=sum(len(pair.frames) for pair in own[1]),
        )
    return Refinement(
        found,
        moves,
        _median_apart(pairs[0]),
        _median_apart(pairs[1]),
        _meeting_points(found, pairs[1]),
        np.concatenate([p.frames for p in pairs[1]]) if pairs[1] else np.zeros(0, dtype=np.int64),
    )
