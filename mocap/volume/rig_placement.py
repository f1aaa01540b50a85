"""Cameras placed from nothing but a person who walks, whose height is known; their lenses are.

Somebody who walks is a pole of known height on a floor. One camera that sees his crown and his soles nearer and further
away knows which way is up, how high it hangs, and where he walks (Lv, Zhao and Nevatia, "Camera calibration from video
of a walking human", PAMI 2006). Every other camera is then resected from these poles, the poles are put where most
cameras see them, and so on. That is right to some degrees, and the tangents of the silhouettes do the rest
(`mocap.volume.rig_refinement`). Begun from each camera in turn: only what most beginnings lead to is a result.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from mocap.data import CameraRig
from mocap.volume.rig_refinement import (
    Outlines,
    Refinement,
    RefinementSettings,
    outlines_of,
    refine_rig,
    scaled,
)

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]

_AXIS = np.array([0.0, 0.0, 1.0])  # of a camera, in its own frame
_UPS = np.array([[0.0, -1, 0], [1, 0, 0], [-1, 0, 0]])  # upright pictures, and those of a camera on its side
_FEET_SHARE = 0.25  # of a silhouette, from below
_LEAST_DEPTH = 0.1  # cosine of the angle to the axis; beyond it a ray is no point of a picture
_END_POINTS = 4  # of a frame that agree on where the soles are
_N_FITS = 10  # of the robust fit of a level
_RIDGE = 1e-9


@dataclass(frozen=True)
class PlacementSettings:
    """Numbers of the search; chosen on the development sessions of `python -m eval.place_rig`.

    pitches_deg : from, to, step of how far a camera looks down.  widest : silhouette of a walker, width over height.
    crown : share of his height that a walker's crown has in the mean of a step.  stride_m : by which the nearer sole is
    nearer than he is.  far_rad : of a pole's end that is not where it should be.  n_rounds : of cameras from poles and
    poles from cameras.  n_trials : of RANSAC.  least_frames : that a camera sees a walker whole in.  alike_deg : two
    results that differ by less are one.  one_m : crown and soles further apart over the floor are of two people.
    tilt_rad : standard deviation of up as bodies show it, and bob_m : of a crown's level as somebody walks.
    refinement : of the tangents, from where some degrees and decimetres are wrong.
    """

    pitches_deg: tuple[float, float, float] = (-30.0, 60.0, 2.0)
    widest: float = 0.8
    crown: float = 0.99
    stride_m: float = 0.17
    far_rad: float = 0.06
    n_rounds: int = 4
    n_trials: int = 100
    least_frames: int = 15
    alike_deg: float = 1.0
    one_m: float = 0.5
    tilt_rad: float = 0.06
    bob_m: float = 0.02
    refinement: RefinementSettings = field(
        default_factory=lambda: RefinementSettings(turn_deg=6.0, shift_m=0.3, n_steps=80)
    )


@dataclass(frozen=True, eq=False)
class Placement:
    """refinement : the cameras in a world whose floor is z = 0, m, and how well they fit.  n_begun, n_agree : searches,
    each from another camera, and how many of them found this.  walked_m : root mean square distance of the
    person's crown from the middle of his way."""

    refinement: Refinement
    n_begun: int
    n_agree: int
    walked_m: float


class _Ends(NamedTuple):
    """Ends of a pole in one camera.

    crown, sole : (T, 3) unit, camera frame, NaN where he is not seen whole.  lean : (T,) how far the crown stands aside
    of the feet, in heights.
    """

    crown: Array
    sole: Array
    lean: Array


class _View(NamedTuple):
    """What one camera knows by itself: up (3,) in its frame, its height over that of the person, and how steady (the
    smaller the better) that is."""

    up: Array
    raised: float
    spread: float


