"""Whether calibrated cameras agree with each other over a whole recording, told from outlines of people.

Every line of sight through the outline of a mask touches the person, so it must touch the hull of all other cameras:
its *clearance*, how deep it goes into that hull, is never negative, and it is about zero where outline and hull touch
the person at one place (frontier points). A camera that is turned or displaced has outlines that pass the hull on one
side and cut deep on the other. Its misfit is the rotation and shift that brings the smallest clearances to one number
all around, found by quantile regression: what others see too much of makes clearances large and has no weight.

A camera is named when without it all others agree, and without any other one they do not; so are two.
After Wong and Cipolla, "Reconstruction of sculpture from its profiles with unknown camera positions" (2004), and
Hernandez, Schmitt and Cipolla, "Silhouette coherence for camera calibration under circular motion" (2007).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from mocap.data import Camera, CameraRig, Occluders
from mocap.volume import _kernels

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_DONE_M = 0.0005  # a correction that moves lines of sight by less is the last
_MIN_CHAIN = 24  # pixels around a region that is large enough to be somebody
_EDGE_PX = 3  # distance from the edge of the picture
_NORMAL_PX = 1.5  # over which the direction of an outline is smoothed
_BLUR_PX = 8  # that it reaches over
_MIN_AGREEING = 3  # cameras; two agree about next to everything
_MANY = 6  # of fewer cameras, outlines that one more is missing for are all that there are
# Movements of a camera that are fitted: in its own axes (x right, y down, z forward) shifts along x, y, z, then
# rotations about them. A shift along z makes its picture larger, and so does a mask that is frayed everywhere.
_SHIFT, _TURN = np.array([0, 1]), np.array([3, 4, 5])


@dataclass(frozen=True, eq=False)
class MaskSample:
    """One frame to look at.

    masks : (H, W) bool of every camera, None of one that is not to be looked at.  places : (M, 3) m, world, corners of
    the space in which the people are.
    """

    frame: int
    masks: Sequence[Mask | None]
    places: Array


@dataclass(frozen=True)
class AgreementSettings:
    """Numbers of the search; chosen on realistic sessions of another make and the development scenes of
    `python -m eval.fault_table`.

    n_points : of an outline, per frame and camera.  step_m : between places on a line of sight.  reach_m : of a line
    before and behind the people.  min_judges : other cameras that must see a place.  quantile : of the clearances that
    counts; smaller sees less of what the others see too much of, and more of frayed masks.  most_inside_m : a line that
    misses the hull by more is no outline of a person.  loss_m : clearances closer than this to the quantile count as on
    it.  far_m : those below it by more count as this far.  ridge : settles what the outlines leave open, in a sum of
    weights of 100 and more per outline point.
    agrees_m, agrees_px : cameras off by less than the larger agree. Healthy rigs are off by 0.7 cm at most with
    pictures of 320 x 240 and more, by 0.9 cm (0.4 px) with 160 x 120; a shift of a camera by 2 cm is 0.9 to 1.6 cm.
    disagrees : a rig in which nobody can be blamed is said to disagree when it is off by this factor more.
    left : cameras are blamed too when the others are off by no more than such a rig, and by this share of before: one
    camera of seven turned by 1 degree leaves 0.75 of 4.8 cm.
    among_furniture : factor on it where something is known to stand, of which edges are not: 0.6 to 1.0 cm are healthy.
    cut_m : there an outline that all others but one see so far beyond is cut, and says nothing of others.
    clearly : without those that are named the largest misfit is smaller than without any others by this factor.
    own : share of a misfit that is at least that of the camera itself, not of those that it judges. Of cameras that
    are turned or shifted it is 1.0, of those from which something hides a leg 0.07 to 0.32 (casts of the scene `sit`).
    most_named : cameras that are named at once.  min_points : fewer say nothing.  n_steps : corrections, each with the
    hull of the one before, to measure a misfit.
    """

    n_points: int = 60
    step_m: float = 0.025
    reach_m: float = 0.3
    min_judges: int = 2
    quantile: float = 0.2
    most_inside_m: float = 0.25
    loss_m: float = 0.002
    far_m: float = 0.08
    ridge: float = 30.0
    agrees_m: float = 0.007
    disagrees: float = 2.0
    left: float = 0.25
    agrees_px: float = 0.45
    among_furniture: float = 2.5
    cut_m: float = 0.02
    clearly: float = 1.5
    own: float = 0.6
    most_named: int = 2
    min_points: int = 100
    n_steps: int = 10


@dataclass(frozen=True)
class Misfit:
    """How far a camera stands from where its calibration says, against all others.

    offset_m : root mean square distance by which its lines of sight miss at the people.  turn_deg, shift_m : the
    rotation, or else the shift across its line of sight, that explains it; one looks much like the other.  turned : the
    camera after that rotation.  shift_px : of its picture (u, v).
    """

    offset_m: float
    turn_deg: float
    shift_m: float
    turned: Camera
    shift_px: tuple[float, float]


@dataclass(frozen=True)
class Agreement:
    """misfits : of the cameras that are named.  offset_m : the largest misfit among the others, NaN when there is too
    little to tell from.  is_decided : False = the others disagree, and it cannot be told who is wrong."""

    misfits: dict[str, Misfit]
    offset_m: float
    is_decided: bool


@dataclass(frozen=True, eq=False)
class _Sight:
    """Lines of sight of one camera through outlines, N of them, with Z places on each.

    rays : (N, 3) unit, world.  normals : (N, 3) outwards, unit, world, across the ray.  depth : (N, Z) m along the ray.
    clearance : (N, Z, C) m inside the mask of every camera, inf where it does not judge.
    """

    rays: Array
    normals: Array
    depth: Array
    clearance: NDArray[np.float32]


def rig_agreement(
    rig: CameraRig,
    samples: Sequence[MaskSample],
    occluders: Occluders | None = None,
    settings: AgreementSettings | None = None,
    each: Callable[..., Iterable[Any]] = map,
) -> Agreement:
    """Which cameras stand elsewhere than their calibration says, if any.

    samples : few frames will do, far apart.  occluders : what stands before people.  each : `map`, perhaps over
    threads. Cameras that are all off by one rotation, shift or scale agree.
    """
    settings = settings or AgreementSettings()
    world = _World(rig, samples, occluders, settings, each)
    return _Judge(world, list(each(world.sight, range(len(rig)))), settings).agreement()


class _World:
    """The samples with distances to their outlines, and the lines of sight of any camera through them."""

    def __init__(
        self,
        rig: CameraRig,
        samples: Sequence[MaskSample],
        occluders: Occluders | None,
        settings: AgreementSettings,
        each: Callable[..., Iterable[Any]],
    ) -> None:
        self.rig, self.samples, self.occluders, self._settings = rig, samples, occluders, settings
        self._inside: list[list[NDArray[np.float32] | None]] = list(
            each(lambda s: [None if m is None else _depth_inside(m) for m in s.masks], samples)
        )
        if self.is_furnished and len(rig) >= _MANY:
            list(each(self._leave_out_cuts, samples, self._inside))

    def _leave_out_cuts(self, sample: MaskSample, inside: Sequence[NDArray[np.float32] | None]) -> None:
        """A camera does not judge beyond where something cuts its outline off: inf into its distances, in place."""
        cut = [self._cut_outline(sample, inside, c) for c in range(len(self.rig))]
        for own, at in zip(inside, cut, strict=True):
            if own is not None and at is not None:
                own[_nearest_of(at[0], at[1], own.shape) & (own < 0)] = np.inf

    @property
    def is_furnished(self) -> bool:
        """Whether something is known to stand before people."""
        return self.occluders is not None and not self.occluders.is_empty

    @property
    def agrees_m(self) -> float:
        """Cameras that are off by less agree, m."""
        settings = self._settings
        far = np.array([sample.places.mean(axis=0) for sample in self.samples])
        pixels = [
            float(np.linalg.norm(far - camera.center, axis=1).mean())
            / (0.5 * (camera.K[0, 0] + camera.K[1, 1]))
            for camera in self.rig
        ]
        least = max(settings.agrees_m, settings.agrees_px * float(np.median(pixels)))
        return least * (settings.among_furniture if self.is_furnished else 1.0)

    def _cut_outline(
        self, sample: MaskSample, inside: Sequence[NDArray[np.float32] | None], c: int
    ) -> tuple[Array, NDArray[np.bool_]] | None:
        """Points of a mask's outline, px, and which of them others see far beyond: there something hides the person."""
        mask, everyone = sample.masks[c], tuple(k for k in range(len(self.rig)) if k != c)
        if mask is None:
            return None
        uv, normal = _outline(mask, self.rig[c], None, sample.places, self._settings.n_points)
        if not len(uv):
            return None
        others = [None if k == c else own for k, own in enumerate(inside)]
        part = self._part(self.rig[c], uv, normal, sample.places, others)
        touch = _touch(part, everyone, self._settings, n_tolerated=1)
        return uv, touch.clearance > self._settings.cut_m

    def sight(self, c: int, camera: Camera | None = None) -> _Sight | None:
        """The lines of sight of a camera over all samples, None without any.  camera : in its place."""
        camera = camera or self.rig[c]
        parts = []
        for sample, inside in zip(self.samples, self._inside, strict=True):
            mask = sample.masks[c]
            if mask is None:
                continue
            uv, normal = _outline(mask, camera, self.occluders, sample.places, self._settings.n_points)
            if len(uv):
                others = [None if k == c else own for k, own in enumerate(inside)]
                parts.append(self._part(camera, uv, normal, sample.places, others))
        return _joined(parts) if parts else None

    def _part(
        self,
        camera: Camera,
        uv: Array,
        normal: Array,
        places: Array,
        inside: Sequence[NDArray[np.float32] | None],
    ) -> _Sight:
        """Lines of sight in one sample, and how deep they go into the masks of the others."""
        rays = camera.rays(uv)
        across = camera.rays(uv + normal) - rays
        across -= np.einsum("nc,nc->n", across, rays)[:, None] * rays
        across /= np.linalg.norm(across, axis=1, keepdims=True)
        # The nearest place need not be a corner: under the ceiling it is the head of who stands below.
        nearest = np.clip(camera.center, places.min(axis=0), places.max(axis=0))
        near_m = float(np.linalg.norm(nearest - camera.center))
        far_m = float(np.linalg.norm(places - camera.center, axis=1).max())
        reach, step = self._settings.reach_m, self._settings.step_m
        along = np.arange(max(near_m - reach, step), far_m + reach, step)
        points = camera.center + rays[:, None] * along[:, None]
        clearance = np.full((*points.shape[:2], len(self.rig)), np.inf, dtype=np.float32)
        for k, (other, own) in enumerate(zip(self.rig, inside, strict=True)):
            if own is not None:
                found = _clearance(other, points.reshape(-1, 3), own, self.occluders)
                clearance[:, :, k] = found.reshape(points.shape[:2])
        return _Sight(rays, across, np.broadcast_to(along, points.shape[:2]), clearance)


