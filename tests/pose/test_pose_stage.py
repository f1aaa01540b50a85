"""The pose of a walking body that is its own hull: found without a first pose, followed, never mirrored."""

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
import pytest
from flesh_voxels import Flesh, make_flesh

from mocap.body import landmarks_of, neutral_state
from mocap.body.initial import HeightEstimate
from mocap.data import LANDMARKS
from mocap.pipeline.config import LikelihoodConfig, PoseConfig
from mocap.pipeline.pose_settings import likelihood_settings, make_tools
from mocap.pose.follow import follow_pose
from mocap.pose.method import EvidenceSettings
from mocap.pose.person import VolumeClip, follow_person
from mocap.pose.result import PersonPoses, _seldom_observed
from mocap.pose.volume import (
    HullOf,
    PersonHull,
    VolumeObservation,
    VolumeTools,
    estimate_height,
    pack_volume,
)

FPS = 12.5
N_FRAMES = 18
VOXEL_M = 0.04
HIDDEN = (11, 12, 13)
SMALL = PoseConfig(n_layers=4, n_particles=120, n_start_frames=3, n_first_poses=6)


@dataclass(frozen=True, eq=False)
class Walk:
    flesh: Flesh
    states: np.ndarray
    hulls: tuple[PersonHull, ...]

    @property
    def truth(self) -> np.ndarray:
        return landmarks_of(self.flesh.body, self.states)

    @property
    def frames(self) -> np.ndarray:
        return 100 + np.arange(len(self.states))

    @property
    def xyz(self) -> np.ndarray:
        return np.array([self.flesh.grid.centers(h.voxels).mean(axis=0) for h in self.hulls])

    def hull_of(self, frame: int) -> PersonHull:
        return self.hulls[frame - 100]

    def sometimes_hidden(self, frame: int) -> PersonHull | None:
        return None if frame - 100 in HIDDEN else self.hulls[frame - 100]

    def tools(self, pose: PoseConfig = SMALL) -> VolumeTools:
        return make_tools(self.flesh.grid, FPS, 1.74, "anthropometric", pose, LikelihoodConfig(), 1)

    def clip(self, tools: VolumeTools, hull_of: HullOf | None = None, person: int = 1) -> VolumeClip:
        return VolumeClip(person, self.frames, self.xyz, VolumeObservation(tools, hull_of or self.hull_of))


@lru_cache(maxsize=1)
def walk() -> Walk:
    """Half a metre per second along a bend, arms and legs swinging, the left elbow bent: left is not right."""
    flesh = make_flesh("anthropometric", 1.74, VOXEL_M)
    names = flesh.body.layout.names
    states = []
    for k in range(N_FRAMES):
        t = k / FPS
        state = neutral_state(flesh.body)
        phase = 2 * np.pi * 0.8 * t
        swing = np.sin(phase)
        state[0], state[1] = -0.4 + 0.6 * t, 0.1 * t
        for name, value in (
            ("root_yaw", 0.3 * t),
            ("right_hip_y", -0.15 - 0.4 * swing),
            ("left_hip_y", -0.15 + 0.4 * swing),
            ("right_knee_y", 0.35 - 0.3 * np.cos(phase)),
            ("left_knee_y", 0.35 + 0.3 * np.cos(phase)),
            ("right_shoulder_x", 1.2),
            ("left_shoulder_x", -1.1),
            ("right_shoulder_z", -0.4 * swing),
            ("left_elbow_z", -1.0),
            ("right_elbow_z", 0.3),
        ):
            state[names.index(name)] = value
        states.append(state)
    hulls = tuple(flesh.hull(s, margin_m=VOXEL_M) for s in states)
    return Walk(flesh, np.array(states), hulls)


SEEDS = (0, 2)


@lru_cache(maxsize=len(SEEDS))
def followed(seed: int) -> PersonPoses:
    """The walk with three frames without a hull, from no first pose, at a height that could not be read."""
    w = walk()
    clip = w.clip(w.tools(), w.sometimes_hidden)
    return follow_person(clip, HeightEstimate(1.74, is_measured=False), seed=seed)