def place_rig(
    rig: CameraRig,
    hulls: Sequence[Sequence[Array]],
    height_m: float,
    settings: PlacementSettings | None = None,
) -> Placement | None:
    """Where cameras stand and look; None when nothing is found. Only the lenses of `rig` are used.

    hulls : per camera and frame the corners (P, 2) px of the convex hull of the silhouettes (`silhouette_hull`), empty
    where there is none; frames belong together.  height_m : of the person who walks, in shoes.
    The floor is z = 0, the origin lies under the middle of the way, and the first camera behind it (y < 0).
    Raises ValueError for fewer than two cameras, or another number of them or of frames.
    Source: Lv, Zhao and Nevatia 2006 for one camera; Sinha and Pollefeys 2004 for all.
    """
    s = settings or PlacementSettings()
    if len(rig) < 2 or len(hulls) != len(rig) or len({len(own) for own in hulls}) != 1:
        raise ValueError(
            f"place_rig: hulls of {len(hulls)} cameras for {len(rig)}, expected two or more each"
        )
    seen = [outlines_of(camera, own) for camera, own in zip(rig, hulls, strict=True)]
    views = [_view(outlines, s) for outlines in seen]
    found = []
    for base, view in enumerate(views):
        begun = None if view is None else _begun(rig, seen, views, base, s)
        if begun is not None:
            found.append(refine_rig(scaled(begun, height_m), hulls, s.refinement))
    found = [each for each in found if np.isfinite(each.apart_after_m)]
    if not found:
        return None
    best = min(found, key=lambda each: each.apart_after_m)
    agree = sum(_apart_deg(each.rig, best.rig) < s.alike_deg for each in found)
    stood = _stood(best, seen, height_m, s)
    if stood is None:
        return None
    final = refine_rig(stood, hulls, s.refinement)
    way = _crowns(final.rig, seen, s)[:, :2]
    way = way[np.isfinite(way[:, 0])]
    walked = np.sqrt(((way - np.median(way, axis=0)) ** 2).sum(axis=1).mean()) if len(way) else 0.0
    return Placement(final, len(rig), agree, float(walked))


def _ends(seen: Outlines, up: Array, s: PlacementSettings) -> _Ends:
    """The pole in each frame, for a camera in whose frame `up` (3,) is up."""
    ahead = _level(_AXIS, up)
    right = np.cross(ahead, up)
    is_there = np.isfinite(seen.rays[..., 0])
    height = np.where(is_there, np.arcsin(np.clip(np.nan_to_num(seen.rays @ up), -1, 1)), np.nan)
    aside = np.arctan2(seen.rays @ right, seen.rays @ ahead)
    rows = np.arange(len(height))
    low = np.where(is_there, height, np.inf).argmin(axis=1)
    high = np.where(is_there, height, -np.inf).argmax(axis=1)
    tall = height[rows, high] - height[rows, low]
    lowest, highest = (_extreme(aside, is_there, sign) for sign in (-1, 1))
    # Where nobody is seen, infinite less infinite is NaN, and that is what it shall be.
    with np.errstate(invalid="ignore"):
        is_whole = (
            seen.is_inside[rows, low] & seen.is_inside[rows, high] & (highest - lowest < s.widest * tall)
        )
        at_feet = is_there & (height < (height[rows, low] + _FEET_SHARE * tall)[:, None])
        feet = (_extreme(aside, at_feet, -1) + _extreme(aside, at_feet, 1)) / 2
    crown_aside, sole_height = aside[rows, high], height[rows, low]
    level = np.cos(crown_aside)[:, None] * ahead + np.sin(crown_aside)[:, None] * right
    sole = np.cos(sole_height)[:, None] * level + np.sin(sole_height)[:, None] * up
    keep = np.where(is_whole, 1.0, np.nan)
    return _Ends(
        seen.rays[rows, high] * keep[:, None],
        sole * keep[:, None],
        (crown_aside - feet) / np.where(tall > 0, tall, np.nan) * keep,
    )


def _level(direction: Array, up: Array) -> Array:
    """The level direction (3,), unit, that goes with one that need not be."""
    level = direction - (direction @ up) * up
    return np.asarray(level / np.linalg.norm(level))


def _extreme(value: Array, counts: Bools, sign: int) -> Array:
    """Smallest (-1) or largest (1) value (T,) of (T, P) among those that count; infinite where none does."""
    return sign * np.where(counts, sign * value, -np.inf).max(axis=1)


def _view(seen: Outlines, s: PlacementSettings) -> _View | None:
    """Up, and the height of a camera: at them the person is as tall wherever he walks."""
    pitches = np.radians(
        np.arange(s.pitches_deg[0], s.pitches_deg[1] + s.pitches_deg[2] / 2, s.pitches_deg[2])
    )
    tried = []
    for upright in _UPS:
        for pitch in pitches:
            up = np.cos(pitch) * upright - np.sin(pitch) * _AXIS
            for _ in range(2):
                lean = _ends(seen, up, s).lean
                if not np.isfinite(lean).any():
                    break
                up = up + np.nanmedian(lean) * np.cross(_AXIS - up * up[2], up)
                up = up / np.linalg.norm(up)
            raised = _raised(_ends(seen, up, s), up)
            raised = raised[np.isfinite(raised)]
            if len(raised) >= s.least_frames:
                middle = float(np.median(raised))
                tried.append((len(raised), _View(up, middle, float(np.median(np.abs(raised - middle))))))
    most = max((n for n, _ in tried), default=0)
    likely = [view for n, view in tried if n > most / 2]
    return min(likely, key=lambda view: view.spread) if likely else None


