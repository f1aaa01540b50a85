"""Persons whom one camera alone shows: where their feet stand on the floor tells how far away they are.

A detector that gives one person per picture may show somebody to a single camera all the time. The ray through the
foot that stands meets the floor in one place; there the figure is put up, flat and facing the camera.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter1d

from mocap.arrays import Array
from mocap.data.keypoints import KEYPOINTS
from mocap.tracking.figures import FigurePerson, FigureSettings, FigureViews, View2D, is_person

_ANKLES = [KEYPOINTS.index(f"{side}_ankle") for side in ("left", "right")]
_HEAD = [KEYPOINTS.index(name) for name in ("head", "nose", "left_eye", "right_eye", "left_ear", "right_ear")]


@dataclass(frozen=True)
class LoneSettings:
    """Who counts as a person though one camera alone shows it. Chosen on `tests/keypoint_world.py`."""

    ankle_m: float = 0.09
    """Height of the ankle of a foot that stands."""
    smooth_s: float = 0.15
    """Deviation of the Gaussian that places are smoothed with: feet stand in turn."""
    step: float = 0.25
    """Share of a figure's size that its keypoints may move from one frame to the next."""
    min_s: float = 1.0
    """A person is there for so long, or for half of the clip."""
    head_m: tuple[float, float] = (1.0, 2.2)
    """Median height of the head: people who stand."""
    head_share: float = 0.1
    """What this may stray over the clip, as a share of it: it does wherever the calibration is another one."""
    moved_m: float = 0.3
    """A person walks: who stays in place may be a picture."""
    apart_m: float = 0.3
    """Distance from others, in the middle of the clip, from which it is not one of them."""


def lone_persons(
    figures_of: Mapping[int, Sequence[View2D]],
    persons: Sequence[FigurePerson],
    cameras: Sequence[int],
    views: FigureViews,
    fps: float,
    settings: LoneSettings | None = None,
) -> dict[int, FigurePerson]:
    """Camera -> who it alone shows for longest, numbered after the persons known.

    figures_of : frame -> its figures.  cameras : that may show somebody whom no other camera shows.  Points of such a
    person lie in a plane that faces the camera, NaN where a figure has none.
    """
    settings = settings or LoneSettings()
    least = max(5.0, min(settings.min_s * fps, 0.5 * len(figures_of)))
    found: dict[int, FigurePerson] = {}
    for c in cameras:
        for chain in sorted(_chains(figures_of, persons, c, fps, settings), key=len, reverse=True):
            if len(chain) < least:
                break
            person = _put_up(figures_of, chain, c, views, fps, settings)
            if _is_walking(person, persons, settings):
                person.number = len(persons) + len(found) + 1
                found[c] = person
                break
    return found


def _chains(
    figures_of: Mapping[int, Sequence[View2D]],
    persons: Sequence[FigurePerson],
    camera: int,
    fps: float,
    settings: LoneSettings,
) -> list[dict[int, int]]:
    """Figures of a camera that are nobody's and follow each other: frame -> its index among the frame's figures."""
    done: list[dict[int, int]] = []
    alive: list[dict[int, int]] = []
    for frame in sorted(figures_of):
        own = figures_of[frame]
        taken = {int(p.views[frame][camera]) for p in persons if frame in p.views}
        free = [i for i, f in enumerate(own) if f.camera == camera and i not in taken]
        done += [chain for chain in alive if frame - max(chain) > FigureSettings.lost_s * fps]
        alive = [chain for chain in alive if frame - max(chain) <= FigureSettings.lost_s * fps]
        for chain in alive:
            last = max(chain)
            moved = [_moved(figures_of[last][chain[last]], own[i]) / (frame - last) for i in free]
            if moved and min(moved) <= settings.step:
                chain[frame] = free.pop(int(np.argmin(moved)))
        alive += [{frame: i} for i in free]
    return done + alive