SEEN = np.delete(np.arange(N_FRAMES), HIDDEN)
MIRRORED = [
    LANDMARKS.index(n.replace("left", "#").replace("right", "left").replace("#", "right")) for n in LANDMARKS
]
# Over 20 seeds: 19 face the right way; of these the median landmark error is at most 6 mm, the mean at most 36 mm (a
# lower leg may be lost for some frames with so few particles).
MEDIAN_M, MEAN_M = 0.01, 0.04


def is_right_way_round(poses: PersonPoses) -> bool:
    own = np.linalg.norm(poses.landmarks - walk().truth, axis=2).mean()
    swapped = np.linalg.norm(poses.landmarks[:, MIRRORED] - walk().truth, axis=2).mean()
    return bool(own < swapped)


def test_a_walk_is_followed_from_no_first_pose_and_left_stays_left() -> None:
    right = [p for p in map(followed, SEEDS) if is_right_way_round(p)]
    assert len(right) >= len(SEEDS) - 1
    truth = walk().truth
    for poses in right:
        error = np.linalg.norm(poses.landmarks - truth, axis=2)[SEEN]
        assert np.median(error) < MEDIAN_M
        assert error.mean() < MEAN_M
        swapped = np.linalg.norm(poses.landmarks[:, MIRRORED] - truth, axis=2)[SEEN]
        assert np.all(swapped.mean(axis=1) > error.mean(axis=1)), "left and right were exchanged on the way"
        assert poses.observed[SEEN].mean() > 0.9


def test_frames_without_a_hull_are_carried_and_said() -> None:
    poses = followed(SEEDS[0])
    start = int(np.searchsorted(poses.frames, poses.start_frame))
    hidden = list(HIDDEN) if start < HIDDEN[0] else list(HIDDEN)[::-1]
    before = hidden[0] - 1 if start < HIDDEN[0] else hidden[0] + 1
    assert not poses.observed[list(HIDDEN)].any()
    assert np.isnan(poses.log_likelihood[list(HIDDEN)]).all()
    assert np.isfinite(poses.log_likelihood[SEEN]).all()
    for row in hidden:
        np.testing.assert_array_equal(poses.states[row], poses.states[before])
    spread = [np.trace(poses.landmark_covariance[row, 0]) for row in hidden]
    assert np.all(np.diff(spread) > 0), "uncertainty grows while nothing is seen"
    assert any("no usable volume in 3 of 18 frames" in warning for warning in poses.warnings)
    assert any("person_height_m" in warning for warning in poses.warnings)


def test_results_are_complete_and_consistent() -> None:
    w, poses = walk(), followed(SEEDS[0])
    D, M = w.flesh.body.layout.n_columns, len(LANDMARKS)
    assert poses.states.shape == (N_FRAMES, D)
    assert poses.landmark_covariance.shape == (N_FRAMES, M, 3, 3)
    np.testing.assert_array_equal(poses.frames, w.frames)
    np.testing.assert_allclose(landmarks_of(poses.body, poses.states), poses.landmarks)
    layout = poses.body.layout
    assert np.all(poses.states >= layout.lower)
    assert np.all(poses.states <= layout.upper)
    assert np.linalg.eigvalsh(poses.landmark_covariance).min() > 0
    assert w.frames[0] <= poses.start_frame <= w.frames[-1]
    assert np.all((poses.ess_share[SEEN] > 0) & (poses.ess_share[SEEN] <= 1))


def some_frames(pose: PoseConfig, *, n_threads: int = 1, seed: int = 4) -> list[np.ndarray]:
    w = walk()
    tools = replace(w.tools(pose), n_threads=n_threads)
    found = follow_pose(w.clip(tools), range(5), w.states[0], seed=seed, stage="pose")
    return [f.landmarks for f in found]


def test_the_same_seed_gives_the_same_poses_on_any_number_of_threads() -> None:
    first = some_frames(SMALL)
    np.testing.assert_array_equal(first, some_frames(SMALL))
    np.testing.assert_array_equal(first, some_frames(SMALL, n_threads=2))
    assert np.abs(np.array(first) - some_frames(SMALL, seed=5)).max() > 0


