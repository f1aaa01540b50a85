"""The search for a first pose is bounded by work: poses that are scored, counted from the settings by hand."""

import numpy as np
import pytest
from flesh_voxels import Flesh

from mocap.body.initial import candidate_states
from mocap.pose.method import StartSettings
from mocap.pose.start import affordable_first_poses


def evaluations(settings: StartSettings, n_kinds: int, n_first_poses: int, n_frames: int) -> int:
    tried = n_kinds * settings.n_directions * settings.n_copies
    brief = settings.brief_factor * n_first_poses * settings.brief_layers * settings.brief_particles
    followed = n_first_poses + settings.n_opposite
    thorough = followed * settings.thorough_layers * settings.thorough_particles
    return n_frames * (tried + brief + thorough)


@pytest.fixture
def n_kinds(coarse_flesh: Flesh) -> int:
    return len(
        candidate_states(coarse_flesh.body, np.array([[0, 0, 0], [0, 0, 1.7], [0, 0, 1.7]]), np.zeros(1))[0]
    )


@pytest.mark.parametrize(("wanted", "n_frames"), [(8, 3), (24, 2), (24, 1), (30, 10)])
def test_as_many_poses_are_followed_as_the_evaluations_allow(
    wanted: int, n_frames: int, n_kinds: int
) -> None:
    settings = StartSettings()
    n = affordable_first_poses(settings, wanted, n_frames)
    assert evaluations(settings, n_kinds, n, n_frames) <= settings.max_evaluations
    assert n == wanted or evaluations(settings, n_kinds, n + 1, n_frames) > settings.max_evaluations


def test_the_usual_search_is_not_cut() -> None:
    assert affordable_first_poses(StartSettings(), 8, 3) == 8
    assert affordable_first_poses(StartSettings(), 24, 2) == 24
    assert affordable_first_poses(StartSettings(), 24, 3) < 24


def test_one_pose_is_followed_whatever_it_costs() -> None:
    assert affordable_first_poses(StartSettings(max_evaluations=1), 8, 3) == 1