def _moved(before: View2D, now: View2D) -> float:
    """How far the keypoints of a figure have moved, as a share of its size; inf when they share too few."""
    known = np.isfinite(before.uv).all(axis=1) & np.isfinite(now.uv).all(axis=1)
    if known.sum() < FigureSettings.min_points:
        return float("inf")
    size = float(np.linalg.norm(np.ptp(before.uv[known], axis=0)))
    return float(np.median(np.linalg.norm(now.uv[known] - before.uv[known], axis=1))) / max(size, 1.0)


def _put_up(
    figures_of: Mapping[int, Sequence[View2D]],
    chain: Mapping[int, int],
    camera: int,
    views: FigureViews,
    fps: float,
    settings: LoneSettings,
) -> FigurePerson:
    """The person of a chain of figures, in the frames in which it shows an ankle and a person's points."""
    inverse = np.linalg.inv(views.P[camera, :, :3])
    center = -inverse @ views.P[camera, :, 3]
    person, rays, places = FigurePerson(0), [], []
    for frame in sorted(chain):
        uv = figures_of[frame][chain[frame]].uv
        ray = np.column_stack([uv, np.ones(len(uv))]) @ inverse.T
        place = _standing(center, ray[_ANKLES], settings.ankle_m)
        if place is None:
            continue
        indices = np.full(len(views.P), -1, dtype=np.int64)
        indices[camera] = chain[frame]
        person.views[frame] = indices
        rays.append(ray)
        places.append(place)
    if places:
        smooth = gaussian_filter1d(np.array(places), settings.smooth_s * fps, axis=0, mode="nearest")
        for frame, ray, place in zip(person.views, rays, smooth, strict=True):
            person.points[frame] = _on_plane(center, ray, place)
    return person


def _standing(center: Array, rays: Array, height_m: float) -> Array | None:
    """Where the nearer of two feet stands, (2,) m: the ray of one in the air meets the floor behind it. None when no
    ray meets it."""
    with np.errstate(divide="ignore", invalid="ignore"):
        far = (height_m - center[2]) / rays[:, 2]
    far = far[:, None] * rays
    meets = np.isfinite(far).all(axis=1) & (rays[:, 2] * (height_m - center[2]) > 0)
    if not meets.any():
        return None
    return center[:2] + min(far[meets, :2], key=np.linalg.norm)


def _on_plane(center: Array, rays: Array, place: Array) -> Array:
    """Points (K, 3) m of rays on the upright plane through a place (2,) that faces the camera."""
    away = place - center[:2]
    with np.errstate(divide="ignore", invalid="ignore"):
        far = (away @ away) / (rays[:, :2] @ away)
    return np.where((far > 0)[:, None], center + far[:, None] * rays, np.nan)


def _is_walking(person: FigurePerson, others: Sequence[FigurePerson], settings: LoneSettings) -> bool:
    """Whether it is as tall as people are, all the time, walks about, and is none of the others."""
    points = np.array(list(person.points.values()))
    if len(points) < FigureSettings.min_points:
        return False
    head = points[:, _HEAD, 2]
    tall = np.nanmax(head[np.isfinite(head).any(axis=1)], axis=1)
    if len(tall) < 0.5 * len(points) or not settings.head_m[0] < np.median(tall) < settings.head_m[1]:
        return False
    if np.median(np.abs(tall - np.median(tall))) > settings.head_share * np.median(tall):
        return False
    if np.mean([is_person(own, FigureSettings()) for own in points]) < 0.5:
        return False
    places = np.nanmean(points[:, :, :2], axis=1)
    if np.linalg.norm(np.ptp(places, axis=0)) < settings.moved_m:
        return False
    shared = [
        np.linalg.norm(np.nanmean(other.points[f][:, :2], axis=0) - place)
        for other in others
        for f, place in zip(person.points, places, strict=True)
        if f in other.points
    ]
    return not shared or float(np.median(shared)) > settings.apart_m
