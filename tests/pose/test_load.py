"""What a person wears on the trunk: found in hulls, flesh while he is followed, no part of his body."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from flesh_voxels import make_flesh, rasterise

from mocap.body import Body, cones_of, joint_transforms, landmarks_of, neutral_state
from mocap.body.flesh import cone_distances
from mocap.body.model import Cones
from mocap.body.stretch import lengths_of, resize_body
from mocap.pipeline.config import LikelihoodConfig, PoseConfig
from mocap.pipeline.pose_settings import make_tools
from mocap.pose import person
from mocap.pose.deviation import FrameSeries
from mocap.pose.load import arms_alike, bare, find_load, laden, upper_trunk
from mocap.pose.method import LoadSettings
from mocap.pose.volume import PersonHull, VolumeObservation

HEIGHT_M = 1.7
FLESH = make_flesh("whole", HEIGHT_M, 0.025)
BODY = FLESH.body
TRUNK = upper_trunk(BODY)
N_FRAMES = 12
NUMBERS = LoadSettings()


def load(*centers_m: tuple[float, float, float], radius_m: float = 0.13, joint: int = TRUNK) -> Cones:
    """Balls on a joint."""
    at = np.array(centers_m, dtype=np.float64)
    n = len(at)
    place = np.full(n, joint)
    return Cones(at, at + np.array([0, 0, 0.01]), np.full((n, 2), radius_m), place, 0 * place)


RUCKSACK = load((-0.22, 0.0, 0.05), (-0.22, 0.0, -0.12))


def walking() -> np.ndarray:
    """Poses (T, D) of a walk of 1.5 m; the arms swing."""
    states = np.tile(neutral_state(BODY), (N_FRAMES, 1))
    names = list(BODY.layout.names)
    states[:, 0] = np.linspace(-0.75, 0.75, N_FRAMES)
    swing = 0.5 * np.sin(np.arange(N_FRAMES))
    states[:, names.index("left_shoulder_z")] += swing
    states[:, names.index("right_shoulder_z")] += swing  # the other way: axes are not mirrored
    return states


def found(
    states: np.ndarray,
    worn: Cones | None,
    followed: np.ndarray | None = None,
    numbers: LoadSettings = NUMBERS,
) -> Cones | None:
    """What is found on somebody who wears it in these poses, and was followed in those or others."""
    body = BODY if worn is None else laden(BODY, worn)
    hulls = [rasterise(body, FLESH.grid, state, margin_m=0.012) for state in states]
    tools = SimpleNamespace(body=BODY, grid=FLESH.grid)
    observation: Any = SimpleNamespace(tools=tools, hull_of=lambda frame: hulls[frame])
    return find_load(observation, np.arange(len(states)), states if followed is None else followed, numbers)


def overlap(a: Cones, b: Cones, beside: Body) -> float:
    """Share of the room in either load, outside a body that stands, that is in both."""
    state = neutral_state(BODY)
    R, t = (m[0, TRUNK] for m in joint_transforms(BODY, state[None]))
    axis = np.arange(-0.5, 0.5, 0.02)
    places = np.stack(np.meshgrid(axis, axis, axis), axis=-1).reshape(-1, 3)

    def holds(cones: Cones) -> np.ndarray:
        return (cone_distances(places, cones.start, cones.end, cones.radii, round_ends=True) < 0).any(axis=1)

    flesh = cone_distances(places @ R.T + t, *cones_of(beside, state), beside.cones.radii, round_ends=True)
    in_a, in_b = (holds(cones) & (flesh > 0.03).all(axis=1) for cones in (a, b))
    return float((in_a & in_b).sum() / (in_a | in_b).sum())


def test_a_rucksack_is_found_where_it_is() -> None:
    worn = found(walking(), RUCKSACK)
    assert worn is not None
    assert set(worn.joint) == {TRUNK}
    assert set(worn.part) == {0}
    assert overlap(worn, RUCKSACK, BODY) > 0.6


def test_nobody_wears_what_is_not_there() -> None:
    assert found(walking(), None) is None
    assert found(walking(), load((-0.16, 0.0, 0.0), radius_m=0.07)) is None  # a hood


@pytest.mark.parametrize("lost_in", [(("left",), ("right",)), (("left", "right"), ())])
def test_a_limb_that_was_lost_in_it_says_nothing_of_it(lost_in: tuple[tuple[str, ...], ...]) -> None:
    """In every other frame one arm or the other is followed into the rucksack, or both are and none."""
    names, states = list(BODY.layout.names), walking()
    lost = states.copy()
    for i in range(N_FRAMES):
        for side in lost_in[i % 2]:
            sign = 1.0 if side == "right" else -1.0
            for name, angle in (("shoulder_x", 2.09), ("shoulder_z", -1.24), ("elbow_z", 1.44)):
                lost[i, names.index(f"{side}_{name}")] = sign * angle
    worn = found(states, RUCKSACK, lost)
    assert worn is not None
    assert overlap(worn, RUCKSACK, BODY) > 0.6


def holding(*sides: str) -> np.ndarray:
    """A walk of 1.5 m; the forearms of these sides point forward, the others hang."""
    names, states = list(BODY.layout.names), np.tile(neutral_state(BODY), (N_FRAMES, 1))
    states[:, 0] = np.linspace(-0.75, 0.75, N_FRAMES)
    for side in sides:
        states[:, names.index(f"{side}_elbow_z")] = ELBOW[side]
    return states


ELBOW = {"left": -1.4, "right": 1.4}  # bent
CRATE = load(*((0.3, y, -0.08 + z) for y in (-0.1, 0.0, 0.1) for z in (0.0, 0.1)), radius_m=0.11)


@pytest.mark.parametrize("n_seen", [N_FRAMES, 2 * N_FRAMES // 3])
def test_a_box_is_held_by_an_arm_that_is_lost_beside_it(n_seen: int) -> None:
    """What is found leaves room for the arm, as its fellow of the other side shows where it is, in some frames."""
    held, lost = holding("left", "right"), holding("left")
    lost[n_seen:] = holding()[n_seen:]
    worn = found(held, CRATE, lost)
    assert worn is not None
    R, t = (m[0, TRUNK] for m in joint_transforms(BODY, held[:1]))
    start, end = cones_of(BODY, held[0])
    fore = np.isin(BODY.cones.joint, [BODY.joints.index(f"right_{j}") for j in ("elbow", "forearm")])
    middle = ((start[fore] + end[fore]) / 2 - t) @ R
    off = cone_distances(middle, worn.start, worn.end, worn.radii, round_ends=True)
    assert off.min() > 0.0
    assert overlap(worn, CRATE, BODY) > 0.5


def test_an_arm_is_put_where_its_fellow_is() -> None:
    state = holding("left")[3]
    state[:2], state[BODY.yaw_column] = (0.7, -0.4), 1.1
    own = landmarks_of(BODY, state[None])[0]
    alike = landmarks_of(BODY, np.stack(arms_alike(BODY, state)))
    R, t = (m[0, TRUNK] for m in joint_transforms(BODY, state[None]))
    for moved, (mine, his) in zip(alike, (("left", "right"), ("right", "left")), strict=True):
        for name in ("elbow", "wrist"):
            place = (moved[BODY.landmarks.index(f"{mine}_{name}")] - t) @ R
            fellow = (own[BODY.landmarks.index(f"{his}_{name}")] - t) @ R
            np.testing.assert_allclose(place, fellow * (1, -1, 1), atol=0.01)
            k = BODY.landmarks.index(f"{his}_{name}")
            np.testing.assert_allclose(moved[k], own[k], atol=0.005)
        k = BODY.landmarks.index("left_knee")
        np.testing.assert_allclose(moved[k], own[k], atol=0.005)


@pytest.mark.parametrize(
    ("behind_nats", "in_doubt"), [((4.0, 9.0), "left"), ((9.0, 4.0), "right"), ((9.0, 9.0), "")]
)
def test_an_arm_that_may_be_where_its_fellow_would_be_is_in_doubt(
    behind_nats: tuple[float, float], in_doubt: str
) -> None:
    states = holding("left")
    made = make_tools(FLESH.grid, 12.5, HEIGHT_M, "whole", PoseConfig(), LikelihoodConfig(), 1)
    series = FrameSeries.of_length(N_FRAMES, made.body)
    series.states[:], series.observed[:] = states, True
    series.states[2] = np.nan  # nobody was followed there
    evidence: Any = SimpleNamespace(
        tools=made, all_refined=list, evidence=lambda tried: -np.array([0.0, *behind_nats])[: len(tried)]
    )
    observation: Any = SimpleNamespace(
        tools=made, prepare=lambda frame: None if frame == 1 else frame, evidence=lambda _: evidence
    )
    clip = person.VolumeClip(1, np.arange(N_FRAMES), None, observation)
    person._doubt_arms(clip, series)
    arm = [f"{in_doubt}_{name}" for name in ("wrist", "hand_tip")] if in_doubt else []
    is_arm = np.isin(made.body.landmarks, arm)
    for row in range(N_FRAMES):
        expected = is_arm if row not in (1, 2) else np.zeros_like(is_arm)
        np.testing.assert_array_equal(series.doubtful[row], expected)
        np.testing.assert_array_equal(series.observed[row], ~expected)
        np.testing.assert_array_equal(series.hidden_std[row] > 0.03, expected)


@pytest.mark.parametrize(
    ("walked_m", "turned_rad", "is_found"),
    [(0.0, 0.0, False), (0.9, 0.9, False), (1.1, 0.0, True), (0.0, 1.1, True)],
)
def test_who_neither_walks_nor_turns_wears_nothing(
    walked_m: float, turned_rad: float, is_found: bool
) -> None:
    states = walking()
    states[:, 0] = np.linspace(0.0, walked_m, N_FRAMES)
    states[:, BODY.yaw_column] = (
        np.linspace(0.0, turned_rad, N_FRAMES) + np.pi - 0.4
    )  # through the turn's end
    assert (found(states, RUCKSACK) is not None) == is_found


def test_what_goes_with_a_hand_is_not_worn_on_the_trunk() -> None:
    hand = BODY.joints.index("left_wrist")
    states = walking()
    states[:, list(BODY.layout.names).index("left_shoulder_z")] = 0.9 * np.sin(np.arange(N_FRAMES))
    assert found(states, load((0.0, 0.25, 0.0), radius_m=0.14, joint=hand)) is None


def test_frames_without_a_hull_are_passed_over() -> None:
    states = walking()
    body = laden(BODY, RUCKSACK)
    hulls: list[PersonHull | None] = [rasterise(body, FLESH.grid, s, margin_m=0.012) for s in states]
    hulls[::3] = [None] * len(hulls[::3])
    observation: Any = SimpleNamespace(
        tools=SimpleNamespace(body=BODY, grid=FLESH.grid), hull_of=lambda frame: hulls[frame]
    )
    assert find_load(observation, np.arange(N_FRAMES), states, NUMBERS) is not None
    hulls[:] = [None] * len(hulls)
    assert find_load(observation, np.arange(N_FRAMES), states, NUMBERS) is None


def test_a_body_is_dressed_and_undressed() -> None:
    dressed = laden(BODY, RUCKSACK)
    assert len(dressed.cones.joint) == len(BODY.cones.joint) + 2
    grown = bare(resize_body(dressed, 1.05, 1.05), RUCKSACK)
    for name, value in lengths_of(resize_body(BODY, 1.05, 1.05)).items():
        np.testing.assert_array_equal(lengths_of(grown)[name], value)
    np.testing.assert_array_equal(grown.cones.joint, BODY.cones.joint)
    np.testing.assert_array_equal(grown.cones.part, BODY.cones.part)


def test_every_body_has_an_upper_trunk() -> None:
    for name in ("anthropometric", "girdle", "thesis", "whole"):
        body = make_flesh(name, HEIGHT_M, 0.05).body
        joint = upper_trunk(body)
        assert 0 in body.cones.part[body.cones.joint == joint], name
    assert BODY.joints[TRUNK] == "thorax"


@pytest.mark.parametrize(
    ("unexplained", "worn", "is_again"), [(0.2, RUCKSACK, True), (0.2, None, False), (0.09, RUCKSACK, False)]
)
def test_who_wears_something_is_followed_with_it(
    unexplained: float, worn: Cones | None, is_again: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    made = make_tools(FLESH.grid, 12.5, HEIGHT_M, "whole", PoseConfig(), LikelihoodConfig(), 1)
    observation = VolumeObservation(made, lambda _: None)
    clip = person.VolumeClip(1, np.arange(N_FRAMES), None, observation)
    bodies: list[Body] = []

    def follow(clip: person.VolumeClip, height: Any, **_: Any) -> Any:
        bodies.append(clip.observation.tools.body)
        series = SimpleNamespace(unexplained=np.full(N_FRAMES, unexplained), states=walking())
        return person.FollowedPerson(
            person=1, tools=clip.observation.tools.resized(1.02), height=height, frames=clip.frames,
            series=series, is_facing_open=False, n_usable=N_FRAMES, start_frame=0, first_pose="stand",
        )  # fmt: skip

    monkeypatch.setattr(person, "_follow_body", follow)
    monkeypatch.setattr(person, "find_load", lambda *_: worn)
    doubted: list[Body] = []
    monkeypatch.setattr(
        person, "_doubt_arms", lambda clip, series: doubted.append(clip.observation.tools.body)
    )
    followed = person.follow_frames(clip, person.HeightEstimate(HEIGHT_M, True), seed=0)
    n_own = len(BODY.cones.joint)
    assert [len(body.cones.joint) for body in bodies] == [n_own, n_own + 2, n_own + 2][: 1 + 2 * is_again]
    assert [len(body.cones.joint) for body in doubted] == [n_own + 2][: int(is_again)]
    assert all(body.height_m == followed.body.height_m for body in doubted)
    assert len(followed.body.cones.joint) == n_own
    assert followed.body.height_m == pytest.approx(1.02 * HEIGHT_M)
    assert len(followed.tools.table.part_sizes) == BODY.layout.n_parts
    assert any("wears or holds something" in words for words in followed.warnings) == is_again
