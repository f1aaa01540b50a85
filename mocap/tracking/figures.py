"""Persons from figures: which keypoints of which pictures are of one person, by geometry and over time.

A figure is the keypoints of one person in one picture. A frame's figures go first to the persons known, by the distance
of their keypoints from the person's points of the frame before; what is left over makes new persons, where the figures
of two views or more agree on points that are as far apart as those of a person.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from mocap.arrays import Array
from mocap.data.keypoints import KEYPOINTS, N_KEYPOINTS
from mocap.geometry.triangulation import fundamental_of_projections, triangulate_agreeing

_FAR_M = 10.0
_SEGMENTS = [
    (KEYPOINTS.index(f"{side}_{a}"), KEYPOINTS.index(f"{side}_{b}"))
    for side in ("left", "right")
    for a, b in (("shoulder", "hip"), ("hip", "knee"), ("knee", "ankle"), ("shoulder", "elbow"))
]
TRUNK = [KEYPOINTS.index(f"{side}_{name}") for name in ("shoulder", "hip") for side in ("left", "right")]


@dataclass(frozen=True)
class FigureSettings:
    """How figures become persons. Chosen on development sessions with `python -m eval.evidence`."""

    noise_m: float = 0.018
    """Deviation of a keypoint of confidence 1 along each axis, at the person's distance: half of MediaPipe's points
    with a confidence above 0.9 lie within 23 mm of the joint (`python -m eval.keypoint_places`)."""
    noise_px: float = 1.0
    """Its least deviation, px."""
    sure: float = 0.05
    """Added to the confidence c: the deviation grows as (c + sure)^-1/2, from 18 mm to 80 mm at confidence 0."""
    gate_m: float = 0.3
    """Median distance of a figure's keypoints from a person's from which it is another's."""
    speed_m_s: float = 2.0
    """By which this grows for persons who were not seen for a while."""
    new_gate_m: float = 0.06
    """Median distance of two views' keypoints from common points from which they are of different persons."""
    min_points: int = 5
    """Keypoints that two figures must share before they are compared."""
    segment_m: tuple[float, float] = (0.1, 0.8)
    """Length of a thigh, shank, upper arm or flank: others are those of no person."""
    lost_s: float = 1.5
    """Persons who were not seen by two views for so long are gone; who comes back is a new one."""
    min_s: float = 0.4
    """Persons seen by two views for a shorter time, and for less than half of a clip, are none."""
    place_gate_m: float = 0.5
    """Distance of a figure's trunk from a person's volume from which it is another's."""
    clear_m: float = 0.15
    """By how much another person's volume must lie further off."""


@dataclass(frozen=True, eq=False)
class View2D:
    """One figure.  uv : (K, 2) undistorted px, NaN = not found.  confidence : (K,)."""

    camera: int
    uv: Array
    confidence: Array


@dataclass(eq=False)
class FigurePerson:
    """A person made of figures.  views : frame -> (C,) index of the frame's figure in each view, -1 = none.  points :
    frame -> (K, 3) m, NaN where views do not agree."""

    number: int
    views: dict[int, NDArray[np.int64]] = field(default_factory=dict)
    points: dict[int, Array] = field(default_factory=dict)
    latest: Array = field(default_factory=lambda: np.full((N_KEYPOINTS, 3), np.nan))
    last_frame: int = -1

    @property
    def frames(self) -> list[int]:
        """Frames in which two views or more agreed, ascending."""
        return sorted(self.points)


@dataclass(frozen=True, eq=False)
class FigureViews:
    """What the association needs of the cameras.  P : (C, 3, 4), world to undistorted px.  focal : (C,) px."""

    P: Array
    focal: Array

    def fundamental(self, a: int, b: int) -> Array:
        """F (3, 3) with x_b^T F x_a = 0 for undistorted pixels of cameras a and b."""
        return fundamental_of_projections(self.P[a], self.P[b])

    def distance_m(self, points: Array, figure: View2D) -> Array:
        """Distance (K,) m of a figure's keypoints from the images of points (K, 3), at the points' depth; NaN where
        either is unknown, far for points behind the camera."""
        c = figure.camera
        x = points @ self.P[c, :, :3].T + self.P[c, :, 3]
        with np.errstate(divide="ignore", invalid="ignore"):
            error = np.linalg.norm(x[:, :2] / x[:, 2:] - figure.uv, axis=1) * x[:, 2] / self.focal[c]
        return np.where(x[:, 2] < 0, _FAR_M, error)


