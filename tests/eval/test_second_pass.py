"""A second pass: the joint step against a dense solution, and what is chosen among poses."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from eval import second_pass
from eval.second_pass import Clip, best_path, joint_step, most_evidence, nearest_to_truth
from mocap.body import landmarks_of, load_body_model, neutral_state, scale_body
from mocap.data import LANDMARKS

BODY = scale_body(load_body_model("girdle"), 1.75)
T, D = 7, 3


def test_the_joint_step_is_that_of_the_dense_system(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(second_pass, "DAMPING", 0.0)
    rng = np.random.default_rng(3)
    x, g = rng.normal(size=(2, T, D))
    half = rng.normal(size=(T, D, D))
    H = half @ half.transpose(0, 2, 1)
    H[3] = 0.0  # a frame of which nothing is known
    weight = np.array([0.5, 2.0, 30.0])
    change = np.zeros((T - 2, T))
    for row in range(T - 2):
        change[row, row : row + 3] = 1, -2, 1
    penalty = np.kron(change.T @ change, np.diag(weight))
    full = penalty.copy()
    for t in range(T):
        full[t * D : (t + 1) * D, t * D : (t + 1) * D] += H[t]
    expected = np.linalg.solve(full, -(g.ravel() + penalty @ x.ravel())).reshape(T, D)
    np.testing.assert_allclose(joint_step(x, H, g, weight), expected, atol=1e-5)


def clip(turns: list[list[float]], nats: list[list[float]], n_near: int, true: list[float]) -> Clip:
    """Somebody whose poses differ by how far the left arm is lifted, rad."""
    column = BODY.layout.names.index("left_shoulder_x")

    def states(lifts: list[float]) -> np.ndarray:
        out = np.tile(neutral_state(BODY), (len(lifts), 1))
        out[:, column] += lifts
        return out

    return Clip(
        one=cast(Any, SimpleNamespace(body=BODY)),
        fps=30.0,
        evidence=[None] * len(turns),
        smooth=states([0.0] * len(turns)),
        poses=[states(lifts) for lifts in turns],
        n_near=[n_near] * len(turns),
        nats=[np.array(own) for own in nats],
        true=landmarks_of(BODY, states(true))[:, : len(LANDMARKS)],
    )


def lifts(found: np.ndarray) -> list[float]:
    column = BODY.layout.names.index("left_shoulder_x")
    return np.round(found[:, column] - neutral_state(BODY)[column], 6).tolist()


def test_poses_from_around_and_of_other_seeds_are_kept_apart() -> None:
    one = clip([[0.0, 0.1, 0.2, 0.3]], [[0.0, 1.0, 2.0, 3.0]], 2, [0.1])
    assert lifts(one.chosen(most_evidence(one, "neighbours"))) == [0.2]
    assert lifts(one.chosen(most_evidence(one, "seeds"))) == [0.3]
    assert lifts(one.chosen(nearest_to_truth(one))) == [0.1]
    worse = clip([[0.0, 0.1, 0.2, 0.3]], [[9.0, 1.0, 2.0, 3.0]], 2, [0.1])
    for kind in ("neighbours", "seeds", "both"):
        assert lifts(worse.chosen(most_evidence(worse, kind))) == [0.0]


def test_the_best_path_leaves_out_what_one_frame_alone_would_have_elsewhere() -> None:
    frames = [[0.0, 1.2], [0.0, 1.2], [0.0, 1.2]]
    alone = clip(frames, [[1.0, 0.0], [1.0, 3.0], [1.0, 0.0]], 1, [0.0] * 3)
    assert lifts(alone.chosen(most_evidence(alone, "both"))) == [0.0, 1.2, 0.0]
    assert lifts(alone.chosen(best_path(alone))) == [0.0, 0.0, 0.0]
    lasting = clip(frames, [[1.0, 9.0], [1.0, 9.0], [1.0, 9.0]], 1, [0.0] * 3)
    assert lifts(lasting.chosen(best_path(lasting))) == [1.2, 1.2, 1.2]
