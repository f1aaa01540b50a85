"""Particles of a finished run: every layer of the filter in the frames that were asked for."""

from __future__ import annotations

import importlib.util
from pathlib import Path

import numpy as np
import pytest
from small_session import mocap
from two_persons import CONFIG, two_persons_run, two_persons_session

from mocap.errors import MocapError
from mocap.pipeline.finished import open_run
from mocap.pipeline.particles import particle_layers
from mocap.pipeline.record import RunResult


@pytest.fixture
def run(tmp_path_factory: pytest.TempPathFactory) -> RunResult:
    base = tmp_path_factory.getbasetemp()
    return open_run(two_persons_run(base), two_persons_session(base))


def test_every_layer_is_there_about_the_pose(run: RunResult) -> None:
    layers_of = particle_layers(run, (4, 6))
    assert layers_of(3) == {}
    found = layers_of(4)
    assert sorted(found) == [1, 2]
    for poses in run.poses:
        layers = found[poses.person]
        assert len(layers) == CONFIG.pose.n_layers
        clouds = [layer.reshape(CONFIG.pose.n_particles, 5, 3) for layer in layers]
        assert all(cloud.std(axis=0).min() > 0 for cloud in clouds)
        assert np.abs(clouds[0] - clouds[-1]).max() > 0
        head = poses.landmarks[4, 2]
        assert np.linalg.norm(clouds[-1][:, 0].mean(axis=0) - head) < 0.2
    again = particle_layers(run, (4, 6))(4)
    for person, layers in found.items():
        np.testing.assert_array_equal(layers, again[person])


@pytest.mark.parametrize("frames", [(4, 4), (5, 50), (12, None)])
def test_frames_that_are_not_the_runs_are_refused(run: RunResult, frames: tuple[int, int | None]) -> None:
    with pytest.raises(MocapError, match=r"--particles is .* frames 0 to 9"):
        particle_layers(run, frames)


@pytest.mark.skipif(importlib.util.find_spec("rerun") is None, reason="rerun-sdk is not installed")
def test_the_scene_holds_them_on_demand(tmp_path_factory: pytest.TempPathFactory, tmp_path: Path) -> None:
    base = tmp_path_factory.getbasetemp()
    out, session = two_persons_run(base), two_persons_session(base)
    plain, more = tmp_path / "plain.rrd", tmp_path / "more.rrd"
    assert mocap("view", out, session, "-o", plain).code == 0
    said = mocap("view", out, session, "-o", more, "--particles", "4:5")
    assert said.code == 0, said.err
    assert b"/world/particles/person_1/layer_02" in more.read_bytes()
    assert b"/world/particles" not in plain.read_bytes()
    assert "needs the session" in mocap("view", out, "--particles", "4:5").err
