"""Front and back where the volumes hardly tell them apart: the way that the person goes decides.

In the trial of two first poses, and later by a restart.
"""

import os
import time
from collections.abc import Iterator, Sequence
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from flesh_voxels import Flesh

from mocap.body import neutral_state
from mocap.filters import ParticleState
from mocap.forks import can_fork, shared_zeros
from mocap.pipeline.config import LikelihoodConfig, PoseConfig
from mocap.pipeline.pose_settings import make_tools
from mocap.pose import follow, person
from mocap.pose.evidence import PersonTools
from mocap.pose.follow import Candidate, OnePose
from mocap.pose.method import RestartSettings
from mocap.pose.person import VolumeClip, choose_hypothesis
from mocap.pose.restart import FallenEvidence
from mocap.pose.start import FirstPose
from mocap.pose.volume import VolumeObservation

FPS = 30.0
N_FRAMES = 40
EVIDENCE = -100.0


def clip_of(flesh: Flesh, speed_m_s: float) -> VolumeClip:
    """A person who goes along +y."""
    tools = make_tools(flesh.grid, FPS, 1.74, "anthropometric", PoseConfig(), LikelihoodConfig(), 1)
    xyz = np.zeros((N_FRAMES, 3))
    xyz[:, 1] = speed_m_s * np.arange(N_FRAMES) / FPS
    return VolumeClip(1, np.arange(N_FRAMES), xyz, VolumeObservation(tools, lambda frame: None))


def facing(clip: VolumeClip, yaw: float, log_likelihood: float) -> FirstPose:
    state = neutral_state(clip.observation.tools.body)
    state[clip.observation.tools.body.yaw_column] = yaw
    return FirstPose(20, state, "stand", log_likelihood)


@pytest.fixture
def like_each_other(monkeypatch: pytest.MonkeyPatch) -> None:
    """Every pose stays as it began, and is worth the same but for a nat that the one facing -y gains."""

    def follow(
        clip: VolumeClip, order: Sequence[int], first: np.ndarray, *, seed: int, stage: str
    ) -> Iterator[SimpleNamespace]:
        gain = 1.0 if first[clip.observation.tools.body.yaw_column] < 0 else 0.0
        for row in order:
            yield SimpleNamespace(row=row, state=first, evidence=EVIDENCE + gain)

    monkeypatch.setattr(person, "follow_pose", follow)


@pytest.mark.parametrize(
    ("speed_m_s", "ahead", "lost"),
    [
        (1.2, True, 16.0),  # facing_nats, twice, of who faces straight against his way
        (0.1, False, 0.0),
    ],
)
def test_who_walks_faces_the_way_that_he_goes(
    coarse_flesh: Flesh, like_each_other: None, speed_m_s: float, ahead: bool, lost: float
) -> None:
    clip = clip_of(coarse_flesh, speed_m_s)
    hypotheses = [facing(clip, -np.pi / 2, -50.0), facing(clip, np.pi / 2, -60.0)]
    best, values = choose_hypothesis(clip, hypotheses, seed=0)
    assert best is hypotheses[1 if ahead else 0]
    np.testing.assert_allclose(values, [EVIDENCE + 1.0 - lost, EVIDENCE])


@pytest.mark.parametrize(
    ("settled", "decides"), [((-60.0, -86.0), True), ((-60.0, -84.0), False), ((-180.0, -217.0), False)]
)
def test_one_frame_decides_by_how_well_it_is_explained(
    coarse_flesh: Flesh, like_each_other: None, settled: tuple[float, float], decides: bool
) -> None:
    """25 nats are much where little is unexplained; where legs are missing seconds have to tell."""
    clip = clip_of(coarse_flesh, 0.1)
    hypotheses = [facing(clip, np.pi / 2, settled[0]), facing(clip, -np.pi / 2, settled[1])]
    best, values = choose_hypothesis(clip, hypotheses, seed=0)
    assert best is hypotheses[0 if decides else 1]
    assert len(values) == (1 if decides else 2)


