"""What is learnt of a person's colours on the way to the end of a clip and on the way back."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from flesh_voxels import Flesh
from painted_body import rays_at

from mocap.body import neutral_state
from mocap.body.initial import HeightEstimate
from mocap.forks import can_fork
from mocap.pipeline.config import LikelihoodConfig, PoseConfig
from mocap.pipeline.pose_settings import make_tools
from mocap.pose import person as person_module
from mocap.pose.evidence import PersonClip
from mocap.pose.person import VolumeClip, follow_frames
from mocap.pose.volume import PersonHull, VolumeObservation

FPS, N_FRAMES = 12.5, 8


@pytest.fixture(scope="module")
def clip(coarse_flesh: Flesh) -> VolumeClip:
    """Somebody who stands with his arms away from the trunk, before cameras; he has no legs at both ends of the clip,
    so that a first pose is best found between them."""
    state = neutral_state(coarse_flesh.body)
    names = coarse_flesh.body.layout.names
    state[2], state[names.index("right_shoulder_x")], state[names.index("left_shoulder_x")] = 1.0, 0.6, -0.6
    whole = replace(coarse_flesh.hull(state), rays=lambda: rays_at(coarse_flesh, state, seed=3))
    parts = coarse_flesh.body.layout.parts
    legs = tuple(k for k, name in enumerate(parts) if "thigh" in name or "shank" in name)
    legless = replace(coarse_flesh.hull(state, without=legs), rays=whole.rays)

    def hull_of(frame: int) -> PersonHull:
        return legless if frame in (0, N_FRAMES - 1) else whole

    pose = PoseConfig(n_layers=3, n_particles=60, n_start_frames=3, n_first_poses=3, texture_weight=0)
    tools = make_tools(coarse_flesh.grid, FPS, 1.74, "anthropometric", pose, LikelihoodConfig(), 1)
    xyz = np.tile([0.0, 0.0, 1.0], (N_FRAMES, 1))
    return VolumeClip(1, np.arange(N_FRAMES), xyz, VolumeObservation(tools, hull_of))


def counts_for_repair(
    clip: VolumeClip, n_threads: int, monkeypatch: pytest.MonkeyPatch
) -> tuple[np.ndarray, np.ndarray]:
    """Pixels by zone and colour that repairs are shown, and those of the way to the end alone."""
    shown: list[PersonClip] = []
    on: list[PersonClip] = []
    follow = person_module.follow_both_ways

    def followed(*arguments: object, **named: object) -> PersonClip:
        on.append(follow(*arguments, **named))  # type: ignore[arg-type]
        return on[-1]

    monkeypatch.setattr(person_module, "_repair", lambda clip, series: shown.append(clip))
    monkeypatch.setattr(person_module, "follow_both_ways", followed)
    tools = replace(clip.observation.tools, n_threads=n_threads)
    own = replace(clip, observation=clip.observation.with_tools(tools))
    follow_frames(own, HeightEstimate(1.74, is_measured=False), seed=0)
    (repaired,), (later,) = shown, on
    assert isinstance(repaired.observation, VolumeObservation)
    assert isinstance(later.observation, VolumeObservation)
    assert repaired.observation.appearance is not None
    assert later.observation.appearance is not None
    return repaired.observation.appearance.counts, later.observation.appearance.counts


def test_repairs_know_the_colours_of_both_ways(clip: VolumeClip, monkeypatch: pytest.MonkeyPatch) -> None:
    both, on = counts_for_repair(clip, 1, monkeypatch)
    # Of eight frames four or five lie on each way.
    assert 0.5 * on.sum() < (both - on).sum() < 2.0 * on.sum()
    assert (both >= on).all()


@pytest.mark.skipif(not can_fork(), reason="processes are forked on Linux alone")
def test_a_way_back_in_its_own_process_leaves_the_same_colours(
    clip: VolumeClip, monkeypatch: pytest.MonkeyPatch
) -> None:
    one, _ = counts_for_repair(clip, 1, monkeypatch)
    monkeypatch.undo()
    two, _ = counts_for_repair(clip, 2, monkeypatch)
    np.testing.assert_array_equal(two, one)
