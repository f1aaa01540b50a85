"""Nobody turns about within a few frames: one side of such a turn is followed once more."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from flesh_voxels import Flesh

from mocap.body import Body, load_body_model, neutral_state, scale_body
from mocap.pipeline.config import LikelihoodConfig, PoseConfig
from mocap.pipeline.pose_settings import make_tools
from mocap.pose import person
from mocap.pose.deviation import FrameSeries
from mocap.pose.follow import FramePose
from mocap.pose.method import RepairSettings
from mocap.pose.person import VolumeClip
from mocap.pose.turns import carry_over_turns, turns_of
from mocap.pose.volume import VolumeObservation

FPS = 25.0  # 0.2 s are five frames
N_FRAMES = 30


@pytest.fixture(scope="module")
def body() -> Body:
    return scale_body(load_body_model("anthropometric"), 1.7)


def states_of(body: Body, yaws_deg: np.ndarray) -> np.ndarray:
    """Somebody who stands upright and faces these ways."""
    assert body.yaw_column is not None
    states = np.tile(neutral_state(body), (len(yaws_deg), 1))
    states[:, body.yaw_column] = np.radians(yaws_deg)
    return states


def yaws(*pieces: tuple[int, float]) -> np.ndarray:
    return np.concatenate([np.full(n, degrees, dtype=np.float64) for n, degrees in pieces])


def found(body: Body, yaws_deg: np.ndarray) -> list[tuple[int, int]]:
    return turns_of(body, states_of(body, yaws_deg), FPS, RepairSettings())


@pytest.mark.parametrize(
    ("yaws_deg", "turns"),
    [
        (yaws((10, 0), (10, 180)), [(5, 14)]),
        (yaws((10, 170), (10, -20)), [(5, 14)]),
        (yaws((10, 0), (1, 70), (1, 130), (10, 180)), [(6, 14)]),
        (yaws((8, 0), (2, 180), (8, 0)), [(3, 14)]),
        (yaws((8, 0), (11, 180), (8, 0)), [(3, 12), (14, 23)]),
        (yaws((10, 0), (10, 115)), []),
        (np.linspace(0, 720, 34), []),
        (yaws((2, 0), (2, 180)), []),
    ],
    ids=[
        "at once", "over the seam", "over four frames", "for a moment", "and back", "not far enough", "a dancer",
        "a piece too short",
    ],
)  # fmt: skip
def test_turns(body: Body, yaws_deg: np.ndarray, turns: list[tuple[int, int]]) -> None:
    assert found(body, yaws_deg) == turns


@pytest.mark.parametrize(("pitch_deg", "is_told"), [(70, True), (80, False)])
def test_who_bends_over_does_not_turn_about(body: Body, pitch_deg: float, is_told: bool) -> None:
    """Who sits down or rises bends his pelvis far, which one who lies does further."""
    states = states_of(body, yaws((10, 0), (10, 180)))
    states[:, body.layout.names.index("root_pitch")] += np.deg2rad(pitch_deg)
    assert bool(turns_of(body, states, FPS, RepairSettings())) == is_told


def test_who_lies_has_no_front(body: Body) -> None:
    states = states_of(body, yaws((10, 0), (10, 180)))
    states[:, body.layout.names.index("root_pitch")] += np.pi / 2
    assert turns_of(body, states, FPS, RepairSettings()) == []
    assert turns_of(SimpleNamespace(yaw_column=None), states, FPS, RepairSettings()) == []


@pytest.fixture(scope="module")
def clip(coarse_flesh: Flesh) -> VolumeClip:
    """Somebody who stands facing +x, an arm held out before him; the last frame but one has no hull."""
    tools = make_tools(coarse_flesh.grid, FPS, 1.7, "anthropometric", PoseConfig(), LikelihoodConfig(), 1)
    hull = coarse_flesh.hull(pose_of(tools.body), margin_m=0.02)
    observation = VolumeObservation(tools, lambda frame: None if frame == N_FRAMES - 2 else hull)
    return VolumeClip(1, np.arange(N_FRAMES), np.zeros((N_FRAMES, 3)), observation)


def pose_of(body: Body, yaw_deg: float = 0.0) -> np.ndarray:
    (state,) = states_of(body, np.array([yaw_deg]))
    state[2] = 1.0
    state[body.layout.names.index("left_shoulder_y")] -= 1.3
    return state


def series_of(clip: VolumeClip, yaws_deg: np.ndarray) -> FrameSeries:
    body = clip.observation.tools.body
    series = FrameSeries.of_length(len(clip), body)
    series.states[:] = [pose_of(body, float(yaw)) for yaw in yaws_deg]
    return series


def keeping(ways_gone: list[range]):  # type: ignore[no-untyped-def]
    """Follows ways by keeping the pose that each begins with."""

    def follow(ways):  # type: ignore[no-untyped-def]
        ways_gone.extend(order for _, order in ways)
        return [[kept(row, state) for row in order] for state, order in ways]

    return follow


def kept(row: int, state: np.ndarray) -> FramePose:
    n, n_parts = 15, 10
    return FramePose(
        row, state, np.zeros((n, 3)), np.eye(len(state)), np.eye(3), np.zeros(n_parts), 0.0, 0.0, np.zeros(n),
        np.ones(n, dtype=np.bool_), -1.0, -1.0, 1.0, np.zeros(n, dtype=np.bool_),
    )  # fmt: skip


def facing_deg(clip: VolumeClip, series: FrameSeries) -> np.ndarray:
    return np.degrees(series.states[:, clip.observation.tools.body.yaw_column]).round() % 360


@pytest.mark.parametrize(
    ("yaws_deg", "ways"),
    [
        (yaws((12, 0), (18, 180)), [range(15, -1, -1), range(8, 30)]),
        (yaws((18, 180), (12, 0)), [range(21, -1, -1), range(14, 30)]),
    ],
    ids=["wrong to the end", "wrong from the beginning"],
)
def test_the_wrong_side_of_a_turn_is_followed_once_more(
    clip: VolumeClip, yaws_deg: np.ndarray, ways: list[range]
) -> None:
    series, gone = series_of(clip, yaws_deg), []
    carry_over_turns(clip, series, keeping(gone))
    assert gone == ways
    assert (facing_deg(clip, series) == 0).all()


def test_between_two_turns_over_the_other_one(clip: VolumeClip) -> None:
    series, gone = series_of(clip, yaws((9, 0), (12, 180), (9, 0))), []
    carry_over_turns(clip, series, keeping(gone))
    assert gone == [range(12, -1, -1), range(5, 25)]
    assert (facing_deg(clip, series) == 0).all()


def test_who_has_turned_about_has(clip: VolumeClip) -> None:
    """Where neither side gains, both stay; each turn is gone over with the ones beside it."""
    series, gone = series_of(clip, yaws((9, 0), (12, 180), (9, 0))), []
    before = series.states.copy()

    def lost(ways):  # type: ignore[no-untyped-def]
        gone.extend(order for _, order in ways)
        far = [state + 2.0 * clip.observation.tools.body.is_position for state, _ in ways]
        return [[kept(row, state) for row in order] for state, (_, order) in zip(far, ways, strict=True)]

    carry_over_turns(clip, series, lost)
    np.testing.assert_array_equal(series.states, before)
    assert gone == [range(12, -1, -1), range(5, 25), range(24, 4, -1), range(17, 30)]


def test_between_pictures_far_apart_one_may_turn(clip: VolumeClip) -> None:
    slow = clip.with_tools(replace(clip.observation.tools, fps=3.0))
    series, gone = series_of(slow, yaws((12, 0), (18, 180))), []
    carry_over_turns(slow, series, keeping(gone))
    assert gone == []


def test_frames_that_are_missing_end_a_piece(clip: VolumeClip) -> None:
    gap = replace(clip, frames=np.r_[0:12, 40:58])
    series, gone = series_of(gap, yaws((12, 0), (18, 180))), []
    carry_over_turns(gap, series, keeping(gone))
    assert gone == []


def test_a_person_is_followed_out_of_a_first_pose_that_faces_the_wrong_way(
    clip: VolumeClip, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With the follower itself, as a person's poses are made."""
    wrong = yaws((12, 0), (18, 180))

    def both_ways(own, first, *, take, **rest):  # type: ignore[no-untyped-def]
        for row, yaw in enumerate(wrong):
            take(kept(row, pose_of(own.observation.tools.body, float(yaw))))
        return own

    monkeypatch.setattr(person, "follow_both_ways", both_ways)
    first = SimpleNamespace(frame=20, state=pose_of(clip.observation.tools.body, 180.0))
    series = person._followed(clip, first, seed=0, progress=None)
    assert np.cos(np.radians(facing_deg(clip, series))).min() > 0.8