@pytest.mark.skipif(not can_fork(), reason="processes are forked on Linux alone")
@pytest.mark.parametrize("n_threads", [1, 2, 8])
def test_the_ways_of_a_trial_are_gone_side_by_side(
    coarse_flesh: Flesh, monkeypatch: pytest.MonkeyPatch, n_threads: int
) -> None:
    """Each with its share of the threads; both ways count, the one on which the evidence is as good as the row."""
    by = shared_zeros((4,), np.int64)

    def follow(
        clip: VolumeClip, order: Sequence[int], first: np.ndarray, *, seed: int, stage: str
    ) -> Iterator[SimpleNamespace]:
        assert (seed, stage) == (5, "trial")
        assert clip.observation.tools.n_threads == max(1, n_threads // 4)
        ahead = first[clip.observation.tools.body.yaw_column] > 0
        by[2 * ahead + (order.step < 0)] = os.getpid()  # type: ignore[attr-defined]
        time.sleep(0.05)  # so that others get their turn
        for row in order:
            yield SimpleNamespace(row=row, state=first, evidence=row + (1000.0 if ahead else 0.0))

    monkeypatch.setattr(person, "follow_pose", follow)
    clip = clip_of(coarse_flesh, 0.0)
    tools = replace(clip.observation.tools, n_threads=n_threads)
    clip = replace(clip, observation=clip.observation.with_tools(tools))
    hypotheses = [facing(clip, -np.pi / 2, -50.0), facing(clip, np.pi / 2, -60.0)]
    best, values = choose_hypothesis(clip, hypotheses, seed=5)
    rows = [*range(20, 40, 3), *range(20, -1, -3)]
    assert best is hypotheses[1]
    np.testing.assert_allclose(values, [np.mean(rows), 1000.0 + np.mean(rows)])
    assert len(set(by.tolist())) == min(n_threads, 4)


@pytest.mark.parametrize(
    ("speed_m_s", "yaw", "is_restarted"),
    [(1.2, -np.pi / 2, True), (1.2, np.pi / 2, False), (1.2, 0.1, False), (0.1, -np.pi / 2, False)],
)
def test_who_faces_against_his_way_is_looked_for_anew(
    coarse_flesh: Flesh, monkeypatch: pytest.MonkeyPatch, speed_m_s: float, yaw: float, is_restarted: bool
) -> None:
    clip = clip_of(coarse_flesh, speed_m_s)
    now = Candidate(facing(clip, yaw, 0.0).state, value=EVIDENCE)
    found = Candidate(facing(clip, np.pi / 2, 0.0).state, value=EVIDENCE)
    policy = OnePose(clip, 0, now.state)
    policy.carry(20, None)
    monkeypatch.setattr(policy, "_restarted", lambda now, rng: found)
    assert policy.restart([now], np.random.default_rng(0)) == [found if is_restarted else now]


def test_who_goes_backwards_is_asked_less_and_less() -> None:
    numbers = RestartSettings()
    loss = FallenEvidence(numbers)
    assert loss.is_due(0, EVIDENCE, is_backwards=True)
    assert not loss.is_due(0, EVIDENCE, is_backwards=False)
    assert not loss.settle(0, EVIDENCE, EVIDENCE + 0.9 * numbers.margin_nats)
    pause = 2 * numbers.shortest_pause_frames
    assert [loss.is_due(row, EVIDENCE, is_backwards=True) for row in (pause - 1, pause)] == [False, True]


def test_what_earlier_frames_said_of_the_two_ways_counts() -> None:
    numbers = RestartSettings()
    clear, slight = numbers.most_lead_nats, 2 * numbers.margin_nats
    loss = FallenEvidence(numbers)
    assert not loss.settle(0, EVIDENCE, EVIDENCE - clear, likelier=16.0, is_turned=True)
    assert not loss.settle(2, EVIDENCE, EVIDENCE + slight, likelier=16.0, is_turned=True)
    assert loss.settle(4, EVIDENCE, EVIDENCE + slight, is_turned=False)  # a pose that faces as before
    fresh = FallenEvidence(numbers)
    assert fresh.settle(0, EVIDENCE, EVIDENCE - slight, likelier=16.0, is_turned=True)  # the way decides
    # What the pose before it had gained is not held against who turns back.
    assert fresh.settle(2, EVIDENCE, EVIDENCE + 1.5 * numbers.margin_nats, is_turned=True)


def test_the_way_counts_once() -> None:
    """Who is followed against it leads by what the evidence says alone."""
    loss = FallenEvidence(RestartSettings())
    taken = [
        loss.settle(row, EVIDENCE, EVIDENCE - lost, likelier=16.0, is_turned=True)
        for row, lost in ((0, 14), (2, 5))
    ]
    assert taken == [False, False]


def test_who_was_followed_the_wrong_way_round_turns_in_the_second_clear_frame() -> None:
    numbers = RestartSettings()
    clear = numbers.most_lead_nats
    loss = FallenEvidence(numbers)
    for row in range(5):
        assert not loss.settle(row, EVIDENCE, EVIDENCE - clear, is_turned=True)
    taken = [loss.settle(row, EVIDENCE, EVIDENCE + clear, is_turned=True) for row in (5, 6)]
    assert taken == [False, True]
    # What was said of the other way is forgotten with the turn.
    assert loss.settle(7, EVIDENCE, EVIDENCE + 2 * numbers.margin_nats, is_turned=True)


class Seen:
    """A frame that likes somebody who walks backwards better, by so many nats."""

    search = None
    n_cameras = 7

    def __init__(self, tools: PersonTools, gain: float) -> None:
        self.tools, self.gain = tools, gain

    def evidence(self, states: np.ndarray) -> np.ndarray:
        backwards = states[:, self.tools.body.yaw_column] < 0
        return np.asarray(EVIDENCE + self.gain * backwards)


@pytest.mark.parametrize(
    ("gains", "has_returned", "turns"),
    [
        ([50.0, 10.0], False, [False, False]),
        ([10.0], False, [True]),
        ([14.0], False, [False]),
        ([14.0], True, [True]),  # who was away may face any way
        ([50.0, 14.0], True, [False, True]),
    ],
)
def test_a_turn_that_one_frame_allows_is_not_made_after_one_that_did_not(
    coarse_flesh: Flesh,
    monkeypatch: pytest.MonkeyPatch,
    gains: list[float],
    has_returned: bool,
    turns: list[bool],
) -> None:
    """Somebody walks along +y backwards."""
    clip = clip_of(coarse_flesh, 1.2)
    now, found = (facing(clip, yaw, 0.0) for yaw in (-np.pi / 2, np.pi / 2))
    monkeypatch.setattr(follow, "restarted_pose", lambda *given, rng: found.state)
    monkeypatch.setattr(follow, "try_first_poses", lambda search, rng: [now])
    monkeypatch.setattr(follow, "settle_first_poses", lambda search, tried, rng: [found, *tried])
    monkeypatch.setattr(
        follow, "initial_particles", lambda *given: ParticleState(now.state[None], np.ones(1))
    )
    policy = OnePose(clip, 0, now.state)
    taken = []
    for row, gain in zip((20, 30), gains, strict=False):
        policy.carry(row, Seen(clip.observation.tools, gain))
        policy._has_returned = has_returned
        value = EVIDENCE + gain
        (settled,) = policy.restart([Candidate(now.state, value=value)], np.random.default_rng(0))
        taken.append(settled.state is found.state)
        assert settled.value == (EVIDENCE if taken[-1] else value)
    assert taken == turns
