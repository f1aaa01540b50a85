"""Texture: poses of a whole clip refined once more, on the colours that every place of the body has in all of it."""

from __future__ import annotations

import numpy as np

from mocap.arrays import Array
from mocap.likelihood.residuals import Texture, TextureProblem, learnt_texture
from mocap.pose.deviation import FrameSeries, fit_covariance
from mocap.pose.evidence import PersonClip
from mocap.pose.volume import VolumeObservation


def settle_on_texture(clip: PersonClip, series: FrameSeries) -> None:
    """Refine the pose of every frame on hull, outlines and texture together, in place.

    A pose that was off one way in one frame and the other way in the next has smeared the texture, and is drawn to the
    middle: what is left of it is what is constant. Frames without pictures, or without a hull, stay as they are.
    """
    observation = clip.observation
    assert isinstance(observation, VolumeObservation)
    texture = texture_of(clip, observation, series.states)
    weight, method = observation.tools.settings.texture_weight, observation.tools.settings.method
    for row, frame in enumerate(clip.frames):
        prepared = observation.prepare(int(frame))
        evidence = None if prepared is None else observation.evidence(prepared)
        if evidence is None or evidence.hull.rays is None:
            continue
        state = evidence.refined_with(series.states[row], TextureProblem(texture, evidence.hull.rays, weight))
        fit = evidence.fit(state)
        series.states[row] = state
        series.fit_covariance[row] = fit_covariance(
            evidence.tools.body, state, fit.information, method.deviation
        )
        series.misfit[row], series.unexplained[row] = fit.misfit, fit.unexplained
        series.log_likelihood[row] = fit.log_likelihood


def texture_of(clip: PersonClip, observation: VolumeObservation, states: Array) -> Texture:
    """The texture that the poses (T, D) of a clip teach, by frames spread over it."""
    n = observation.tools.settings.method.evidence.texture_frames
    rows = np.unique(np.linspace(0, len(states) - 1, n).astype(int))
    seen = []
    for row in rows:
        hull = observation.hull_of(int(clip.frames[row]))
        if hull is not None and hull.rays is not None:
            seen.append((hull.rays(), states[row]))
    return learnt_texture(observation.tools.body, seen)