@pytest.mark.parametrize("name", ["apf", "sir"])
def test_the_published_filter_alone_follows_too(name: str) -> None:
    """No refinement, no limb search: coarser, but with the body (means at most 139 and 147 mm over 10 seeds)."""
    pose = PoseConfig(filter=name, n_layers=6, n_particles=150, refine=False, look_again=False)
    error = np.linalg.norm(np.array(some_frames(pose)) - walk().truth[:5], axis=2)
    assert error.mean() < 0.2


def test_the_height_is_read_from_the_hulls() -> None:
    """The hulls are a voxel larger all around than the body of 1.74 m."""
    w = walk()
    height = estimate_height(w.flesh.grid, w.hull_of, [int(f) for f in w.frames])
    assert height.is_measured
    assert height.height_m == pytest.approx(1.74 + VOXEL_M, abs=0.03)


@pytest.mark.parametrize(("n_in_the_air", "read_m"), [(8, 1.74), (45, 1.98)])
def test_who_jumps_is_no_taller_and_hidden_feet_leave_a_height(n_in_the_air: int, read_m: float) -> None:
    """Of 45 frames some have no feet on the floor: in a jump they do not count; where all are so, feet are hidden."""
    flesh = make_flesh("anthropometric", 1.74, VOXEL_M)
    state = neutral_state(flesh.body)
    standing = flesh.hull(state)
    state[flesh.body.layout.names.index("root_z")] += 0.24
    lifted = flesh.hull(state)
    height = estimate_height(
        flesh.grid, lambda frame: lifted if frame % 45 < n_in_the_air else standing, range(45)
    )
    assert height.is_measured
    assert height.height_m == pytest.approx(read_m, abs=0.03)


def test_landmarks_that_are_seldom_in_the_volume_are_named() -> None:
    observed = np.ones((9, len(LANDMARKS)), dtype=np.bool_)
    observed[:, 4] = [1, 1, 1, 1, 0, 0, 0, 0, 0]  # in four of the nine frames, two of which had no volume
    observed[:, 7] = [1, 1, 1, 1, 1, 0, 0, 0, 0]
    value = np.array([-1.0, -2.0, np.nan, -3.0, -1.0, -1.0, -1.0, -1.0, np.nan])
    assert _seldom_observed(observed, np.zeros(9)) == [LANDMARKS[4]]
    assert _seldom_observed(observed, value) == [LANDMARKS[4]]
    assert _seldom_observed(observed[2:3] & False, value[2:3]) == []


def test_no_usable_hull_is_an_error() -> None:
    w = walk()
    tiny = PersonHull(w.hulls[0].voxels[:50], w.hulls[0].is_surface[:50])
    for hull_of in (lambda frame: None, lambda frame: tiny):
        with pytest.raises(ValueError, match="person 3 has no frame with a usable hull"):
            follow_person(w.clip(w.tools(), hull_of, person=3), HeightEstimate(1.74, True), seed=0)


def test_packed_volume_holds_the_hull_with_room_around() -> None:
    w = walk()
    hull, grid = w.hulls[0], w.flesh.grid
    volume = pack_volume(grid, hull, 1.0)
    inside = np.argwhere(volume.crop >= 128) + volume.lower_subscript
    np.testing.assert_array_equal(grid.linear(inside), hull.voxels)
    rim = volume.crop.copy()
    rim[1:-1, 1:-1, 1:-1] = 0
    assert not rim.any()
    top = grid.subscripts(hull.voxels).max(axis=0)
    assert np.all(
        volume.lower_subscript + volume.crop.shape - 1 - top >= EvidenceSettings.crop_margin_m / VOXEL_M - 1
    )


def test_likelihood_settings_are_the_configuration() -> None:
    config = LikelihoodConfig(
        factorised=False, variance_out=0.1, variance_double=0.2, variance_empty=0.3, variance_surface=0.4
    )
    settings = likelihood_settings(config)
    assert settings.variances.tolist() == [0.1, 0.2, 0.3, 0.4]
    assert not settings.factorised