class _Judge:
    """Fits of cameras against groups of the others, each done once."""

    def __init__(self, world: _World, sights: Sequence[_Sight | None], settings: AgreementSettings) -> None:
        self._world, self._sights, self._settings = world, sights, settings
        self._offsets: dict[tuple[int, tuple[int, ...]], float] = {}

    def agreement(self) -> Agreement:
        """The fewest cameras without which the others agree; none when that is not one answer."""
        cameras = tuple(c for c, sight in enumerate(self._sights) if sight is not None)
        offset, agrees_m = self.largest(cameras), self._world.agrees_m
        if not offset > agrees_m:
            return Agreement({}, offset, is_decided=bool(np.isfinite(offset)))
        least_m = min(self._settings.disagrees * agrees_m, self._settings.left * offset)
        for n in range(1, min(self._settings.most_named, len(cameras) - _MIN_AGREEING) + 1):
            left = {bad: self.largest(_without(cameras, bad)) for bad in combinations(cameras, n)}
            bad = min(left, key=lambda some: np.nan_to_num(left[some], nan=np.inf))
            if left[bad] <= max(agrees_m, least_m):
                next_best = min(own for some, own in left.items() if some != bad)
                if next_best < self._settings.clearly * left[bad]:
                    break
                others = _without(cameras, bad)
                if min(self.own_share(c, others) for c in bad) < self._settings.own:
                    # They see too little of people, and stand where they should: something hides it from them.
                    return Agreement({}, left[bad], is_decided=True)
                misfits = {self._world.rig[c].name: self.misfit(c, others) for c in bad}
                return Agreement(misfits, left[bad], is_decided=True)
        return Agreement({}, offset, is_decided=offset <= self._settings.disagrees * agrees_m)

    def largest(self, group: tuple[int, ...]) -> float:
        """The largest misfit within a group of cameras, NaN when there is too little to tell from."""
        offsets = [self.offset(c, _without(group, (c,))) for c in group]
        known = [offset for offset in offsets if np.isfinite(offset)]
        return max(known) if known else float("nan")

    def offset(self, c: int, others: tuple[int, ...]) -> float:
        """The misfit of a camera against others, m, NaN when there is too little to tell from."""
        key = c, others
        if key not in self._offsets:
            sight = self._sights[c]
            fit = None if sight is None else _fitted(self._world.rig[c], sight, others, _TURN, self._settings)
            self._offsets[key] = float("nan") if fit is None else fit.offset_m
        return self._offsets[key]

    def own_share(self, c: int, others: tuple[int, ...]) -> float:
        """The misfit of a camera against others who agree, by the largest that there is when it judges them too.

        A camera that stands elsewhere is off by as much as it makes others seem; one from which something hides a leg
        makes others seem off, and has outlines that fit them.
        """
        largest = self.largest((*others, c))
        return self.offset(c, others) / largest if largest > 0 else 0.0

    def misfit(self, c: int, others: tuple[int, ...]) -> Misfit:
        """How a camera has to be moved so that it agrees with others, step by step."""
        turned, offset_m, shift_px = self._moved(c, others, _TURN)
        shifted, _, _ = self._moved(c, others, _SHIFT)
        camera = self._world.rig[c]
        turn = Rotation.from_matrix(turned.R @ camera.R.T)
        return Misfit(
            offset_m=offset_m,
            turn_deg=float(np.degrees(turn.magnitude())),
            shift_m=float(np.linalg.norm(shifted.center - camera.center)),
            turned=turned,
            shift_px=shift_px,
        )

    def _moved(
        self, c: int, others: tuple[int, ...], columns: NDArray[np.int64]
    ) -> tuple[Camera, float, tuple[float, float]]:
        """The camera in its right place, its misfit m, and by how much its picture shifts, px."""
        first = camera = self._world.rig[c]
        sight, places = self._sights[c], np.zeros((0, 3))
        for _ in range(self._settings.n_steps):
            fit = None if sight is None else _fitted(camera, sight, others, columns, self._settings)
            if fit is None:
                break
            places = camera.center + fit.arms
            camera = _moved_camera(camera, fit.parameters)
            if fit.offset_m < _DONE_M:
                break
            sight = self._world.sight(c, camera)
        (before, depth), (after, _) = first.project(places), camera.project(places)
        shift = after - before
        focal = 0.5 * (first.K[0, 0] + first.K[1, 1])
        offset_m = float(np.sqrt(np.nanmean((np.linalg.norm(shift, axis=1) * depth / focal) ** 2)))
        u, v = np.nanmedian(shift, axis=0)
        return camera, offset_m, (float(u), float(v))


