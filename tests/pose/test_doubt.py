"""Doubt: what is uncertain, unseen, jumps or fits badly is worth looking at, and what is as usual is not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mocap.body import load_body_model, neutral_state, scale_body
from mocap.body.initial import HeightEstimate
from mocap.pose.doubt import doubts_of, doubts_of_all
from mocap.pose.method import DoubtSettings
from mocap.pose.result import PersonPoses

FPS, N = 30.0, 60
WRIST, ANKLE = 5, 11


def calm(person: int = 1) -> PersonPoses:
    """Somebody who stands, seen well."""
    body = scale_body(load_body_model("anthropometric"), 1.7)
    return PersonPoses(
        person=person,
        body=body,
        height=HeightEstimate(1.7, True),
        frames=np.arange(100, 100 + N),
        states=np.tile(neutral_state(body), (N, 1)),
        landmarks=np.ones((N, 15, 3)),
        landmark_covariance=np.tile(0.02**2 * np.eye(3), (N, 15, 1, 1)),
        observed=np.ones((N, 15), dtype=np.bool_),
        log_likelihood=np.full(N, -4.0),
        ess_share=np.full(N, 0.5),
        start_frame=100,
        first_pose="stand",
    )


def test_nothing_stands_out_of_what_is_as_usual() -> None:
    assert doubts_of(calm(), FPS, DoubtSettings()) == []
    empty = replace(
        calm(),
        frames=np.zeros(0, dtype=np.int64),
        landmarks=np.zeros((0, 15, 3)),
        landmark_covariance=np.zeros((0, 15, 3, 3)),
        observed=np.zeros((0, 15), dtype=np.bool_),
        log_likelihood=np.zeros(0),
    )
    assert doubts_of(empty, FPS, DoubtSettings()) == []


def test_each_reason_is_named_where_it_is() -> None:
    poses = calm()
    poses.landmarks[10:13, WRIST] += (0.0, 0.0, 0.9)
    poses.observed[20:24, 6:15] = False
    poses.landmark_covariance[30, ANKLE] = 0.4**2 * np.eye(3)
    poses.log_likelihood[40] = -30.0
    poses.log_likelihood[50:52] = np.nan
    found = sorted(doubts_of(poses, FPS, DoubtSettings()), key=lambda doubt: doubt.frames.start)
    told = [(doubt.frames, doubt.reasons[0]) for doubt in found]
    assert told == [
        (range(109, 114), "left wrist jumps"),
        (range(120, 124), "right shoulder, right elbow, right wrist and others not observed"),
        (range(130, 131), "left ankle uncertain"),
        (range(140, 141), "the pose explains what was seen badly"),
        (range(150, 152), "nothing was seen of the person"),
    ]
    for doubt in found:
        assert doubt.worst in doubt.frames


def test_the_most_doubtful_person_and_frame_come_first() -> None:
    one, other = calm(1), calm(2)
    one.landmark_covariance[30, ANKLE] = 0.2**2 * np.eye(3)
    other.landmark_covariance[7, ANKLE] = 0.5**2 * np.eye(3)
    other.landmark_covariance[8, ANKLE] = 0.6**2 * np.eye(3)
    found = doubts_of_all([one, other], FPS, DoubtSettings())
    assert [(d.person, d.worst) for d in found] == [(2, 108), (1, 130)]
    assert found[0].value > found[1].value