def deviation_px(
    settings: FigureSettings, confidence: Array, depth_m: Array | float, focal: Array | float
) -> Array:
    """Standard deviation of keypoints along u and v, px, of any shape, at a person's distance."""
    std_m = settings.noise_m / np.sqrt(confidence + settings.sure)
    return np.hypot(settings.noise_px, std_m * focal / np.maximum(depth_m, 0.1))


def persons_of_figures(
    figures_of: Mapping[int, Sequence[View2D]], views: FigureViews, fps: float, settings: FigureSettings
) -> list[FigurePerson]:
    """Persons over a clip, numbered from 1 in the order of their appearance.

    figures_of : frame -> its figures, undistorted.
    """
    alive: list[FigurePerson] = []
    done: list[FigurePerson] = []
    for frame in sorted(figures_of):
        gone = [p for p in alive if frame - p.last_frame > settings.lost_s * fps]
        done += gone
        alive = [p for p in alive if p not in gone]
        figures = figures_of[frame]
        free = _given_to_known(alive, figures, frame, views, fps, settings)
        for group in _new_groups(figures, free, views, settings):
            person = FigurePerson(0)
            person.views[frame] = _of_views(figures, group, len(views.P))
            alive.append(person)
        for person in alive:
            if frame in person.views:
                _update(person, frame, figures, views, settings)
    least = max(2, min(settings.min_s * fps, 0.5 * len(figures_of)))
    found = [p for p in done + alive if len(p.frames) >= least]
    found.sort(key=lambda p: p.frames[0])
    for number, person in enumerate(found, 1):
        person.number = number
    return found


def _of_views(figures: Sequence[View2D], chosen: Sequence[int], n_views: int) -> NDArray[np.int64]:
    out = np.full(n_views, -1, dtype=np.int64)
    for i in chosen:
        out[figures[i].camera] = i
    return out


def _given_to_known(
    alive: Sequence[FigurePerson],
    figures: Sequence[View2D],
    frame: int,
    views: FigureViews,
    fps: float,
    settings: FigureSettings,
) -> list[int]:
    """Give figures to the persons known, one of every view; the figures that nobody takes."""
    free = set(range(len(figures)))
    if not alive:
        return sorted(free)
    for c in range(len(views.P)):
        own = [i for i, f in enumerate(figures) if f.camera == c]
        if not own:
            continue
        cost = np.array(
            [[_median(views.distance_m(p.latest, figures[i]), settings) for i in own] for p in alive]
        )
        gate = [settings.gate_m + settings.speed_m_s * (frame - p.last_frame - 1) / fps for p in alive]
        for a, b in zip(*linear_sum_assignment(np.minimum(cost, _FAR_M)), strict=True):
            if cost[a, b] <= gate[a]:
                free.discard(own[b])
                alive[a].views.setdefault(frame, np.full(len(views.P), -1, dtype=np.int64))[c] = own[b]
    return sorted(free)


def _median(distance: Array, settings: FigureSettings) -> float:
    known = distance[np.isfinite(distance)]
    return float(np.median(known)) if len(known) >= settings.min_points else _FAR_M


def _update(
    person: FigurePerson,
    frame: int,
    figures: Sequence[View2D],
    views: FigureViews,
    settings: FigureSettings,
) -> None:
    """The person's points of a frame; points on which no views agree move along with the others."""
    own = [figures[i] for i in person.views[frame] if i >= 0]
    points = points_of_figures(own, views, settings, person.latest)
    known = np.asarray(np.isfinite(points).all(axis=1))
    if int(known.sum()) < settings.min_points:
        return
    person.points[frame] = points
    person.last_frame = frame
    shift = np.nanmedian((points - person.latest)[known], axis=0) if person.frames[:-1] else np.zeros(3)
    person.latest = np.where(known[:, None], points, person.latest + np.nan_to_num(shift))