def _without(cameras: tuple[int, ...], bad: tuple[int, ...]) -> tuple[int, ...]:
    return tuple(c for c in cameras if c not in bad)


def _moved_camera(camera: Camera, parameters: Array) -> Camera:
    """The camera shifted and turned about its centre.  parameters : (6,) as of `_Fit`."""
    R = Rotation.from_rotvec(parameters[3:]).as_matrix().T @ camera.R
    center = camera.center + camera.R.T @ parameters[:3]
    return Camera(camera.name, camera.size, camera.K, camera.dist, R, -R @ center, camera.is_fisheye)


@dataclass(frozen=True, eq=False)
class _Fit:
    """parameters : (6,) shift m and rotation vector rad, camera axes, that the camera should be moved by.
    arms : (N, 3) m, world, from its centre to where its lines of sight touch the hull.  offset_m : as of `Misfit`."""

    parameters: Array
    arms: Array
    offset_m: float


class _Touch(NamedTuple):
    """Where lines of sight come nearest to a hull, or go deepest into it.

    clearance : (N,) m, -inf where too few judge.  depth : (N,) m along the line.
    """

    clearance: Array
    depth: Array


def _touch(
    sight: _Sight, others: tuple[int, ...], settings: AgreementSettings, n_tolerated: int = 0
) -> _Touch:
    """Lines of sight against the hull of some other cameras, of which so many may be wrong anywhere."""
    judged = sight.clearance[:, :, list(others)]
    if len(others) < max(settings.min_judges, n_tolerated + 1):
        return _Touch(np.full(len(judged), -np.inf), sight.depth[:, 0])
    clearance = np.partition(judged, n_tolerated, axis=2)[:, :, n_tolerated]
    clearance[np.count_nonzero(np.isfinite(judged), axis=2) < settings.min_judges] = -np.inf
    best = clearance.argmax(axis=1)
    rows = np.arange(len(best))
    return _Touch(clearance[rows, best].astype(np.float64), sight.depth[rows, best])


