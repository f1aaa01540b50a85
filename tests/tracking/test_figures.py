"""Figures to persons: by geometry and over time, whatever order they come in."""

from __future__ import annotations

import numpy as np
import pytest
from keypoint_world import KeypointWorld, keypoint_world

from mocap.body.markers import marker_positions
from mocap.likelihood.markers import marker_views, undistort
from mocap.tracking.figures import FigurePerson, FigureSettings, FigureViews, View2D, persons_of_figures

FPS = 25.0


def found_in(
    world: KeypointWorld, *, kept: float = 1.0, cameras: tuple[int, ...] | None = None, mixed: bool = False
) -> tuple[list[FigurePerson], dict[int, list[View2D]], dict[int, list[int]]]:
    """Persons, figures and the true person of every figure.  kept : share of the figures.  mixed : a view gives one."""
    rng = np.random.default_rng(5)
    views = marker_views(world.rig)
    figures: dict[int, list[View2D]] = {}
    owner: dict[int, list[int]] = {}
    for f, frame in enumerate(world.figures):
        entries = [
            (View2D(c, undistort(world.rig[c], p[:, :2]), np.nan_to_num(p[:, 2])), k)
            for c, seen in enumerate(frame)
            if cameras is None or c in cameras
            for k, p in enumerate(seen)
            if rng.random() < kept and (not mixed or k == (f // 4 + c) % len(seen))
        ]
        order = rng.permutation(len(entries))
        figures[f] = [entries[i][0] for i in order]
        owner[f] = [entries[i][1] for i in order]
    return (
        persons_of_figures(figures, FigureViews(views.P, views.focal), FPS, FigureSettings()),
        figures,
        owner,
    )


@pytest.mark.parametrize("cameras", [None, (0, 1), (0, 1, 2)])
def test_two_persons_are_told_apart_from_two_cameras_on(cameras: tuple[int, ...] | None) -> None:
    world = keypoint_world(30, noise_px=1.0, apart_m=1.1)
    persons, _, owner = found_in(world, cameras=cameras)
    assert [p.number for p in persons] == [1, 2]
    for person in persons:
        whose = {owner[f][i] for f, chosen in person.views.items() for i in chosen if i >= 0}
        assert len(whose) == 1
        assert len(person.frames) == 30


def test_the_points_are_those_of_the_person() -> None:
    world = keypoint_world(12)
    ((person,), _, _) = found_in(world)
    truth = marker_positions(world.body, world.markers, world.states[0])
    for f in person.frames:
        np.testing.assert_allclose(person.points[f], truth[f], atol=1e-6)


def test_views_that_show_one_of_two_persons_in_turn_follow_both() -> None:
    """As a detector does that gives one person per picture."""
    world = keypoint_world(60, noise_px=1.0, apart_m=1.1)
    persons, _, owner = found_in(world, mixed=True)
    assert len(persons) == 2
    for person in persons:
        whose = [owner[f][i] for f, chosen in person.views.items() for i in chosen if i >= 0]
        assert len(set(whose)) == 1


def test_half_of_the_figures_missing_is_no_new_person() -> None:
    persons, _, _ = found_in(keypoint_world(40, noise_px=1.0), kept=0.5)
    assert len(persons) == 1
    assert len(persons[0].frames) > 20


def test_two_persons_who_leave_together_are_still_two() -> None:
    """As many frames of both, and then nobody for longer than a person may be lost."""
    world = keypoint_world(20, noise_px=1.0, apart_m=1.1)
    _, figures, _ = found_in(world)
    figures |= {f: [] for f in range(20, 80)}
    views = marker_views(world.rig)
    persons = persons_of_figures(figures, FigureViews(views.P, views.focal), FPS, FigureSettings())
    assert [(p.number, p.frames[-1]) for p in persons] == [(1, 19), (2, 19)]


def test_one_camera_makes_nobody() -> None:
    persons, _, _ = found_in(keypoint_world(12), cameras=(1,))
    assert persons == []


def test_the_order_of_the_figures_does_not_matter() -> None:
    world = keypoint_world(20, noise_px=1.0, apart_m=1.1)
    views = marker_views(world.rig)
    _, figures, _ = found_in(world)
    turned = {f: seen[::-1] for f, seen in figures.items()}
    results = [
        persons_of_figures(one, FigureViews(views.P, views.focal), FPS, FigureSettings())
        for one in (figures, turned)
    ]
    assert len(results[0]) == len(results[1]) == 2
    a = sorted(float(np.nanmean(p.points[5][:, 1])) for p in results[0])
    b = sorted(float(np.nanmean(p.points[5][:, 1])) for p in results[1])
    assert a == pytest.approx(b, abs=1e-9)
