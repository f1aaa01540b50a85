"""The pass over a clip that settles poses on the texture that all of them teach."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import fields, replace

import numpy as np
import pytest
from flesh_voxels import Flesh, make_flesh
from painted_body import cameras_around, crops_of, painted

from mocap.body import landmarks_of, neutral_state
from mocap.body.initial import HeightEstimate
from mocap.forks import can_fork
from mocap.pipeline.config import LikelihoodConfig, PoseConfig
from mocap.pipeline.pose_settings import make_tools
from mocap.pose import person as person_module
from mocap.pose.deviation import FrameSeries
from mocap.pose.person import VolumeClip, follow_person
from mocap.pose.texture import settle_on_texture
from mocap.pose.volume import PersonHull, VolumeObservation

FPS, N_FRAMES, DARK = 12.5, 10, 6


def standing(flesh: Flesh) -> np.ndarray:
    """States (T, D): somebody who turns slowly and swings his arms."""
    names = flesh.body.layout.names
    states = np.tile(neutral_state(flesh.body), (N_FRAMES, 1))
    swing = np.sin(np.arange(N_FRAMES))
    states[:, 2] = 1.0
    states[:, flesh.body.yaw_column] = 0.3 * np.arange(N_FRAMES)
    states[:, names.index("right_shoulder_x")] = 0.6 + 0.1 * swing
    states[:, names.index("left_shoulder_x")] = -0.6 + 0.1 * swing
    return states


@pytest.fixture(scope="module")
def scene() -> tuple[VolumeClip, np.ndarray]:
    """A clip with pictures in all frames but one, and its true states."""
    flesh, rig = make_flesh("anthropometric", 1.74, 0.04), cameras_around()
    states = standing(flesh)
    pictures = {i: painted(flesh, state, rig) for i, state in enumerate(states)}

    def hull_of(frame: int) -> PersonHull:
        own = flesh.hull(states[frame])
        if frame == DARK:
            return own
        return replace(own, crops=lambda shown: crops_of(flesh, states[frame], rig, shown))

    @contextmanager
    def pictures_of(frames: Sequence[int]) -> Iterator[Iterator[tuple[int, list[np.ndarray]]]]:
        yield ((frame, pictures[frame]) for frame in frames)

    pose = PoseConfig(texture_weight=1000, n_layers=3, n_particles=60, n_start_frames=1, n_first_poses=3)
    tools = make_tools(flesh.grid, FPS, 1.74, "anthropometric", pose, LikelihoodConfig(), 1)
    xyz = np.tile([0.0, 0.0, 1.0], (N_FRAMES, 1))
    observation = VolumeObservation(tools, hull_of, pictures_of=pictures_of)
    return VolumeClip(1, np.arange(N_FRAMES), xyz, observation), states


def turned(clip: VolumeClip, states: np.ndarray) -> FrameSeries:
    """Poses that are off one way and the other about the vertical, as far as a round trunk lets them be."""
    body = clip.observation.tools.body
    series = FrameSeries.of_length(len(states), body)
    series.states[:] = states
    series.states[:, body.yaw_column] += 0.08 * (-1.0) ** np.arange(len(states))
    return series


def test_poses_that_are_off_both_ways_are_drawn_to_the_middle(scene: tuple[VolumeClip, np.ndarray]) -> None:
    clip, states = scene
    body = clip.observation.tools.body
    series = turned(clip, states)
    before = series.states.copy()
    settle_on_texture(clip, series)
    light = np.arange(N_FRAMES) != DARK
    assert series.fit_covariance[light].any(axis=(1, 2, 3)).all()
    assert not series.fit_covariance[DARK].any()
    assert series.settled[light].mean() > 0.9

    hull_alone = np.stack(
        [
            clip.observation.evidence(clip.observation.prepare(int(f))).refined(s)
            for f, s in zip(clip.frames, before, strict=True)
        ]
    )

    def off(poses: np.ndarray) -> float:
        gap = landmarks_of(body, poses) - landmarks_of(body, states)
        return float(np.linalg.norm(gap[light], axis=2).mean())

    # Voxels of 4 cm draw everybody their own way.
    assert off(series.states) < 0.8 * off(hull_alone)


def every(clip: VolumeClip, n: int) -> VolumeClip:
    """The clip with every n-th pose refined."""
    tools = clip.observation.tools
    return clip.with_tools(replace(tools, settings=replace(tools.settings, texture_every_frames=n)))


def test_poses_between_refined_ones_move_along(scene: tuple[VolumeClip, np.ndarray]) -> None:
    clip, states = scene
    clip = replace(clip, frames=clip.frames[:DARK])
    states = states[:DARK]
    before, all_of_them, some = (turned(clip, states) for _ in range(3))
    settle_on_texture(clip, all_of_them)
    settle_on_texture(every(clip, 4), some)
    refined = [0, 4, 5]  # the last, too: nobody is left without a neighbour
    np.testing.assert_array_equal(some.states[refined], all_of_them.states[refined])
    moved = some.states - before.states
    for row, share in ((1, 0.25), (2, 0.5), (3, 0.75)):
        np.testing.assert_allclose(moved[row], (1 - share) * moved[0] + share * moved[4], atol=1e-9)
    np.testing.assert_array_equal(some.settled[2], some.settled[0] & some.settled[4])
    assert some.fit_covariance[refined].any(axis=(1, 2, 3)).all()
    assert not some.fit_covariance[1:4].any()  # that of the frame's own fit


def test_a_frame_that_shows_nothing_moves_along(scene: tuple[VolumeClip, np.ndarray]) -> None:
    clip, states = scene
    series = turned(clip, states)
    before = series.states.copy()
    settle_on_texture(clip, series)
    moved = series.states - before
    np.testing.assert_allclose(moved[DARK], 0.5 * (moved[DARK - 1] + moved[DARK + 1]), atol=1e-9)


def test_poses_do_not_move_along_over_a_gap(scene: tuple[VolumeClip, np.ndarray]) -> None:
    clip, states = scene
    away = replace(clip, frames=np.array([0, 1, 2, 3, DARK]), xyz=clip.xyz[[0, 1, 2, 3, DARK]])
    series = turned(away, states[away.frames])
    before = series.states.copy()
    settle_on_texture(away, series)
    assert not np.array_equal(series.states[3], before[3])
    np.testing.assert_array_equal(series.states[4], before[4])
    assert not series.settled[4].any()


def test_both_ends_of_every_piece_are_refined(scene: tuple[VolumeClip, np.ndarray]) -> None:
    clip, states = scene
    frames = np.array([0, 1, 2, 3, 4, 7, 8])
    assert DARK not in frames
    away = every(replace(clip, frames=frames, xyz=clip.xyz[frames]), 3)
    series = turned(away, states[frames])
    settle_on_texture(away, series)
    is_refined = series.fit_covariance.any(axis=(1, 2, 3))
    np.testing.assert_array_equal(np.flatnonzero(is_refined), [0, 3, 4, 5, 6])


@pytest.mark.skipif(not can_fork(), reason="needs a forked process")
def test_two_processes_settle_what_one_does(scene: tuple[VolumeClip, np.ndarray]) -> None:
    clip, states = scene
    alone, together = turned(clip, states), turned(clip, states)
    settle_on_texture(clip, alone)
    tools = replace(clip.observation.tools, n_threads=2)
    settle_on_texture(clip.with_tools(tools), together)
    for field in fields(alone):
        np.testing.assert_array_equal(getattr(alone, field.name), getattr(together, field.name))


def test_without_pictures_poses_stay(scene: tuple[VolumeClip, np.ndarray]) -> None:
    clip, states = scene
    series = turned(clip, states)
    before = series.states.copy()
    settle_on_texture(replace(clip, observation=replace(clip.observation, pictures_of=None)), series)
    np.testing.assert_array_equal(series.states, before)


@pytest.mark.parametrize(("weight", "n_passes"), [(0.0, 0), (3000.0, 1)])
def test_the_pass_is_made_where_it_has_a_weight(
    scene: tuple[VolumeClip, np.ndarray], monkeypatch: pytest.MonkeyPatch, weight: float, n_passes: int
) -> None:
    clip, _ = scene
    passes = []
    monkeypatch.setattr(person_module, "settle_on_texture", lambda clip, series: passes.append(len(series)))
    tools = clip.observation.tools
    tools = replace(tools, settings=replace(tools.settings, texture_weight=weight))
    short = replace(clip, frames=clip.frames[:3], xyz=clip.xyz[:3])
    follow_person(short.with_tools(tools), HeightEstimate(1.74, True), seed=0)
    assert passes == [3] * n_passes