def _nearest_of(uv: Array, chosen: NDArray[np.bool_], shape: tuple[int, ...]) -> NDArray[np.bool_]:
    """Pixels (H, W) bool of a picture whose nearest point of uv (N, 2) is a chosen one (N,)."""
    at = np.clip(np.rint(uv).astype(np.int64), 0, np.array(shape[::-1]) - 1)
    marks = np.ones(shape, dtype=np.uint8)
    marks[at[:, 1], at[:, 0]] = 0
    _, labels = cv2.distanceTransformWithLabels(marks, cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL)
    is_chosen = np.zeros(int(labels.max()) + 1, dtype=np.bool_)
    is_chosen[labels[at[:, 1], at[:, 0]]] = chosen
    return np.asarray(is_chosen[labels])


def _fitted(
    camera: Camera,
    sight: _Sight,
    others: tuple[int, ...],
    columns: NDArray[np.int64],
    settings: AgreementSettings,
) -> _Fit | None:
    """The movement of a camera, by some of its six parameters, after which its outlines touch the others' hull evenly.

    None when there is too little to tell from.
    """
    touch = _touch(sight, others, settings)
    clearance = touch.clearance
    is_good = np.isfinite(clearance) & (clearance > -settings.most_inside_m)
    if np.count_nonzero(is_good) < settings.min_points:
        return None
    rays, normals = sight.rays[is_good], sight.normals[is_good]
    arms = rays * touch.depth[is_good, None]
    features = np.hstack([normals @ camera.R.T, np.cross(arms, normals) @ camera.R.T])[:, columns]
    parameters = np.zeros(6)
    parameters[columns] = _lower_quantile(features, clearance[is_good], settings)
    moved = parameters[:3] @ camera.R + np.cross(parameters[3:] @ camera.R, arms)
    moved -= np.einsum("nc,nc->n", moved, rays)[:, None] * rays
    return _Fit(parameters, arms, float(np.sqrt((moved**2).sum(axis=1).mean())))


