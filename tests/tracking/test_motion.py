"""Motion between frames in closed form: a velocity that fades, and what an observation changes."""

import numpy as np
import pytest
from bodies import settings

from mocap.tracking.motion import FADE_S, observe, place_covariance, predict, start_motion
from mocap.tracking.state import Track

FPS = 20.0


def walking():
    s = settings(tracker="particle", fps=FPS, motion="velocity")
    track = Track(1, np.array([1.0, 2.0, 0.9]), "confirmed", 0)
    return s, track.replace(
        velocity=np.array([1.0, -0.5, 0.1]), motion=start_motion(s), samples=np.zeros((2, 3))
    )


def test_a_velocity_fades():
    """x(t) = x + tau (1 - exp(-t / tau)) v: after a long time the person stands tau v further."""
    s, track = walking()
    for n in (1, 7, 400):
        t = n / FPS
        moved = predict(track, n, s)
        way = FADE_S * (1.0 - np.exp(-t / FADE_S)) * track.velocity
        np.testing.assert_allclose(moved.xyz, track.xyz + way)
        np.testing.assert_allclose(moved.samples, np.tile(way, (2, 1)))
        np.testing.assert_allclose(moved.velocity, np.exp(-t / FADE_S) * track.velocity)
        assert moved.motion[0, 0] > track.motion[0, 0]
    assert predict(track.replace(misses=1), 7, s).xyz[2] == track.xyz[2], "nobody sinks out of sight"


def test_an_observation_turns_the_velocity_by_the_gain():
    s, track = walking()
    before = predict(track, 3, s)
    seen = before.xyz + np.array([0.1, 0.0, 0.0])
    after = observe(before, seen, place_covariance(s), s)
    variance = place_covariance(s)[0, 0]
    gain = before.motion[1, 0] / (before.motion[0, 0] + variance)
    np.testing.assert_array_equal(after.xyz, seen)
    np.testing.assert_allclose(after.velocity, before.velocity + gain * (seen - before.xyz))
    assert after.motion[1, 1] == pytest.approx(before.motion[1, 1] - gain * before.motion[0, 1])
