"""Whom one camera alone shows: walkers are put where their feet stand, and all else is nobody."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from keypoint_world import KeypointWorld, keypoint_world
from marker_world import FPS

from mocap.data import LANDMARKS
from mocap.likelihood.markers import marker_views, undistort
from mocap.tracking.figures import FigurePerson, FigureSettings, FigureViews, View2D, persons_of_figures
from mocap.tracking.lone import lone_persons

N = 40
# Feet are a few centimetres off the middle of a person, and ankles in the air a little further.
PLACE_M = 0.15


@pytest.fixture(scope="module")
def world() -> KeypointWorld:
    """Camera 0 shows the second of two persons, the others show the first."""
    return keypoint_world(N, noise_px=2.0, apart_m=1.1)


def figures_of(world: KeypointWorld) -> dict[int, list[View2D]]:
    return {
        f: [
            View2D(c, undistort(world.rig[c], p[:, :2]), np.nan_to_num(p[:, 2]))
            for c, p in enumerate(seen[int(c == 0)] for c, seen in enumerate(frame))
        ]
        for f, frame in enumerate(world.figures)
    }


def alone(figures: dict[int, list[View2D]], world: KeypointWorld) -> dict[int, FigurePerson]:
    own = marker_views(world.rig)
    views = FigureViews(own.P, own.focal)
    persons = persons_of_figures(figures, views, FPS, FigureSettings())
    assert len(persons) == 1
    return lone_persons(figures, persons, [0], views, FPS)


def test_a_walker_stands_where_the_feet_do(world: KeypointWorld) -> None:
    found = alone(figures_of(world), world)
    assert list(found) == [0]
    person = found[0]
    assert person.number == 2
    assert len(person.frames) > 0.9 * N
    truth = world.landmarks[1][person.frames, LANDMARKS.index("pelvis"), :2]
    places = np.array([np.nanmean(person.points[f][:, :2], axis=0) for f in person.frames])
    assert np.median(np.linalg.norm(places - truth, axis=1)) < PLACE_M
    assert all((views >= 0).tolist() == [True, False, False, False] for views in person.views.values())


def test_who_stays_in_place_may_be_a_picture(world: KeypointWorld) -> None:
    figures = figures_of(world)
    still = figures[0][0]
    assert alone({f: [still, *seen[1:]] for f, seen in figures.items()}, world) == {}


def test_keypoints_of_another_camera_are_nobody(world: KeypointWorld) -> None:
    """They come from somewhere else: no ray meets the floor, or who stands there grows and shrinks."""
    for change in (lambda uv: 0.5 * uv + [160.0, -60.0], lambda uv: 0.5 * uv + [160.0, 240.0]):
        figures = {f: [replace(s[0], uv=change(s[0].uv)), *s[1:]] for f, s in figures_of(world).items()}
        assert alone(figures, world) == {}


def test_who_is_known_is_not_found_twice(world: KeypointWorld) -> None:
    """A second figure of the first person, a hand's breadth beside the first."""
    figures = figures_of(world)
    for f, frame in enumerate(world.figures):
        known = View2D(0, undistort(world.rig[0], frame[0][0][:, :2]) + 12.0, np.full(len(frame[0][0]), 0.9))
        figures[f] = [replace(known, uv=known.uv - 12.0), *figures[f][1:], known]
    assert alone(figures, world) == {}