def _raised(ends: _Ends, up: Array) -> Array:
    """Height of the camera over that of the person (T,), NaN for soles that would be above it."""
    crown, sole = _slope(ends.crown, up), _slope(ends.sole, up)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.where((sole < 0) & (crown > sole), -sole / (crown - sole), np.nan)


def _slope(rays: Array, up: Array) -> Array:
    """Rise over run (T,) of rays (T, 3)."""
    return np.tan(np.arcsin(np.clip(rays @ up, -1, 1)))


def _reach(ends: _Ends, up: Array, s: PlacementSettings) -> Array:
    """Distance over the floor (T,) of the person, heights."""
    return s.crown / (_slope(ends.crown, up) - _slope(ends.sole, up)) + s.stride_m / 2


def _begun(
    rig: CameraRig, seen: Sequence[Outlines], views: Sequence[_View | None], base: int, s: PlacementSettings
) -> CameraRig | None:
    """All cameras, in heights of the person, from where one of them sees him walk; None when one finds no place."""
    first = views[base]
    assert first is not None
    ups = [first.up if view is None else view.up for view in views]
    ends = _ends(seen[base], first.up, s)
    ahead = _level(_AXIS, first.up)
    turned = np.stack([np.cross(ahead, first.up), ahead, first.up], axis=1)
    poles = _on_floor(ends, first.up, turned, np.array([0.0, 0.0, first.raised]), s)
    placed = rig
    for _ in range(s.n_rounds):
        cameras, told = [], []
        for camera, outlines, up in zip(rig, seen, ups, strict=True):
            ends = _ends(outlines, up, s)
            pose = _resected(ends, poles, s)
            if pose is None:
                return None
            R, center = pose
            cameras.append(replace(camera, R=R, t=-R @ center, filmed_size=None))
            told.append(_on_floor(_ends(outlines, R[:, 2], s), R[:, 2], R, center, s))
        placed = CameraRig(tuple(cameras))
        ups = [camera.R[:, 2] for camera in placed]
        poles = _median(np.array(told))
    return placed


def _median(told: Array) -> Array:
    """Over the first axis of (C, T, 2), NaN where nobody tells."""
    known = np.isfinite(told).any(axis=(0, 2))
    out = np.full(told.shape[1:], np.nan)
    out[known] = np.nanmedian(told[:, known], axis=0)
    return out


def _on_floor(ends: _Ends, up: Array, R: Array, center: Array, s: PlacementSettings) -> Array:
    """Where the person stands (T, 2), as one camera tells it; R (3, 3) world to camera, center (3,), in heights."""
    towards = (ends.crown @ R)[:, :2]
    towards = towards / np.linalg.norm(towards, axis=1, keepdims=True)
    return np.asarray(center[:2] + _reach(ends, up, s)[:, None] * towards)


def _resected(ends: _Ends, poles: Array, s: PlacementSettings) -> tuple[Array, Array] | None:
    """R (3, 3) world to camera and centre (3,) of a camera that sees poles (T, 2), in heights."""
    depth = np.minimum(ends.crown[:, 2], ends.sole[:, 2])
    with np.errstate(invalid="ignore"):
        known = np.flatnonzero((depth > _LEAST_DEPTH) & np.isfinite(poles[:, 0]))
    if len(known) < s.least_frames:
        return None
    at = poles[known]
    world = np.concatenate([np.column_stack([at, np.full(len(at), z)]) for z in (s.crown, 0.0)])
    rays = np.concatenate([ends.crown[known], ends.sole[known]])
    cv2.setRNGSeed(0)
    found, turn, shift, _ = cv2.solvePnPRansac(
        world,
        np.ascontiguousarray(rays[:, :2] / rays[:, 2:]),
        np.eye(3),
        None,
        iterationsCount=s.n_trials,
        reprojectionError=s.far_rad,
        flags=cv2.SOLVEPNP_SQPNP,
    )
    if not found:
        return None
    R = Rotation.from_rotvec(turn.ravel()).as_matrix()
    return R, -R.T @ shift.ravel()


def _apart_deg(one: CameraRig, other: CameraRig) -> float:
    """Largest angle by which a camera looks elsewhere in two rigs, seen from the first camera."""
    turns = [a.R @ one[0].R.T @ (b.R @ other[0].R.T).T for a, b in zip(one, other, strict=True)]
    return float(np.degrees(Rotation.from_matrix(np.array(turns)).magnitude().max()))


