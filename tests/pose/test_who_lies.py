"""Who lies, is on hands and knees or turns over: the first pose, and which way he faces."""

from collections.abc import Sequence

import numpy as np
import pytest
from flesh_voxels import make_flesh

from mocap.body import Body, neutral_state
from mocap.body.initial import HeightEstimate, candidate_states
from mocap.body.kinematics import facing_of, joint_transforms
from mocap.filters import ParticleState
from mocap.pipeline.config import LikelihoodConfig, PoseConfig
from mocap.pipeline.pose_settings import make_tools
from mocap.pose import person, restart
from mocap.pose.deviation import FrameSeries, within_limits
from mocap.pose.follow import OnePose
from mocap.pose.method import StartSettings
from mocap.pose.person import Start, VolumeClip, start_person
from mocap.pose.restart import restarted_pose
from mocap.pose.start import (
    FirstPose,
    PoseSearch,
    _in_turn,
    against_walking,
    faces_other_way,
    settle_first_poses,
    try_first_poses,
)
from mocap.pose.volume import PersonHull, VolumeObservation

HEIGHT_M = 1.72
FLESH = make_flesh("whole", HEIGHT_M, 0.03)
BODY = FLESH.body


def turned(yaw: float = 0.0, pitch: float = 0.0, roll: float = 0.0) -> np.ndarray:
    state = neutral_state(BODY)
    state[3:6] = yaw, pitch, roll
    return state


def lying(kind: str, yaw: float) -> np.ndarray:
    flat = np.random.default_rng(0).uniform([-0.8, -0.8, 0], [0.8, 0.8, 0.3], (400, 3))
    states, labels = candidate_states(BODY, flat, np.array([yaw]))
    state = states[labels.index(kind)]
    state[BODY.layout.names.index("right_knee_y")] += 0.4
    return state


def turn_between(body: Body, a: np.ndarray, b: np.ndarray) -> float:
    """Angle between the pelvis of two poses, rad."""
    one, two = joint_transforms(body, np.stack([a, b]))[0][:, 0]
    return float(np.arccos(np.clip((np.trace(one.T @ two) - 1) / 2, -1, 1)))


@pytest.mark.parametrize(
    ("kind", "yaw"), [("prone", 0.5), ("supine", 2.1), ("on_left_side", -1.0), ("all_fours", 1.2)]
)
def test_the_first_pose_of_who_lies_has_head_and_belly_where_they_are(kind: str, yaw: float) -> None:
    truth = lying(kind, yaw)
    hull = FLESH.hull(truth, margin_m=0.02)
    quick = PoseConfig(n_start_frames=1, n_first_poses=4, outline_weight=0)
    tools = make_tools(FLESH.grid, 30.0, HEIGHT_M, "whole", quick, LikelihoodConfig(), 1)
    clip = VolumeClip(1, np.arange(12), np.zeros((12, 3)), VolumeObservation(tools, lambda frame: hull))
    start = start_person(clip, HeightEstimate(HEIGHT_M, is_measured=False), seed=0)
    assert np.rad2deg(turn_between(BODY, start.first.state, truth)) < 35
    assert np.linalg.norm(start.first.state[:3] - truth[:3]) < 0.08