def _lower_quantile(features: Array, values: Array, settings: AgreementSettings) -> Array:
    """Coefficients (K,) of features (N, K) in the quantile of values (N,), beside a constant; iterated weights."""
    with_constant = np.hstack([features, np.ones((len(features), 1))])
    ridge = np.diag(np.append(np.full(features.shape[1], settings.ridge), 0.0))
    solution = np.append(np.zeros(features.shape[1]), np.quantile(values, settings.quantile))
    for _ in range(50):
        left = values - with_constant @ solution
        weight = np.where(left >= 0, settings.quantile, 1 - settings.quantile)
        weight /= np.maximum(np.abs(left), settings.loss_m)
        weight *= np.where(left < -settings.far_m, settings.far_m / np.maximum(-left, settings.far_m), 1.0)
        weighted = with_constant * weight[:, None]
        next_one = np.linalg.solve(weighted.T @ with_constant + ridge, weighted.T @ values)
        is_done = np.abs(next_one - solution).max() < 1e-6
        solution = next_one
        if is_done:
            break
    return np.asarray(solution[:-1])


def _joined(parts: Sequence[_Sight]) -> _Sight:
    """One after the other; short lines repeat their last place."""
    longest = max(part.depth.shape[1] for part in parts)

    def long(values: NDArray) -> NDArray:
        fill = [(0, 0), (0, longest - values.shape[1]), *[(0, 0)] * (values.ndim - 2)]
        return np.pad(values, fill, mode="edge")

    return _Sight(
        np.concatenate([p.rays for p in parts]),
        np.concatenate([p.normals for p in parts]),
        np.concatenate([long(p.depth) for p in parts]),
        np.concatenate([long(p.clearance) for p in parts]),
    )