def _stood(
    found: Refinement, seen: Sequence[Outlines], height_m: float, s: PlacementSettings
) -> CameraRig | None:
    """The rig in a world whose floor the soles touch and in which the person is as tall as he is."""
    crowns = _crowns(found.rig, seen, s)
    if np.isfinite(crowns[:, 0]).sum() < s.least_frames:
        return None
    up = _up(crowns, found, s)
    floor = _floor(found.rig, seen, crowns, up, s)
    tall = float(np.nanmedian(crowns @ up)) - floor
    if not tall > 0:  # nor NaN, where no sole is seen
        return None
    middle = np.nanmedian(crowns, axis=0)
    origin = middle + up * (floor - middle @ up)
    ahead = _level(origin - found.rig[0].center, up)
    turn = np.stack([np.cross(ahead, up), ahead, up])
    cameras = []
    for camera in found.rig:
        R, center = camera.R @ turn.T, turn @ (camera.center - origin)
        cameras.append(replace(camera, R=R, t=-R @ (s.crown * height_m / tall * center)))
    return CameraRig(tuple(cameras))


def _crowns(rig: CameraRig, seen: Sequence[Outlines], s: PlacementSettings) -> Array:
    """Where lines of sight at the crown are nearest to each other (T, 3), NaN where fewer than two cameras see it."""
    rays = np.array([_ends(own, c.R[:, 2], s).crown @ c.R for c, own in zip(rig, seen, strict=True)])
    is_seen = np.isfinite(rays[..., 0])
    across = np.eye(3) - rays[..., :, None] * rays[..., None, :]
    across = np.where(is_seen[..., None, None], across, 0.0)
    centers = np.array([camera.center for camera in rig])
    out = np.full((rays.shape[1], 3), np.nan)
    enough = is_seen.sum(axis=0) >= 2
    H = across.sum(axis=0)[enough] + _RIDGE * np.eye(3)
    out[enough] = np.linalg.solve(H, np.einsum("ctij,cj->ti", across, centers)[enough][..., None])[..., 0]
    return out


def _up(crowns: Array, found: Refinement, s: PlacementSettings) -> Array:
    """Up (3,), unit.

    People are upright in the mean, and their crowns stay on one level as they walk, to 2 cm; soles do not, half of them
    are in the air. So crowns say which way is up along the way, and bodies beside it.
    """
    known = np.flatnonzero(np.isfinite(crowns[:, 0]))
    at = crowns[known]
    bodies = []
    for frame, crown in zip(known, at, strict=True):
        own = found.points[found.frames == frame]
        own = own[np.linalg.norm((own - crown)[:, :2], axis=1) < s.one_m]
        if len(own) >= _END_POINTS:
            bodies.append(crown - np.median(own[np.argsort(own[:, 2])[:_END_POINTS]], axis=0))
    body = np.median(bodies, axis=0) if bodies else _AXIS
    body = body if body[2] > 0 else _AXIS  # bodies that hang down are none
    upright = np.array([-body[0] / body[2], -body[1] / body[2], 0.0])
    A = np.column_stack([at[:, :2] - np.median(at[:, :2], axis=0), np.ones(len(at))])
    prior = np.diag([s.tilt_rad**-2, s.tilt_rad**-2, _RIDGE])
    plane, weight = upright, np.ones(len(at))
    for _ in range(_N_FITS):
        told = (A * weight[:, None]).T / (s.refinement.alike * s.bob_m**2)
        plane = np.linalg.solve(told @ A + prior, told @ at[:, 2] + prior @ upright)
        weight = 1 / (1 + ((at[:, 2] - A @ plane) / (2 * s.bob_m)) ** 2)
    up = np.array([-plane[0], -plane[1], 1.0])
    return np.asarray(up / np.linalg.norm(up))


def _floor(rig: CameraRig, seen: Sequence[Outlines], crowns: Array, up: Array, s: PlacementSettings) -> float:
    """Height of the floor along `up` (3,): where each camera sees the nearer sole, below crowns (T, 3)."""
    heights = []
    for camera, own in zip(rig, seen, strict=True):
        at = camera.R @ up
        away = crowns - camera.center
        reach = np.linalg.norm(away - (away @ up)[:, None] * up, axis=1) - s.stride_m / 2
        heights.append(camera.center @ up + reach * _slope(_ends(own, at, s).sole, at))
    known = np.concatenate(heights)
    known = known[np.isfinite(known)]
    return float(np.median(known)) if len(known) else float("nan")
