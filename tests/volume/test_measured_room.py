"""Clouds of depth cameras, and the room behind the people."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mocap.data.depth import DepthNoise
from mocap.volume.measured_room import cloud_of, still_reading, together, without_edges
from tests.volume.boxed_room import FLOOR, FURNITURE, camera_at, view_of

ROOM = (FLOOR, *FURNITURE)


def test_points_of_a_distorted_view_lie_on_the_boxes() -> None:
    view = view_of(camera_at("a", 35), ROOM)
    cloud = cloud_of(replace(view, depth_m=without_edges(view.depth_m, DepthNoise())))
    off = np.full(len(cloud.points), np.inf)
    for lower, upper in ROOM:
        outside = np.maximum(np.maximum(lower - cloud.points, cloud.points - upper), 0.0)
        off = np.minimum(off, np.linalg.norm(outside, axis=1))
    assert len(off) > 10_000
    assert off.max() < 1e-5  # float32 of 4 m
    assert len(together([cloud, cloud]).rgb) == 2 * len(off)
    assert len(together([]).points) == 0


def test_a_reading_between_a_thing_and_what_is_behind_it_is_left_out() -> None:
    depth = np.full((24, 32), 4.0, dtype=np.float32)
    depth[:, 16:] = 2.0
    depth[10, 15] = 3.1
    clear = without_edges(depth, DepthNoise())
    assert clear[10, 15] == 0
    assert (clear[:, :13] == 4.0).all()
    assert (clear[:, 19:] == 2.0).all()
    floor = np.tile(np.linspace(4.0, 3.0, 24, dtype=np.float32)[:, None], (1, 32))
    assert (without_edges(floor, DepthNoise()) > 0).all()


def test_who_walks_by_vanishes_and_who_stays_does_not() -> None:
    looks = np.full((9, 24, 32), 4.0, dtype=np.float32)
    for k in range(9):
        looks[k, :, 3 * k : 3 * k + 4] = 2.0
    looks[:5, 5, 5] = 0.0  # fewer than half have a reading
    looks[:4, 6, 31] = 0.0
    looks[:, 7, 30] = 1.5
    room = still_reading(list(looks))
    assert room[5, 5] == 0
    assert room[7, 30] == 1.5
    room[5, 5], room[7, 30] = 4.0, 4.0
    assert (room == 4.0).all()
    with pytest.raises(ValueError, match="maps"):
        still_reading([])