def test_the_size_of_who_never_stands_is_that_of_the_best_poses_of_the_clip(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A size that was fitted to a first pose which is off is put right, and everybody is followed once more."""
    truth = lying("supine", 0.4)
    hull = FLESH.hull(truth, margin_m=0.02)
    quick = PoseConfig(n_layers=2, n_particles=40, outline_weight=0, look_again=False, texture_weight=0)
    tools = make_tools(FLESH.grid, 12.5, 1.2 * HEIGHT_M, "whole", quick, LikelihoodConfig(), 1)
    observation = VolumeObservation(tools, lambda frame: hull)
    clip = VolumeClip(1, np.arange(4), np.zeros((4, 3)), observation)
    sizes = []

    def start(clip: VolumeClip, height: HeightEstimate, *, seed: int, is_size_fitted: bool) -> Start:
        first = FirstPose(1, truth, "supine", 0.0)
        return Start(clip.observation.tools, height, first, np.zeros(1), len(clip), is_size_fitted)

    def followed(clip: VolumeClip, first: FirstPose, **others: object) -> FrameSeries:
        sizes.append(clip.observation.tools.body.height_m)
        return real(clip, first, **others)

    real = person._followed
    monkeypatch.setattr(person, "start_person", start)
    monkeypatch.setattr(person, "_followed", followed)
    for is_measured, is_fitted, n in ((False, True, 2), (True, True, 1), (False, False, 1)):
        sizes.clear()
        height = HeightEstimate(1.2 * HEIGHT_M, is_measured=is_measured)
        found = person.follow_frames(clip, height, seed=0, is_size_fitted=is_fitted)
        assert len(sizes) == n
        assert found.height.height_m == found.tools.body.height_m == sizes[-1]
        assert found.height.is_measured == is_measured
        assert sizes[-1] == pytest.approx(HEIGHT_M if n == 2 else 1.2 * HEIGHT_M, rel=0.06)


@pytest.mark.parametrize("turns", [{"roll": 2.4}, {"pitch": -2.4}])
def test_a_body_is_refined_head_over_heels(turns: dict[str, float]) -> None:
    """A root that ended at 97 degrees lost whoever turned a cartwheel."""
    tools = make_tools(
        FLESH.grid, 30.0, HEIGHT_M, "whole", PoseConfig(outline_weight=0), LikelihoodConfig(), 1
    )
    truth, before = turned(**turns), turned(**{axis: 0.9 * angle for axis, angle in turns.items()})
    truth[2] = before[2] = 1.1
    hull = FLESH.hull(truth)
    observation = VolumeObservation(tools, lambda frame: hull)
    prepared = observation.prepare(0)
    assert prepared is not None
    found = observation.evidence(prepared).refined(before)
    assert np.rad2deg(turn_between(BODY, found, truth)) < 8


def test_two_poses_face_other_ways_about_any_axis() -> None:
    prone, supine = turned(pitch=1.5), turned(pitch=-1.5)
    assert faces_other_way(BODY, prone, supine)
    assert faces_other_way(BODY, prone, turned(yaw=np.pi, pitch=1.5))  # his head where his feet were
    assert not faces_other_way(BODY, prone, turned(yaw=0.6, pitch=1.2))
    for yaw, is_other in ((1.4, False), (1.8, True)):
        assert faces_other_way(BODY, turned(yaw=0.3), turned(yaw=0.3 + yaw)) == is_other
    # The same turn in other numbers.
    assert not faces_other_way(BODY, turned(), turned(yaw=np.pi, pitch=np.pi, roll=np.pi))


def test_who_has_turned_over_faces_where_his_front_is() -> None:
    states = [turned(0.4, 0.3), turned(0.4 + np.pi, np.pi, np.pi), turned(2.0, 0.7), turned(2.0, 1.4)]
    angle, is_level = facing_of(BODY, np.stack(states))
    np.testing.assert_allclose(angle[:3], [0.4, 0.4, 2.0])
    assert is_level.tolist() == [True, True, True, False]


def test_the_way_tells_nothing_of_who_lies() -> None:
    numbers = StartSettings()
    states = np.stack([turned(yaw=np.pi), turned(), turned(yaw=np.pi, pitch=np.pi / 2)])
    cost = against_walking(BODY, states, 0.0, numbers)
    np.testing.assert_allclose(cost, [2 * numbers.facing_nats, 0.0, 0.0], atol=1e-9)


class Stop(Exception):
    """Enough is known."""


def search_at(hull: PersonHull, n_first_poses: int) -> PoseSearch:
    settings = PoseConfig(n_first_poses=n_first_poses, outline_weight=0)
    tools = make_tools(FLESH.grid, 30.0, HEIGHT_M, "whole", settings, LikelihoodConfig(), 1)
    observation = VolumeObservation(tools, lambda frame: hull)
    prepared = observation.prepare(0)
    assert prepared is not None
    return PoseSearch(observation.evidence(prepared), 0, None)


def test_every_kind_of_lying_pose_is_followed(monkeypatch: pytest.MonkeyPatch) -> None:
    """By their likelihood alone those who lie on their backs would take all places."""
    followed: list[list[str]] = []

    def attempts(
        search: PoseSearch, starts: Sequence[tuple[ParticleState, str]], *others: object, **more: object
    ) -> list[FirstPose]:
        followed.append([label for _, label in starts])
        return [FirstPose(0, start.particles[0], label, -k) for k, (start, label) in enumerate(starts)]

    monkeypatch.setattr(PoseSearch, "attempts", attempts)
    search = search_at(FLESH.hull(lying("supine", 0.3), margin_m=0.02), 2)
    try_first_poses(search, rng=np.random.default_rng(0))
    assert len(set(followed[0])) == len(followed[0]) == 8
    tried = [FirstPose(0, turned(), label, -k) for k, label in enumerate("aaabbc")]
    search = search_at(FLESH.hull(lying("prone", 0.0)), 3)
    settle_first_poses(search, tried, rng=np.random.default_rng(0))
    assert followed[1] == ["a", "b", "c"]


def test_more_poses_are_followed_of_who_lies(monkeypatch: pytest.MonkeyPatch) -> None:
    asked = []

    def most_promising(clip: VolumeClip, rows: Sequence[int], *, seed: int) -> None:
        asked.append(clip.observation.tools.settings.n_first_poses)
        raise Stop

    monkeypatch.setattr(person, "_most_promising", most_promising)
    pose = PoseConfig(n_first_poses=2)
    tools = make_tools(FLESH.grid, 30.0, HEIGHT_M, "whole", pose, LikelihoodConfig(), 1)
    for state in (turned(), lying("prone", 0.0)):
        hull = FLESH.hull(state)
        observation = VolumeObservation(tools, lambda frame, hull=hull: hull)
        clip = VolumeClip(1, np.arange(12), np.zeros((12, 3)), observation)
        with pytest.raises(Stop):
            start_person(clip, HeightEstimate(HEIGHT_M, is_measured=False), seed=0)
    assert asked == [2, 6]


def test_who_has_turned_over_is_looked_for_where_his_front_is(monkeypatch: pytest.MonkeyPatch) -> None:
    asked = []

    def candidates(body: Body, places: np.ndarray, yaws: np.ndarray) -> None:
        asked.append(float(yaws[0]))
        raise Stop

    monkeypatch.setattr(restart, "candidate_states", candidates)
    search = search_at(FLESH.hull(turned()), 2)
    with pytest.raises(Stop):
        restarted_pose(search, turned(0.4 + np.pi, np.pi, np.pi), None, rng=np.random.default_rng(0))
    assert asked == [pytest.approx(0.4)]


@pytest.mark.parametrize(("pitch", "is_backwards"), [(0.3, True), (1.4, False)])
def test_who_lies_never_faces_against_his_way(pitch: float, is_backwards: bool) -> None:
    tools = make_tools(FLESH.grid, 30.0, HEIGHT_M, "whole", PoseConfig(), LikelihoodConfig(), 1)
    xyz = np.zeros((20, 3))
    xyz[:, 0] = 0.05 * np.arange(20)  # 1.5 m/s along +x
    clip = VolumeClip(1, np.arange(20), xyz, VolumeObservation(tools, lambda frame: None))
    followed = OnePose(clip, 10, turned())
    followed._row = 10
    assert followed._faces_backwards(turned(yaw=np.pi, pitch=pitch)) == is_backwards
    assert not followed._faces_backwards(turned(pitch=pitch))


def test_nobody_is_less_sure_of_a_turn_than_anywhere_on_the_circle() -> None:
    unsure = 1e4 * np.eye(BODY.layout.n_columns)[None]
    std = np.sqrt(np.diagonal(within_limits(BODY.layout, unsure)[0]))
    np.testing.assert_allclose(std[3:6], 2 * np.pi / np.sqrt(12))


def test_every_kind_has_its_turn() -> None:
    assert _in_turn(["a", "a", "b", "a", "b", "c"]) == [0, 2, 5, 1, 4, 3]
