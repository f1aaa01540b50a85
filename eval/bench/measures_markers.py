"""Marker likelihood and filter: 20 markers, 7 cameras, detections as CF 6.6.1 simulates them, one thread.

Times are CPU times of the measuring thread, because microseconds of wall time say more about the neighbours.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from eval.bench.registry import measure
from mocap.body import Body
from mocap.body.markers import Markers
from mocap.likelihood.markers import MarkerObservation, MarkerViews

Array = NDArray[np.float64]

_SEED = 17
_FPS = 30.0
_N_LAYERS, _N_PARTICLES = 3, 700  # CF Table 6.3
_N_NUMPY = 3
_DETECTION_RATE = 0.6  # 0.9 of the markers that the body does not hide from a camera, about two thirds
_FALSE_POSITIVES = 20
_NOISE_PX = 2.0


@dataclass(frozen=True, eq=False)
class MarkerScene:
    """detections : per camera (n, 2) raw px of one frame.  truth : (D,).  particles : (N, D), as a layer has them."""

    body: Body
    markers: Markers
    views: MarkerViews
    detections: tuple[Array, ...]
    observation: MarkerObservation
    truth: Array
    particles: Array


@lru_cache(maxsize=1)
def marker_scene() -> MarkerScene:
    """A standing body of 1.75 m amid seven cameras."""
    from eval.bench.scene import ring
    from mocap.body import load_body_model, neutral_state, scale_body
    from mocap.body.markers import load_marker_set, marker_positions, place_markers
    from mocap.data.propagation import truncated_gaussian_step
    from mocap.likelihood.markers import marker_views, observe

    rng = np.random.default_rng(_SEED)
    body = scale_body(load_body_model("anthropometric"), 1.75)
    markers = place_markers(load_marker_set("markers_20"), body)
    views = marker_views(ring(7))
    truth = neutral_state(body)
    points = marker_positions(body, markers, truth[None])[0]
    detections = []
    for camera in views.rig:
        uv, _ = camera.project(points)
        seen = uv[rng.random(len(uv)) < _DETECTION_RATE]
        false = rng.uniform(uv.min(axis=0), uv.max(axis=0), (_FALSE_POSITIVES, 2))
        detections.append(np.concatenate([seen + rng.normal(0.0, _NOISE_PX, seen.shape), false]))
    std = 0.5 * body.max_speed / _FPS
    particles = truncated_gaussian_step(
        np.tile(truth, (_N_PARTICLES, 1)), std, body.layout.lower, body.layout.upper, rng=rng
    )
    return MarkerScene(body, markers, views, tuple(detections), observe(views, detections), truth, particles)


def _median_s(function: Callable[[], object], n_rounds: int) -> float:
    """Median CPU time of this thread after one unmeasured call."""
    function()
    times = []
    for _ in range(n_rounds):
        begun = time.thread_time()
        function()
        times.append(time.thread_time() - begun)
    return statistics.median(times)


def _filter_fps(reprojection_weight: float) -> float:
    from mocap.filters import initial_particles
    from mocap.filters.apf import ApfSettings, apf_step
    from mocap.likelihood.markers import MarkerLikelihoodSettings, MarkerProblem, observe

    s = marker_scene()
    likelihood = MarkerLikelihoodSettings(reprojection_weight=reprojection_weight)
    settings = ApfSettings(_N_LAYERS, _N_PARTICLES, 0.5 * s.body.max_speed / _FPS)
    rng = np.random.default_rng(_SEED)

    def frame() -> None:
        problem = MarkerProblem(s.body, s.markers, observe(s.views, s.detections), likelihood)
        apf_step(problem, initial_particles(problem, s.truth, _N_PARTICLES), settings, rng=rng)

    return 1.0 / _median_s(frame, 15)


@measure("marker_fps", unit="frames/s", better="higher")
def marker_fps() -> float:
    """Marker filter of the default preset's likelihood, 3 layers of 700, from raw detections, filter alone."""
    return _filter_fps(1.0)


@measure("marker_fps_printed", unit="frames/s", better="higher")
def marker_fps_printed() -> float:
    """The same with the printed cost, epipolar distances of all pairs of views."""
    return _filter_fps(0.0)


@measure("marker_likelihood_us", unit="us", better="lower")
def marker_likelihood_us() -> float:
    """One evaluation of 20 markers in 7 views with both terms, in a batch of 700."""
    from mocap.likelihood.markers import MarkerLikelihoodSettings, MarkerProblem

    s = marker_scene()
    problem = MarkerProblem(
        s.body, s.markers, s.observation, MarkerLikelihoodSettings(reprojection_weight=0.5)
    )
    return _median_s(lambda: problem.log_likelihood(s.particles), 25) / _N_PARTICLES * 1e6


@measure("marker_likelihood_over_numpy", unit="x", better="higher")
def marker_likelihood_over_numpy() -> float:
    """How many times faster than the same scores written with numpy; both give the same numbers."""
    from mocap.likelihood.markers import MarkerLikelihoodSettings, MarkerProblem, marker_scores_numpy

    s = marker_scene()
    settings = MarkerLikelihoodSettings(reprojection_weight=0.5)
    problem = MarkerProblem(s.body, s.markers, s.observation, settings)
    few = s.particles[:_N_NUMPY]
    assert np.allclose(
        problem.scores(few), marker_scores_numpy(s.body, s.markers, s.observation, settings, few), atol=1e-6
    )
    ours = _median_s(lambda: problem.scores(s.particles), 15) / _N_PARTICLES
    theirs = _median_s(lambda: marker_scores_numpy(s.body, s.markers, s.observation, settings, few), 5)
    return theirs / _N_NUMPY / ours


@measure("marker_refine_ms", unit="ms", better="lower")
def marker_refine_ms() -> float:
    """One refinement on detections as the pose stage calls it: two rounds of matching and fitting."""
    from mocap.pipeline.config import load_config
    from mocap.pipeline.pose_settings import marker_tools

    s = marker_scene()
    config = load_config()
    tools = marker_tools(s.body, s.markers, _FPS, config)
    return _median_s(lambda: tools.fit(s.observation, s.particles[0]), 25) * 1e3
