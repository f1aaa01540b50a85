"""The preference for usual postures."""

import numpy as np
import pytest

from mocap.body import Body, load_body_model, neutral_state, scale_body
from mocap.pose.posture import usual_posture


@pytest.fixture(params=["anthropometric", "girdle", "thesis", "whole"])
def body(request: pytest.FixtureRequest) -> Body:
    return scale_body(load_body_model(request.param), 1.73)


def swung(body: Body, rad: float) -> np.ndarray:
    state = neutral_state(body)
    state[body.layout.names.index("left_shoulder_x")] += rad
    return state


def test_the_neutral_pose_departs_by_nothing(body: Body) -> None:
    assert usual_posture(body).departure(neutral_state(body)[None])[0] == pytest.approx(0.0, abs=1e-12)


def test_one_arm_departs_by_one_less_its_cosine(body: Body) -> None:
    angles = np.array([0.3, 0.5 * np.pi, np.pi])
    states = np.stack([swung(body, a) for a in angles])
    np.testing.assert_allclose(usual_posture(body).departure(states), 1.0 - np.cos(angles), atol=1e-9)


def test_where_the_body_is_and_faces_does_not_matter(body: Body) -> None:
    state = swung(body, 1.1)
    moved = state.copy()
    moved[:6] += [2.0, -1.0, 0.3, 2.5, 0.4, -0.3]
    departure = usual_posture(body).departure(np.stack([state, moved]))
    assert departure[0] == pytest.approx(departure[1])


def test_legs_are_free(body: Body) -> None:
    sitting = neutral_state(body)
    for side in ("left", "right"):
        sitting[body.layout.names.index(f"{side}_hip_y")] = -1.5
        sitting[body.layout.names.index(f"{side}_knee_y")] = 1.5
    assert usual_posture(body).departure(sitting[None])[0] == pytest.approx(0.0, abs=1e-9)


def test_both_sides_count_alike(body: Body) -> None:
    left, right = neutral_state(body), neutral_state(body)
    names = body.layout.names
    left[names.index("left_shoulder_x")] += 0.8
    right[names.index("right_shoulder_x")] -= 0.8
    departure = usual_posture(body).departure(np.stack([left, right]))
    assert departure[0] == pytest.approx(departure[1])