def points_of_figures(
    figures: Sequence[View2D], views: FigureViews, settings: FigureSettings, near: Array | None = None
) -> Array:
    """The points (K, 3) m on which figures of different views agree."""
    uv = np.full((len(views.P), N_KEYPOINTS, 2), np.nan)
    gate = np.ones((len(views.P), N_KEYPOINTS))
    middle = np.nanmean(near, axis=0) if near is not None and np.isfinite(near).any() else None
    for f in figures:
        depth = 3.5 if middle is None else float(views.P[f.camera, 2, :3] @ middle + views.P[f.camera, 2, 3])
        uv[f.camera] = f.uv
        gate[f.camera] = 3.0 * deviation_px(settings, f.confidence, depth, views.focal[f.camera])
    return triangulate_agreeing(views.P, uv, gate).points


def _new_groups(
    figures: Sequence[View2D], free: Sequence[int], views: FigureViews, settings: FigureSettings
) -> Iterator[list[int]]:
    """Groups of free figures, one of a view at most, that agree on the points of a person; best first."""
    left = list(free)
    while len(left) >= 2:
        best: tuple[float, list[int]] | None = None
        for n, i in enumerate(left):
            for j in left[n + 1 :]:
                if figures[i].camera == figures[j].camera:
                    continue
                group = _grown(figures, i, j, left, views, settings)
                if group is not None and (
                    best is None or (-len(group[1]), group[0]) < (-len(best[1]), best[0])
                ):
                    best = group
        if best is None:
            return
        yield best[1]
        left = [i for i in left if i not in best[1]]


def _grown(
    figures: Sequence[View2D],
    i: int,
    j: int,
    left: Sequence[int],
    views: FigureViews,
    settings: FigureSettings,
) -> tuple[float, list[int]] | None:
    """Two figures and all that agree with them, with their median distance; None when they are not of a person."""
    points = points_of_figures([figures[i], figures[j]], views, settings)
    if np.isfinite(points).all(axis=1).sum() < settings.min_points or not is_person(points, settings):
        return None
    group, total = [i, j], 0.0
    for k in (i, j):
        distance = _median(views.distance_m(points, figures[k]), settings)
        if distance > settings.new_gate_m:
            return None
        total += distance
    for k in left:
        if figures[k].camera in [figures[m].camera for m in group]:
            continue
        distance = _median(views.distance_m(points, figures[k]), settings)
        if distance <= 2 * settings.new_gate_m:
            group.append(k)
            total += distance
    return total / len(group), group


def figures_of_places(
    figures: Sequence[View2D], places: Array, views: FigureViews, settings: FigureSettings
) -> list[list[int]]:
    """The figures of each of several persons who are at places (P, 3) m: P lists, one figure of a view at most.

    A figure belongs to a place that lies among its points; one that another place fits hardly worse is left out.
    """
    given: list[list[int]] = [[] for _ in places]
    for c in range(len(views.P)):
        own = [i for i, f in enumerate(figures) if f.camera == c]
        if not own or not len(places):
            continue
        cost = np.array([[_from_trunk_m(place, figures[i], views) for i in own] for place in places])
        for a, b in zip(*linear_sum_assignment(cost), strict=True):
            others = np.delete(cost[:, b], a)
            is_clear = not len(others) or others.min() > cost[a, b] + settings.clear_m
            if cost[a, b] <= settings.place_gate_m and is_clear:
                given[a].append(own[b])
    return given


def _from_trunk_m(place: Array, figure: View2D, views: FigureViews) -> float:
    """Distance of a figure's trunk from the image of a place (3,) m, at its depth, m."""
    trunk = figure.uv[TRUNK]
    seen = trunk[np.isfinite(trunk).all(axis=1)]
    x = views.P[figure.camera] @ np.append(place, 1.0)
    if len(seen) < 2 or not x[2] > 0:
        return _FAR_M
    distance = float(np.linalg.norm(seen.mean(axis=0) - x[:2] / x[2]) * x[2] / views.focal[figure.camera])
    return min(distance, _FAR_M)


def is_person(points: Array, settings: FigureSettings) -> bool:
    """Whether points (K, 3) m lie as far apart as those of a person: most of the segments that are known."""
    lengths = np.array([np.linalg.norm(points[a] - points[b]) for a, b in _SEGMENTS])
    known = lengths[np.isfinite(lengths)]
    low, high = settings.segment_m
    return len(known) >= 2 and float(((known > low) & (known < high)).mean()) > 0.5
