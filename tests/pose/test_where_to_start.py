"""Where in a clip a first pose is looked for: in the middle, or as near to it as somebody stands; and which counts."""

from types import SimpleNamespace

import numpy as np
import pytest
from flesh_voxels import make_flesh, rasterise

from mocap.body import neutral_state
from mocap.body.initial import HeightEstimate
from mocap.pipeline.config import LikelihoodConfig, PoseConfig
from mocap.pipeline.pose_settings import make_tools
from mocap.pose.method import StartSettings
from mocap.pose.person import VolumeClip, _best_explained, _where_to_start
from mocap.pose.volume import PersonHull, VolumeObservation
from mocap.volume import surface_voxels

HEIGHT_M = 1.7
VOXEL_M = 0.03
FPS = 10.0  # two seconds around the middle: ten rows to either side
N = 101
FLESH = make_flesh("anthropometric", HEIGHT_M, VOXEL_M)


def hull_below(top_m: float) -> PersonHull:
    state = neutral_state(FLESH.body)
    state[2] += 0.05
    voxels = rasterise(FLESH.body, FLESH.grid, state, margin_m=VOXEL_M).voxels
    low = voxels[FLESH.grid.centers(voxels)[:, 2] < top_m]
    return PersonHull(low, surface_voxels(low, FLESH.grid))


STANDING, CROUCHING = hull_below(np.inf), hull_below(1.1)


def rows_for(
    crouches: range, *, height: HeightEstimate, n: int = 3, frames: np.ndarray | None = None
) -> list[int]:
    """Rows of a clip in which somebody crouches in some frames and stands in the others."""
    quick = PoseConfig(n_start_frames=n, outline_weight=0)
    tools = make_tools(FLESH.grid, FPS, HEIGHT_M, "anthropometric", quick, LikelihoodConfig(), 1)
    frames = np.arange(N) if frames is None else frames
    observation = VolumeObservation(tools, lambda frame: CROUCHING if frame in crouches else STANDING)
    clip = VolumeClip(1, frames, np.zeros((len(frames), 3)), observation)
    return _where_to_start(clip, range(len(frames)), height)


MEASURED = HeightEstimate(HEIGHT_M, is_measured=True)


def test_who_stands_is_looked_at_in_the_middle() -> None:
    assert rows_for(range(0), height=MEASURED) == [40, 50, 60]
    # Sixty rows are spread over these, and the middle is none of them.
    assert rows_for(range(0), height=MEASURED, frames=np.arange(121)) == [50, 60, 70]


def test_two_seconds_are_two_seconds_where_frames_are_missing() -> None:
    frames = np.concatenate([np.arange(45), np.arange(60, 116)])
    assert rows_for(range(0), height=MEASURED, frames=frames) == [45, 52, 60]


@pytest.mark.parametrize(
    ("crouches", "least", "most"),
    [(range(15, 91), 3, 14), (range(10, 80), 80, 91), (range(30, 100), 18, 29)],
)
def test_who_crouches_in_the_middle_is_looked_at_where_he_stands_nearest_to_it(
    crouches: range, least: int, most: int
) -> None:
    rows = rows_for(crouches, height=MEASURED)
    assert len(rows) == 3  # every second row or so is looked at, so that they begin within two of the nearest
    assert all(least <= row <= most for row in rows), rows


def test_who_crouches_now_and_then_is_looked_at_where_he_does_not() -> None:
    """The middle itself is taken; of the rows around it, those in which he stands."""
    assert rows_for(range(55, 70), height=MEASURED) == [40, 47, 54]


def test_rows_are_near_in_time_whatever_is_missing_between_them() -> None:
    """Twenty seconds without him lie before the middle row: what is near by number is far away."""
    frames = np.concatenate([np.arange(50), np.arange(250, 301)])
    rows = rows_for(range(250, 270), height=MEASURED, frames=frames)
    assert all(70 <= row <= 81 for row in rows), rows


@pytest.mark.parametrize(
    ("crouches", "height"),
    [
        (range(N), MEASURED),  # he is as small as the height that was read elsewhere, or sits all along
        (range(30, 70), HeightEstimate(HEIGHT_M, is_measured=False)),  # a usual height says nothing of him
    ],
)
def test_where_nothing_tells_the_middle_is_taken(crouches: range, height: HeightEstimate) -> None:
    assert rows_for(crouches, height=height) == [40, 50, 60]


@pytest.mark.parametrize(
    ("explained", "asked", "chosen"),
    [
        ([-90.0, -100.0, -50.0], 2, 0),
        ([-100.0, -90.0, -50.0], 2, 1),
        ([-130.0, -90.0, -120.0], 3, 1),
        ([-90.0, -130.0, -80.0], 3, 2),
        ([-130.0], 1, 0),
    ],
    ids=["two alike", "the second better", "the first caught in a wrong pose", "the third best", "one frame"],
)
def test_a_wrong_pose_gives_itself_away_by_another_frame(
    explained: list[float], asked: int, chosen: int
) -> None:
    settled = []

    def settle(search: int, tried: list[str]) -> list[SimpleNamespace]:
        settled.append(search)
        return [SimpleNamespace(log_likelihood=explained[search])]

    promising = [(frame, [f"tried in {frame}"]) for frame in range(len(explained))]
    search, tried, poses = _best_explained(promising, settle, StartSettings(same_nats=25.0))
    assert settled == list(range(asked))
    assert (search, tried, poses[0].log_likelihood) == (chosen, [f"tried in {chosen}"], explained[chosen])