def _clearance(
    camera: Camera, points: Array, inside: NDArray[np.float32], occluders: Occluders | None
) -> NDArray[np.float32]:
    """How far points (N, 3) m lie inside the mask of a camera, (N,) m, inf where it does not judge."""
    uv, depth = camera.project(points)
    is_hidden = (
        np.zeros(len(points), dtype=np.bool_) if occluders is None else occluders.hides_at(camera, uv, depth)
    )
    out = np.empty(len(points), dtype=np.float32)
    focal = float(0.5 * (camera.K[0, 0] + camera.K[1, 1]))
    _kernels.clearance_of_points(uv, depth, is_hidden, inside, focal, out)
    return out


def _depth_inside(mask: Mask) -> NDArray[np.float32] | None:
    """Distance to the outline, px, negative outside; None without a mask."""
    if not mask.any():
        return None
    own = mask.astype(np.uint8)
    distance = cv2.distanceTransform(1 - own, cv2.DIST_L2, 3)
    np.subtract(np.float32(0.5), distance, out=distance)
    # Nothing outside of a mask's rectangle and its rim is nearer to what is inside.
    here = _rectangle_of(own, 1)
    within = cv2.distanceTransform(own[here], cv2.DIST_L2, 3)
    np.copyto(distance[here], within - np.float32(0.5), where=mask[here])
    return np.asarray(distance, dtype=np.float32)


def _rectangle_of(mask: NDArray[np.uint8], margin: int) -> tuple[slice, slice]:
    """Rows and columns of what a mask (H, W) holds, with a margin."""
    u, v, w, h = cv2.boundingRect(mask)
    return slice(max(v - margin, 0), v + h + margin), slice(max(u - margin, 0), u + w + margin)


def _outline(
    mask: Mask, camera: Camera, occluders: Occluders | None, places: Array, n_points: int
) -> tuple[Array, Array]:
    """Points (N, 2) px on the outline of a mask with their outward normals (N, 2).

    What lies at the edge of the picture, or of something that stands before the person, is no outline of the person.
    """
    own = mask.astype(np.uint8)
    contours, _ = cv2.findContours(own, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    chains = [chain[:, 0] for chain in contours if len(chain) >= _MIN_CHAIN]
    if not chains:
        return np.zeros((0, 2)), np.zeros((0, 2))
    at = np.concatenate(chains)
    height, width = mask.shape
    is_inner = np.all((at > _EDGE_PX) & (at < np.array([width, height]) - 1 - _EDGE_PX), axis=1)
    hidden = None if occluders is None else occluders.hidden_pixels(camera, places)
    if hidden is not None:
        near = cv2.dilate(hidden.astype(np.uint8), np.ones((2 * _EDGE_PX + 1,) * 2, np.uint8))
        is_inner &= near[at[:, 1], at[:, 0]] == 0
    at = at[is_inner]
    at = at[:: max(1, len(at) // n_points)]
    here = _rectangle_of(own, _BLUR_PX)
    smooth = cv2.GaussianBlur(own[here].astype(np.float32), (0, 0), _NORMAL_PX)
    slope = np.stack([cv2.Sobel(smooth, cv2.CV_32F, 1, 0), cv2.Sobel(smooth, cv2.CV_32F, 0, 1)], axis=-1)
    normal = -slope[at[:, 1] - here[0].start, at[:, 0] - here[1].start].astype(np.float64)
    length = np.linalg.norm(normal, axis=1)
    normal = normal[length > 1e-3] / length[length > 1e-3, None]
    # The outline runs between the last pixel inside and the first outside.
    return at[length > 1e-3] + 0.5 * normal, normal
