"""The stage that learns what stands in front of people: cameras that see nobody, and settings that switch it off."""

from __future__ import annotations

import numpy as np

from mocap.pipeline.stages.occluders import idle_cameras


def test_a_camera_that_sees_only_furniture_is_idle() -> None:
    share = np.full((20, 5), 0.02)
    share[:, 3] = 0.0
    share[4, 3] = 0.01  # once
    np.testing.assert_array_equal(idle_cameras(share), [False, False, False, True, False])


def test_nobody_is_idle_while_nobody_is_there() -> None:
    share = np.zeros((20, 5))
    share[:, 0] = 0.02  # one camera sees a curtain move
    assert not idle_cameras(share).any()


def test_who_is_hidden_for_a_while_is_not_idle() -> None:
    share = np.full((20, 5), 0.02)
    share[5:, 1] = 0.0
    assert not idle_cameras(share).any()
    assert not idle_cameras(share[:3]).any()
