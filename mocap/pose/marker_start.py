"""Start from unlabelled detections: points on which the cameras agree, and a body fitted to them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from mocap.body import Body, candidate_states, landmarks_of
from mocap.body.initial import HIGHEST_STANDING_TOP_M, LOWEST_STANDING_TOP_M
from mocap.body.markers import Markers, marker_positions
from mocap.filters import initial_particles
from mocap.filters.apf import ApfSettings, apf_step
from mocap.geometry.triangulation import triangulate_unlabelled
from mocap.likelihood.markers import MarkerObservation
from mocap.pose.marker import Fit, MarkerTools, ObservationOf
from mocap.pose.method import MarkerStartSettings

Array = NDArray[np.float64]
PointsOf = Callable[[int], Array]


def points_of_frames(
    observation_of: ObservationOf, max_error_px: float = MarkerStartSettings.max_error_px
) -> PointsOf:
    """Frame -> points (K, 3) m on which the views agree; the last frames are remembered."""

    @lru_cache(maxsize=64)
    def points_of(frame: int) -> Array:
        observation = observation_of(frame)
        views = observation.views
        detections = [observation.of_view(c) for c in range(views.n_views)]
        min_views = min(views.n_views, max(2, (views.n_views + 1) // 2))
        return triangulate_unlabelled(
            views.P, detections, max_error_px=max_error_px, min_views=min_views
        ).points

    return points_of


def steady_points(
    points_of: PointsOf, frame: int, frames: range, near_m: float = MarkerStartSettings.steady_m
) -> Array:
    """Points (K, 3) m of a frame that a neighbouring frame shows within near_m too.

    With many false detections a frame alone has as many false points as true ones; over time they do not last.
    """
    points = points_of(frame)
    neighbours = [frame + step for step in (-1, 1) if frame + step in frames]
    if not neighbours:
        return points
    is_steady = np.zeros(len(points), dtype=np.bool_)
    for other in neighbours:
        others = points_of(other)
        if len(others) and len(points):
            is_steady |= np.linalg.norm(points[:, None] - others[None], axis=2).min(axis=1) < near_m
    return points[is_steady]


def height_from_points(
    points_of_frames: Sequence[Array], min_points: int = MarkerStartSettings.min_points
) -> float | None:
    """Standing height from the highest steady point of each frame, m; None when nobody seems to stand."""
    tops = [float(p[:, 2].max()) for p in points_of_frames if len(p) >= min_points]
    if not tops:
        return None
    top = float(np.quantile(tops, 0.8))
    return top if LOWEST_STANDING_TOP_M <= top <= HIGHEST_STANDING_TOP_M else None


@dataclass(frozen=True, eq=False)
class MarkerStart:
    """Candidate first poses of one frame, the best first.  fits : refined on this frame alone."""

    frame: int
    fits: tuple[Fit, ...]
    labels: tuple[str, ...]


def find_starts(
    tools: MarkerTools,
    observation: MarkerObservation,
    points: Array,
    frame: int,
    *,
    n: int,
    rng: np.random.Generator,
) -> MarkerStart:
    """Up to n different poses that explain a frame: usual poses in all directions, moved onto the points, searched
    around by a short annealed filter, refined.

    points : (K, 3) m, steady ones.
    """
    body, numbers = tools.body, tools.settings.method.marker_start
    n_yaws = numbers.n_directions
    yaws: Array = np.arange(n_yaws, dtype=np.float64) * (2 * np.pi / n_yaws)
    middle = np.median(points, axis=0)
    floor = np.array([[middle[0], middle[1], 0.0]])
    states, labels = candidate_states(body, np.vstack([points, floor]), yaws)
    states = _moved_onto(body, tools.markers, states, points, numbers)
    problem = tools.problem(observation, gate_px=numbers.wide_gate_px)
    value = problem.log_likelihood(states).sum(axis=1)
    brief = ApfSettings(
        n_layers=numbers.search_layers,
        n_particles=numbers.search_particles,
        std=np.where(body.is_position, numbers.search_std_m, numbers.search_std_rad),
    )
    tried: list[tuple[Fit, str]] = []
    for k in np.argsort(-value, kind="stable")[: numbers.n_followed]:
        _, info = apf_step(problem, initial_particles(problem, states[k], 2), brief, rng=rng)
        tried.append((tools.fit(observation, info.estimate, tools.wide), labels[k]))
    tried.sort(key=lambda entry: entry[0].cost)
    kept: list[tuple[Fit, str]] = []
    for fit, label in tried:
        place = landmarks_of(body, fit.state[None])[0]
        others = [landmarks_of(body, f.state[None])[0] for f, _ in kept]
        if all(np.linalg.norm(place - o, axis=1).max() > numbers.apart_m for o in others):
            kept.append((fit, label))
        if len(kept) == n:
            break
    return MarkerStart(frame, tuple(f for f, _ in kept), tuple(label for _, label in kept))


def _moved_onto(
    body: Body, markers: Markers, states: Array, points: Array, settings: MarkerStartSettings
) -> Array:
    """States (N, D) shifted and turned about the vertical so that points (K, 3) lie at their markers.

    Robust iterated closest points: each point pulls the marker that is closest to it.
    """
    out = states.copy()
    yaw = body.yaw_column
    for _ in range(settings.icp_rounds):
        at = marker_positions(body, markers, out)
        offset = points[None, None] - at[:, :, None]
        marker = np.linalg.norm(offset, axis=3).argmin(axis=1)
        pull = np.take_along_axis(offset, marker[:, None, :, None], axis=1)[:, 0]
        weight = (1.0 + (np.linalg.norm(pull, axis=2) / settings.icp_scale_m) ** 2) ** -2
        shift = np.einsum("nk,nkc->nc", weight, pull) / weight.sum(axis=1)[:, None]
        if yaw is not None:
            arm = np.take_along_axis(at, marker[..., None], axis=1) - out[:, None, :3]
            rest = pull - shift[:, None]
            moment = np.einsum("nk,nk->n", weight, arm[..., 0] * rest[..., 1] - arm[..., 1] * rest[..., 0])
            inertia = np.einsum("nk,nkc->n", weight, arm[..., :2] ** 2)
            out[:, yaw] += np.clip(
                moment / np.maximum(inertia, 1e-3), -settings.max_turn_rad, settings.max_turn_rad
            )
        out[:, :3] += shift
    return out
