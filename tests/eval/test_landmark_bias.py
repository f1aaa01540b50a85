"""The parts of an error: what is constant on a segment, and what is not."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from eval.landmark_bias import rows_of
from mocap.body import landmarks_of, load_body_model, neutral_state, scale_body
from mocap.data.motion import LANDMARKS, Motion
from mocap.pose.result import PersonPoses

BODY = scale_body(load_body_model("girdle"), 1.75)
T = 60


def swinging() -> np.ndarray:
    """States of somebody who turns on the spot and swings both arms, (T, D)."""
    states = np.tile(neutral_state(BODY), (T, 1))
    names = BODY.layout.names
    states[:, names.index("root_yaw")] = np.linspace(0.0, 2.0, T)
    for side in ("left", "right"):
        states[:, names.index(f"{side}_shoulder_z")] += 0.4 * np.sin(np.arange(T) / 6.0)
    return states


def rows(landmarks: np.ndarray, truth: np.ndarray) -> dict[str, dict[str, Any]]:
    frames = np.arange(T)
    poses = SimpleNamespace(frames=frames, landmarks=landmarks, states=swinging(), body=BODY)
    motion = Motion(1, frames, frames / 30.0, truth)
    person, found = rows_of(cast(PersonPoses, poses), [motion])
    assert person == 0
    return {row["landmark"]: row for row in found}


def test_a_joint_elsewhere_on_its_segment_is_bias_alone() -> None:
    landmarks = landmarks_of(BODY, swinging())
    moved = BODY.landmark_offset.copy()
    moved[LANDMARKS.index("left_wrist"), 1] += 0.02
    moved[LANDMARKS.index("right_wrist"), 1] -= 0.02
    truth = landmarks_of(replace(BODY, landmark_offset=moved), swinging())
    found = rows(landmarks, truth)
    assert found["wrist"]["bias_mm"] == pytest.approx(20.0)
    assert found["wrist"]["rest_mm"] == pytest.approx(0.0, abs=1e-6)
    assert found["elbow"]["raw_mm"] == pytest.approx(0.0, abs=1e-6)
    # In the trunk's frame, which does not swing with the arms, an offset of the first frames is not enough.
    assert found["all"]["after_offset_mm"] > 0.3


def test_trembling_is_fast_and_no_bias() -> None:
    landmarks = landmarks_of(BODY, swinging())
    truth = landmarks.copy()
    truth[::2, LANDMARKS.index("head"), 2] += 0.01
    truth[1::2, LANDMARKS.index("head"), 2] -= 0.01
    found = rows(landmarks, truth)
    assert found["head"]["raw_mm"] == pytest.approx(10.0)
    assert found["head"]["bias_mm"] < 0.5
    assert found["head"]["fast_mm"] > 8.0
    assert found["knee"]["rest_mm"] == pytest.approx(0.0, abs=1e-6)
