"""The table of furnished rooms: who is hidden from everybody, and means over seeds."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from eval.occlusion import DEVELOPMENT, TEST, hidden_landmarks, means
from mocap.data import LANDMARKS, Motion
from mocap.io.tables import write_landmarks_csv
from mocap.synth import load_scene

VISIBLE, OWN_BODY, OTHER, FURNITURE, OUTSIDE = 0, 1, 2, 3, 4


def _motion(n: int, **more: np.ndarray) -> Motion:
    places = np.random.default_rng(1).normal(size=(n, len(LANDMARKS), 3))
    return Motion(person=3, frames=np.arange(n), time_s=np.arange(n) / 10.0, landmarks=places, **more)


def test_hidden_from_all_is_hidden_by_others_not_by_oneself(tmp_path: Path) -> None:
    n = 4
    (tmp_path / "truth" / "views").mkdir(parents=True)
    states = np.full((2, n, 1, len(LANDMARKS)), VISIBLE)
    states[0, 1, 0, :] = FURNITURE  # frame 1: hidden from the first camera
    states[1, 1, 0, :3] = (
        OTHER,
        OUTSIDE,
        OWN_BODY,
    )  # and from the second two of fifteen, one more by the own body
    states[:, 2, 0, 7] = FURNITURE  # frame 2: one landmark
    for camera, own in enumerate(states):
        np.savez(
            tmp_path / "truth" / "views" / f"cam_{camera}.npz", landmark_state=own, persons=np.array([3])
        )
    write_landmarks_csv(tmp_path / "truth" / "landmarks.csv", [_motion(n)])
    observed = np.ones((n, len(LANDMARKS)), dtype=np.bool_)
    observed[1, 0] = False
    found = _motion(n, observed=observed, std=np.full((n, len(LANDMARKS), 3), 0.02))
    write_landmarks_csv(tmp_path / "landmarks.csv", [found])
    assert hidden_landmarks(tmp_path, tmp_path) == (3, 2, 100.0)


def test_a_truth_that_does_not_say_who_sees_what(tmp_path: Path) -> None:
    assert hidden_landmarks(tmp_path, tmp_path) == (None, None, None)


def test_means_are_over_seeds() -> None:
    row = {"session": "a", "occluders": "learn", "silent_errors": 1}
    scores = ("mean_error_mm", "mean_error_after_offset_mm", "mmta_percent", "coverage_90_percent")
    rows = [{**row, "seed": k, **dict.fromkeys(scores, 10.0 + k)} for k in range(3)]
    (line,) = means(rows)
    assert line.startswith("a learn: mean_error_mm 11.0, ")
    assert line.endswith("silent_errors 1.0")
    assert len(means([*rows, {**rows[0], "occluders": "ignore"}])) == 2


def test_development_and_test_are_apart() -> None:
    scenes = [load_scene(name) for name in (*DEVELOPMENT, *TEST)]
    seeds = [seed for scene in scenes for seed in (scene.seed, *(person.seed for person in scene.persons))]
    assert len(set(seeds)) == len(seeds)
    assert all(scene.room.furniture for scene in scenes)
