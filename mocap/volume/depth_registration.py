"""Where a depth camera stands, by what it and other depth cameras measure of a room that stands still.

The floor that the camera measures tells how high it hangs and how it is tilted; where on the floor, and which way it
looks, is searched for all over the room. The best places are brought onto the surfaces of the others (iterated closest
points, point to plane; Open3D gives planes and normals). What others measure judges each: points must lie on their
surfaces or behind them, never before them. A place that the surfaces in common leave open, as a bare floor does, is
not given.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from mocap.arrays import Array, Mask
from mocap.data import Camera
from mocap.data.depth import DepthNoise
from mocap.volume._open3d import require_open3d
from mocap.volume.measured_room import RoomView, cloud_of

# Points this far apart are looked at, and normals are those of a patch of this radius.
_STEP_M, _PATCH_M = 0.04, 0.12
# How far points may look for their surface, step by step: a place of the search is off by half its steps. A surface
# that faces another way counts as this much further off: the far side of a thing is not its near side.
_REACHES_M, _N_ROUNDS, _FACING_M = (0.4, 0.2, 0.1, 0.05), 15, 0.3
_FACES_COS = 0.7
_FLOOR_M = 0.05  # readings this near a plane are of it
_STANDS_M = 0.15  # what stands on the floor reaches higher: a floor fits a floor anywhere
_UPRIGHT_COS = 0.26  # a camera's up and the world's are at most 75 degrees apart
_N_PLANES, _FEW_POINTS = 4, 100
# The search: steps over the floor, and of the direction; points that are compared, with how much tolerance.
_SEARCH_M, _SEARCH_DEG, _N_COMPARED, _SEARCH_MARGIN_M = 0.3, 8.0, 60, 0.15
_AROUND_M = 1.0  # beyond the cameras and what they measure
_N_STARTS = 15
_MARGIN_M, _MARGIN_STDS = 0.03, 3.0  # how far from a surface is on it
_AGAINST = (
    5.0  # a point before a surface speaks against a place so many times as loud as one on it speaks for it
)


@dataclass(frozen=True, eq=False)
class Registration:
    """camera : where it stands.  residual_m : root mean square distance of its points from the surfaces of the others.

    shared_m2 : of the surfaces above the floor that it and others have both measured.  before : share of what each has
    measured above the floor that lies before what the other has, where nothing can be.  rival : the score of the best
    other place, as a share of this one's.  fixed : how well the surfaces in common hold the camera, of the shift
    over the floor and turn that they hold least; 0 = they leave it open.  shift_m, turn_deg : from where the camera was
    said to be.
    """

    camera: Camera
    residual_m: float
    shared_m2: float
    before: float
    rival: float
    fixed: float
    shift_m: float
    turn_deg: float


@dataclass(frozen=True, eq=False)
class _Patches:
    """points : (N, 3) m.  normals : (N, 3), towards the camera that measured them."""

    points: Array
    normals: Array


@dataclass(frozen=True, eq=False)
class _Judged:
    """n_shared : patches that both have measured.  shared, before : shares."""

    camera: Camera
    n_shared: int
    shared: float
    before: float

    @property
    def score(self) -> float:
        return self.shared - _AGAINST * self.before


def register_depth(view: RoomView, others: Sequence[RoomView], noise: DepthNoise) -> Registration | None:
    """Where the camera of a view stands, by the views of others, whose places are right.

    The camera's own place is only a first guess. None where nothing fits.
    Raises ValueError for no others, MissingExtra without Open3D.
    """
    if not others:
        raise ValueError("others must hold at least one view, got none")
    o3d = require_open3d("registering a depth camera")
    at_origin = replace(view, camera=replace(view.camera, R=np.eye(3), t=np.zeros(3)))
    own = _patches(o3d, at_origin)
    floor = _floor(o3d, own.points)
    if floor is not None:
        own = _with_less_floor(own, *floor)
    each = [_patches(o3d, other) for other in others]
    target = _Patches(
        *(np.concatenate(of) for of in zip(*((p.points, p.normals) for p in each), strict=True))
    )
    tree = _tree(target)
    found = []
    for start in (view.camera, *_searched(view.camera, own, floor, target, others, noise)):
        camera = _onto(start, own, target, tree)
        found.append(_judge(replace(view, camera=camera), own, target, others, noise))
    found.sort(key=lambda f: -f.score)
    best = found[0]
    if best.score <= 0:
        return None
    rivals = [f.score for f in found[1:] if _is_elsewhere(f.camera, best.camera)]
    residual_m, fixed = _fit(best.camera, own, target, tree)
    shift_m, turn_deg = _apart(best.camera, view.camera)
    rival = max(0.0, *rivals, 0.0) / best.score
    shared_m2 = best.n_shared * _STEP_M**2
    return Registration(best.camera, residual_m, shared_m2, best.before, rival, fixed, shift_m, turn_deg)


def _patches(o3d: Any, view: RoomView) -> _Patches:
    """The surfaces of a view, thinned out."""
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(cloud_of(view).points))
    cloud = cloud.voxel_down_sample(_STEP_M)
    cloud.estimate_normals(o3d.geometry.KDTreeSearchParamHybrid(radius=_PATCH_M, max_nn=40))
    cloud.orient_normals_towards_camera_location(view.camera.center)
    return _Patches(np.asarray(cloud.points).reshape(-1, 3), np.asarray(cloud.normals).reshape(-1, 3))


def _in_world(camera: Camera, own: _Patches) -> _Patches:
    return _Patches((own.points - camera.t) @ camera.R, own.normals @ camera.R)


def _with_less_floor(own: _Patches, up: Array, height_m: float) -> _Patches:
    """As much floor as stands on it, spread evenly: more says nothing, and takes time."""
    is_floor = own.points @ up + height_m <= _STANDS_M
    n = max(_FEW_POINTS, int(np.count_nonzero(~is_floor)))
    keep = np.sort(np.concatenate([np.flatnonzero(~is_floor), _some(np.flatnonzero(is_floor), n)]))
    return _Patches(own.points[keep], own.normals[keep])


def _some(rows: NDArray[Any], n: int) -> NDArray[Any]:
    """At most n of some rows, spread evenly."""
    return rows if len(rows) <= n else rows[np.linspace(0, len(rows) - 1, n).astype(np.int64)]


def _searched(
    camera: Camera,
    own: _Patches,
    floor: tuple[Array, float] | None,
    target: _Patches,
    others: Sequence[RoomView],
    noise: DepthNoise,
) -> list[Camera]:
    """The best places of the search, none where the camera sees no floor, or nothing on it."""
    if floor is None:
        return []
    up, height_m = floor
    level = _turned_up(up)
    standing = own.points[own.points @ up + height_m > _STANDS_M] @ level.T
    if not len(standing):
        return []
    some = _some(standing, _N_COMPARED)
    near = np.concatenate([target.points, [other.camera.center for other in others]])[:, :2]
    sides = zip(near.min(axis=0) - _AROUND_M, near.max(axis=0) + _AROUND_M, strict=True)
    places = np.stack(np.meshgrid(*(np.arange(*side, _SEARCH_M) for side in sides), [height_m]), -1).reshape(
        -1, 3
    )
    cameras, scores = [], []
    for yaw in np.arange(0.0, 360.0, _SEARCH_DEG):
        turn = Rotation.from_euler("z", yaw, degrees=True).as_matrix()
        is_on, is_before = _compared(some @ turn.T + places[:, None], others, noise, _SEARCH_MARGIN_M)
        scores.append(is_on.mean(axis=1) - _AGAINST * is_before.mean(axis=1))
        R = (turn @ level).T
        cameras += [(R, place) for place in places]
    chosen: list[Camera] = []
    for i in np.argsort(-np.concatenate(scores), kind="stable"):
        R, place = cameras[i]
        candidate = replace(camera, R=R, t=-R @ place)
        if all(_is_elsewhere(candidate, c, 2 * _SEARCH_M, 2 * _SEARCH_DEG) for c in chosen):
            chosen.append(candidate)
        if len(chosen) == _N_STARTS:
            break
    return chosen


def _floor(o3d: Any, points: Array) -> tuple[Array, float] | None:
    """Up (3,) in the camera's frame, and how high it hangs, by the largest plane that lies under it; None for none."""
    o3d.utility.random.seed(0)
    left = points
    for _ in range(_N_PLANES):
        if len(left) < _FEW_POINTS:
            return None
        cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(left))
        plane, rows = cloud.segment_plane(_FLOOR_M, 3, 500)
        up, height_m = np.array(plane[:3]), float(plane[3])
        if height_m < 0:
            up, height_m = -up, -height_m
        if -up[1] > _UPRIGHT_COS:  # the camera's y points down its picture
            return up, height_m
        left = np.delete(left, rows, axis=0)
    return None


