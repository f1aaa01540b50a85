"""The likelihood on a CUDA device against the processor's: in numba's simulator, and on a device where there is one."""

import os
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from device_scores import CASES, FIELDS, problem, scores
from flesh_voxels import make_flesh

from mocap.arrays import Array
from mocap.body import Body, LookUpTable, neutral_state
from mocap.likelihood.voxels import (
    PackedVolume,
    PartScores,
    VoxelLikelihoodSettings,
    VoxelProblem,
    fast_part_scores,
    part_scores,
)
from mocap.pipeline.config import LikelihoodConfig, PoseConfig
from mocap.pipeline.pose_settings import likelihood_settings, make_tools

ROOT = Path(__file__).resolve().parents[2]
# A device rounds otherwise than a processor: of some thousand points one or two may lie in the voxel beside.
DEVICE_MEAN = 1e-3


def _run(code: Sequence[str], **environment: str) -> str:
    paths = os.pathsep.join([str(ROOT), str(ROOT / "tests")])
    ran = subprocess.run(
        [sys.executable, "-W", "error", *code],
        env={**os.environ, "PYTHONPATH": paths, **environment},
        capture_output=True,
        text=True,
        check=False,
    )
    assert ran.returncode == 0, ran.stderr
    return ran.stdout


def _scores_of_a_device(out: Path, **environment: str) -> dict[str, Array]:
    _run([str(ROOT / "tests" / "device_scores.py"), str(out)], **environment)
    with np.load(out) as found:
        return dict(found)


def _by_the_processor(
    body: Body,
    table: LookUpTable,
    volume: PackedVolume,
    states: Array,
    *,
    n_points: int | None = None,
    parts: Sequence[int] | None = None,
    given: Sequence[int] = (),
) -> PartScores:
    if n_points is None:
        return part_scores(body, table, volume, states, parts=parts, given=given)
    return fast_part_scores(body, table, volume, states, n_points=n_points, parts=parts, given=given)


@pytest.fixture(scope="module")
def expected() -> dict[str, Array]:
    return scores(_by_the_processor)


def test_the_simulated_device_scores_as_the_processor(expected: dict[str, Array], tmp_path: Path) -> None:
    """To the last bit: sums of whole numbers have no order, and those of shares have the processor's."""
    found = _scores_of_a_device(tmp_path / "scores.npz", NUMBA_ENABLE_CUDASIM="1", NUMBA_DISABLE_JIT="1")
    assert found.pop("name") == "numba's simulator"
    assert found.pop("refused") == "a device takes 64 joints and segments, got 65"
    assert set(found) == set(CASES)
    for name, want in expected.items():
        for field, one, other in zip(FIELDS, found[name], want, strict=True):
            np.testing.assert_array_equal(one, other, err_msg=f"{name}: {field}")


def test_the_problem_asks_for_all_that_is_scored(expected: dict[str, Array]) -> None:
    """Otherwise nothing would be said by equal scores: points outside, parts that meet, and what is not a number."""
    body, table, _, states = problem()
    assert len(table.joint) > body.layout.n_parts, "parts of several segments"
    assert np.isnan(states).any()
    for name in ("exact", "fast"):
        out, double, occupied, surface = expected[name]
        assert np.ptp(out[2]) > 0.5, "half out of the room"
        assert np.allclose(out[3], 1), "far away"
        assert np.all(occupied[4] == 0), "nowhere"
        assert name == "exact" or np.any(double[6] == 1), "more than all of a part is in others"
        assert np.sum((double > 0.05) & (double < 1)) > 10
        assert np.sum((occupied > 0) & (occupied < 1)) > 10
        assert np.sum((surface > 0) & (surface < 1)) > 20


def test_a_device_scores_nearly_as_the_processor_and_the_same_every_time(
    expected: dict[str, Array], tmp_path: Path
) -> None:
    asked = "from mocap.likelihood.voxels.device import device_name; print(device_name())"
    if _run(["-c", asked]).strip() == "None":
        pytest.skip("no CUDA device, or no extra gpu")
    found, again = (_scores_of_a_device(tmp_path / f"{i}.npz") for i in range(2))
    for name, want in expected.items():
        np.testing.assert_array_equal(found[name], again[name], err_msg=name)
        if want.size:
            assert np.abs(found[name] - want).mean() < DEVICE_MEAN, name


def test_nothing_opens_a_device_that_does_not_score() -> None:
    """CUDA is imported by `device_part_scores` alone: without the extra all else works, and processes are forked."""
    asked = "import sys, mocap.pipeline.run, mocap.pipeline.doctor; print('numba.cuda' in sys.modules)"
    assert _run(["-c", asked]).strip() == "False"


def test_a_process_that_has_opened_a_device_forks_no_more() -> None:
    asked = "import mocap.forks as f; print(f.can_fork()); import numba.cuda; print(f.can_fork())"
    before, after = _run(["-c", asked]).split()
    assert before == str(sys.platform.startswith("linux"))
    assert after == "False"


def test_a_problem_has_its_particles_scored_by_its_device(monkeypatch: pytest.MonkeyPatch) -> None:
    """All that it scores at once, with its own points; a limb is not worth the way."""
    asked: list[int | None] = []

    def device_part_scores(*args: Any, **options: Any) -> PartScores:
        asked.append(options.get("n_points"))
        return _by_the_processor(*args, **options)

    monkeypatch.setattr("mocap.likelihood.voxels.problem.device_part_scores", device_part_scores)
    body, table, volume, states = problem()
    for kind, n_points in (("exact", None), ("fast", 31)):
        settings = VoxelLikelihoodSettings(kind=kind, n_points=31)
        own = VoxelProblem(body, table, volume, settings)
        cuda = VoxelProblem(body, table, volume, replace(settings, device="cuda"))
        for parts, given in ((None, ()), ((4, 0), (2,))):
            a, b = (one.log_likelihood(states, parts, given) for one in (own, cuda))
            np.testing.assert_array_equal(a, b)
        np.testing.assert_array_equal(own.occupancy(states), cuda.occupancy(states))
        assert asked == [n_points, n_points, None]
        own.limb_log_likelihood(states[0], [1])(states)
        asked.clear()


def test_a_device_proposes_and_the_processor_judges() -> None:
    likelihood = LikelihoodConfig(kind="fast", device="cuda")
    flesh = make_flesh("thesis", 1.7, 0.06)
    tools = make_tools(flesh.grid, 12.5, 1.7, "thesis", PoseConfig(), likelihood, 1)
    evidence = tools.frame(flesh.hull(neutral_state(flesh.body)))
    assert evidence.search.settings.device == "cuda"
    assert (evidence.voxels.settings.device, evidence.voxels.settings.kind) == ("cpu", "exact")


def test_auto_is_the_processor_whatever_a_machine_has() -> None:
    of = {word: likelihood_settings(LikelihoodConfig(device=word)).device for word in ("auto", "cpu", "cuda")}
    assert of == {"auto": "cpu", "cpu": "cpu", "cuda": "cuda"}
    assert LikelihoodConfig().device == "auto"
