"""Hands and feet that move: what hangs bent does not turn the forearm or the shank that carries it."""

from __future__ import annotations

import numpy as np
import pytest
from flesh_voxels import Flesh, make_flesh

from mocap.body import landmarks_of, load_body_model, neutral_state, scale_body
from mocap.data import LANDMARKS
from mocap.likelihood.residuals import BodyFit, SurfaceFitSettings, SurfaceProblem, hull_surface
from mocap.pose.volume import pack_volume

HEIGHT_M, VOXEL_M = 1.75, 0.02
MOVED = [LANDMARKS.index(name) for name in ("left_wrist", "right_ankle")]
# A hand that hangs bent to the side, further than it could if forearms pronated, and a foot that points down.
BENT = {"left_wrist_z": 0.8, "left_wrist_x": 0.4, "right_ankle_y": 0.5}


def test_a_hand_bends_as_far_to_any_side() -> None:
    """Forearms do not pronate: which of its two angles is flexion is open."""
    body = scale_body(load_body_model("whole"), HEIGHT_M)
    columns = [i for i, name in enumerate(body.layout.names) if "wrist" in name]
    assert len(columns) == 4
    for values in (body.layout.upper, -body.layout.lower, body.usual_std):
        np.testing.assert_array_equal(values[columns], values[columns[0]])


@pytest.fixture(scope="module")
def truth() -> tuple[Flesh, np.ndarray]:
    flesh = make_flesh("whole", HEIGHT_M, VOXEL_M)
    state = neutral_state(flesh.body)
    for name, angle in BENT.items():
        state[flesh.body.layout.names.index(name)] = angle
    return flesh, state


def errors_mm(name: str, truth: tuple[Flesh, np.ndarray]) -> np.ndarray:
    """Distances (15,) of the landmarks of a body that was moved onto the hull of the true flesh."""
    of, state = truth
    flesh = make_flesh(name, HEIGHT_M, VOXEL_M)
    hull = of.hull(state)
    surface = hull_surface(hull.voxels, hull.is_surface, of.grid, pack_volume(of.grid, hull, 1.0))
    fit = BodyFit(
        SurfaceProblem(flesh.body, flesh.table, surface, SurfaceFitSettings()),
        None,
        usual_weight=1.0 / 90_000.0,
    )
    start = neutral_state(flesh.body)
    start[:3] = state[:3]
    std = np.where(flesh.body.is_position, 0.1, 0.5)
    (found,) = fit.descended(start[None], prior_std=std, residual_std_m=1.0, n_iterations=40, tolerance=1e-6)
    both = landmarks_of(flesh.body, found[None])[0, :15], landmarks_of(of.body, state[None])[0, :15]
    return 1000.0 * np.linalg.norm(both[0] - both[1], axis=1)


def test_a_bent_hand_does_not_turn_its_forearm(truth: tuple[Flesh, np.ndarray]) -> None:
    whole, girdle = errors_mm("whole", truth), errors_mm("girdle", truth)
    assert np.all(whole[MOVED] < 0.6 * girdle[MOVED])