def _turned_up(up: Array) -> Array:
    """The rotation (3, 3) that turns a direction of the camera's frame to the world's z."""
    x = np.cross(up, [0.0, 0.0, 1.0])
    x = np.array([1.0, 0.0, 0.0]) if np.linalg.norm(x) < 1e-6 else x / np.linalg.norm(x)
    return np.array([x, np.cross(up, x), up])


def _compared(
    points: Array, others: Sequence[RoomView], noise: DepthNoise, margin_m: float
) -> tuple[Mask, Mask]:
    """Which points (..., P, 3) m, world, lie on what a view has measured, and which before all of it, (..., P)."""
    is_on, is_before = (
        np.zeros(points.shape[:-1], dtype=np.bool_),
        np.zeros(points.shape[:-1], dtype=np.bool_),
    )
    for other in others:
        uv, depth = other.camera.project(points)
        inside = other.camera.contains(uv)
        u, v = np.rint(uv[inside]).astype(np.int64).T
        read = other.depth_m[v, u].astype(np.float64)
        gap, margin = read - depth[inside], margin_m + _MARGIN_STDS * noise.std_m(read)
        is_on[inside] |= (read > 0) & (np.abs(gap) < margin)
        is_before[inside] |= (read > 0) & (gap >= margin)
    return is_on, is_before & ~is_on


