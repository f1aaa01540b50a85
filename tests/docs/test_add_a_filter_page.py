"""The page "Add a filter": its file is a filter, on the voxel body and in the 2D world."""

from __future__ import annotations

import importlib.util
import re
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from linear_gaussian_tree import LinearGaussianTree, positions_of, tree_layout
from small_session import PLAIN, small_session

from mocap.filters import FILTERS, FilterBudget, filter_settings, initial_particles

PAGE = Path(__file__).resolve().parents[2] / "docs" / "add-a-filter.md"
FILE, TABLE, BODY, POLYGONS = re.findall(r"^```python\n(.*?)^```", PAGE.read_text("utf-8"), re.M | re.S)
TREE = tree_layout((-1, 0, 0), (2, 1, 1))


@pytest.fixture
def page(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """Names after the page's file was imported and the filter put into the table."""
    path = tmp_path / "elite.py"
    path.write_text(FILE, encoding="utf-8")
    spec = importlib.util.spec_from_file_location("elite", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    monkeypatch.setitem(sys.modules, "elite", module)
    spec.loader.exec_module(module)
    monkeypatch.setitem(FILTERS, "elite", module.ELITE)  # taken out again after the test
    names = vars(module)
    exec(compile(TABLE, PAGE.name, "exec"), names)
    assert FILTERS["elite"] is module.ELITE
    return names


def test_it_runs_on_the_voxel_body(
    page: dict[str, Any],
    tmp_path: Path,
    tmp_path_factory: pytest.TempPathFactory,
    capsys: pytest.CaptureFixture[str],
) -> None:
    session = small_session(tmp_path_factory.getbasetemp())
    code = BODY.replace("out/demo/session", str(session)).replace("out/elite", str(tmp_path / "out"))
    quick = '", "'.join(key for key in PLAIN[:-1] if "n_layers" not in key and "n_particles" not in key)
    code = code.replace('"pose.filter=elite"', f'"pose.filter=elite", "{quick}"')
    exec(compile(code, PAGE.name, "exec"), page)
    assert capsys.readouterr().out == "1 person, 12 frames\n"


def test_it_runs_in_the_2d_world(page: dict[str, Any], capsys: pytest.CaptureFixture[str]) -> None:
    exec(compile(POLYGONS, PAGE.name, "exec"), page)
    said = dict(re.findall(r"^(\w+): (\d+) px over 36 corners$", capsys.readouterr().out, re.M))
    assert set(said) == {"sir", "elite"}
    assert int(said["elite"]) < int(said["sir"]) < 1000


@pytest.mark.usefixtures("page")
def test_it_finds_a_known_maximum_within_its_budget() -> None:
    z = np.array([0.3, -0.2, 0.4])
    problem = LinearGaussianTree(TREE, z, 0.05)
    settings = filter_settings(FilterBudget("elite", n_particles=200, n_layers=8), TREE, np.full(4, 0.3))
    state, info = FILTERS["elite"].step(
        problem, initial_particles(problem, np.zeros(4), 5), settings, rng=np.random.default_rng(0)
    )
    assert info.n_evaluations == 200 * 8
    assert state.particles.shape == (40, 4)
    np.testing.assert_allclose(positions_of(TREE) @ info.estimate, z, atol=0.05)  # one standard deviation