def _judge(
    view: RoomView, own: _Patches, target: _Patches, others: Sequence[RoomView], noise: DepthNoise
) -> _Judged:
    """How what stands in the room by a view agrees with what others have measured, and theirs with it."""
    points = _in_world(view.camera, own).points
    pairs = [(points, others), (target.points, [view])]
    both = [_compared(p[p[:, 2] > _STANDS_M], by, noise, _MARGIN_M) for p, by in pairs]
    is_on, is_before = (np.concatenate(of) for of in zip(*both, strict=True))
    n, n_shared = max(len(is_on), 1), min(int(on.sum()) for on, _ in both)
    return _Judged(view.camera, n_shared, float(is_on.sum()) / n, float(is_before.sum()) / n)


def _tree(target: _Patches) -> cKDTree:
    """Patches by place and direction."""
    return cKDTree(np.hstack([target.points, _FACING_M * target.normals]))


def _onto(camera: Camera, own: _Patches, target: _Patches, tree: cKDTree) -> Camera:
    """The camera moved so that its patches, in its frame, come to lie on the target: iterated closest points, point to
    plane, with Tukey's weights."""
    for reach in _REACHES_M:
        for _ in range(_N_ROUNDS):
            at, off, J = _pairs(camera, own, target, tree, reach)
            if len(at) < _FEW_POINTS:
                return camera
            weight = np.square(1.0 - np.square(off / reach))
            A = J.T @ (weight[:, None] * J)
            # What the surfaces leave open stays as it is.
            step = -np.linalg.solve(A + 1e-6 * np.trace(A) * np.eye(6), J.T @ (weight * off))
            turn = Rotation.from_rotvec(step[:3]).as_matrix()
            R = camera.R @ turn.T
            center = turn @ camera.center + step[3:]
            camera = replace(camera, R=R, t=-R @ center)
            if np.abs(step).max() < 1e-5:
                break
    return camera


def _pairs(
    camera: Camera, own: _Patches, target: _Patches, tree: cKDTree, reach_m: float
) -> tuple[Array, Array, Array]:
    """Points (n, 3) m that have a surface within reach, how far off they are, (n,) m, and how that changes with a
    small turn about the origin and a shift, (n, 6)."""
    now = _in_world(camera, own)
    limit = float(np.hypot(reach_m, _FACING_M))
    distance, row = tree.query(np.hstack([now.points, _FACING_M * now.normals]), distance_upper_bound=limit)
    near = np.flatnonzero(np.isfinite(distance))
    at, normal = now.points[near], target.normals[row[near]]
    gap = at - target.points[row[near]]
    fits = (np.linalg.norm(gap, axis=1) < reach_m) & (np.sum(normal * now.normals[near], axis=1) > _FACES_COS)
    at, normal, off = at[fits], normal[fits], np.sum(gap * normal, axis=1)[fits]
    return at, off, np.hstack([np.cross(at, normal), normal])


def _fit(camera: Camera, own: _Patches, target: _Patches, tree: cKDTree) -> tuple[float, float]:
    """Root mean square distance from the surfaces, m, and how well they hold the camera.

    The floor holds its height and tilt. What stands on it must hold the rest: smallest eigenvalue of the mean normal
    equations of a shift over the floor and a turn about the middle of the pairs, in units of their mean radius.
    """
    at, off, J = _pairs(camera, own, target, tree, _REACHES_M[-1])
    stands = at[:, 2] > _STANDS_M
    if min(np.count_nonzero(stands), np.count_nonzero(~stands)) < _FEW_POINTS:
        return float(np.sqrt((off**2).mean())) if len(off) else float("inf"), 0.0
    normal, arm = J[stands, 3:], at[stands] - at[stands].mean(axis=0)
    radius = float(np.sqrt((arm[:, :2] ** 2).sum(axis=1).mean()))
    flat = np.column_stack([np.cross(arm, normal)[:, 2] / radius, normal[:, :2]])
    return float(np.sqrt((off**2).mean())), float(np.linalg.eigvalsh(flat.T @ flat / len(flat))[0])


def _apart(a: Camera, b: Camera) -> tuple[float, float]:
    """Distance of two places, m, and the angle between two directions of a camera, degrees."""
    turn = Rotation.from_matrix(np.asarray(a.R @ b.R.T)).magnitude()
    return float(np.linalg.norm(a.center - b.center)), float(np.degrees(turn))


def _is_elsewhere(a: Camera, b: Camera, apart_m: float = 0.15, apart_deg: float = 5.0) -> bool:
    shift_m, turn_deg = _apart(a, b)
    return shift_m > apart_m or turn_deg > apart_deg
