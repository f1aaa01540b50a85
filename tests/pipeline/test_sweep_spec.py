"""A sweep's TOML file: which cells it stands for, and what is said of a wrong one."""

from __future__ import annotations

from pathlib import Path

import pytest

from mocap.errors import MocapError
from mocap.pipeline.cluster import plan_cells, read_sweep_spec
from mocap.pipeline.cluster.spec import sample_indices, session_names, setting_text
from mocap.pipeline.config import load_config

FULL = """
sessions = ["data/*", "other/walk"]
presets = ["default", "reference"]
seeds = [4, 7, 9]
frames = "5:"
scores = ["mean_error_mm"]
[set]
"volume.voxel_size_m" = 0.04
output.formats = ["bvh", "trc"]
[grid]
"pose.n_particles" = [50, 80, 90, 100, 120]
[[zip]]
"pose.filter" = ["apf", "sbps", "apf"]
"pose.n_layers" = [2, 2, 4]
"""


def write(folder: Path, text: str) -> Path:
    for name in ("data/walk", "data/box", "other/walk"):
        (folder / name).mkdir(parents=True, exist_ok=True)
    (folder / "own.toml").write_text("[pose]\nn_layers = 3\n")
    path = folder / "sweep.toml"
    path.write_text(text, encoding="utf-8")
    return path


def test_cells_are_the_product_with_seeds_fastest(tmp_path: Path) -> None:
    spec = read_sweep_spec(write(tmp_path, FULL))
    cells = plan_cells(spec)
    assert len(cells) == 3 * 2 * 5 * 3 * 3
    assert [c.index for c in cells] == list(range(len(cells)))
    assert [c.seed for c in cells[:4]] == [4, 7, 9, 4]
    assert [c.session_name for c in cells[:: 2 * 5 * 3 * 3]] == ["data_box", "data_walk", "other_walk"]
    pairs = {(c.varied["pose.filter"], c.varied["pose.n_layers"]) for c in cells}
    assert pairs == {("apf", 2), ("sbps", 2), ("apf", 4)}
    assert spec.frames == (5, None)
    assert spec.varied == ("pose.n_particles", "pose.filter", "pose.n_layers")
    assert len({(c.session, c.preset, c.seed, c.settings) for c in cells}) == len(cells)


def test_settings_reach_the_configuration(tmp_path: Path) -> None:
    cell = plan_cells(read_sweep_spec(write(tmp_path, FULL)))[-1]
    config = load_config(cell.preset, cell.settings)
    assert config == load_config(
        "reference",
        (
            "volume.voxel_size_m=0.04",
            'output.formats=["bvh", "trc"]',
            "pose.n_particles=120",
            "pose.filter=apf",
            "pose.n_layers=4",
        ),
    )


@pytest.mark.parametrize("value", [True, 3, 0.1, 1e-9, float("inf"), 'a "quoted" wörd', ["x", "y"], [1, 2]])
def test_a_value_is_read_back_as_it_was(value: object) -> None:
    import tomllib

    key, _, text = setting_text("pose.thing", value).partition("=")
    assert key == "pose.thing"
    assert tomllib.loads(f"value = {text}")["value"] == value


def test_a_larger_sample_contains_the_smaller() -> None:
    small, large = (set(sample_indices(70, n, seed=3)) for n in (9, 31))
    assert (len(small), len(large)) == (9, 31)
    assert small < large < set(range(70))
    assert sample_indices(70, 9, seed=4) != sorted(small)
    assert sample_indices(7, 9, seed=3) == list(range(7))


def test_a_sample_is_fair() -> None:
    counts = [0] * 13
    n = 2000
    for seed in range(n):
        for i in sample_indices(13, 4, seed=seed):
            counts[i] += 1
    # Five standard deviations of a binomial count.
    assert max(abs(c - n * 4 / 13) for c in counts) < 5 * (n * 4 / 13 * 9 / 13) ** 0.5


def test_the_sample_of_the_file_and_of_the_command(tmp_path: Path) -> None:
    spec = read_sweep_spec(write(tmp_path, "sample = 6\n" + FULL))
    everything = plan_cells(read_sweep_spec(write(tmp_path, FULL)))
    chosen = plan_cells(spec)
    assert len(chosen) == 6
    assert [everything[c.index] for c in chosen] == chosen
    assert len(plan_cells(spec, sample=11)) == 11
    assert plan_cells(spec, sample_seed=1) != chosen


def test_names_of_sessions_are_as_short_as_they_can_be() -> None:
    assert session_names([Path("/a/b"), Path("/a/c")]) == ["b", "c"]
    assert session_names([Path("/a/x/s"), Path("/a/y/s")]) == ["x_s", "y_s"]


def test_defaults_and_a_preset_of_the_user(tmp_path: Path) -> None:
    (cell,) = plan_cells(read_sweep_spec(write(tmp_path, 'sessions = "data/box"\npresets = ["own.toml"]')))
    assert (cell.seed, cell.settings, cell.varied) == (0, (), {})
    assert load_config(cell.preset).pose.n_layers == 3


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "'sessions' is missing"),
        ("sessions = []", "'sessions' must not be empty"),
        ('sessions = ["data/nobody"]', "a session that is not there: data/nobody"),
        ('sessions = ["nodata/*"]', "a session that is not there"),
        ('sessions = ["data/box"]\npresets = ["fast"]', "a preset that is not there: fast"),
        ('sessions = ["data/box"]\nseeds = [-1]', "'seeds' must be"),
        ('sessions = ["data/box"]\nseeds = [1, 1]', "'seeds' names a seed twice"),
        ('sessions = ["data/box"]\nseed = 1', "'seed' is not known"),
        ('sessions = ["data/box"]\nsample = 0', "'sample' must be"),
        ('sessions = ["data/box"]\nframes = "9:3"', "'frames' holds no frame"),
        ('sessions = ["data/box"]\nframes = 9', "'frames' must be written"),
        ('sessions = ["data/box"]\ngrid = 3', "'grid' must be a table"),
        ('sessions = ["data/box"]\n[grid]\n"pose.n_layers" = 3', "'pose.n_layers' must be a list"),
        ('sessions = ["data/box"]\n[grid]\n"pose.n_layers" = []', "'pose.n_layers' must be a list"),
        ('sessions = ["data/box"]\n[grid]\n"pose.n_layers" = [2, 2]', "holds a value twice"),
        ('sessions = ["data/box"]\n[grid]\nlayers = [2, 3]', "'layers' is no setting"),
        ('sessions = ["data/box"]\n[set]\n"pose.n_layers" = 1979-05-27', "no value of a setting"),
        (
            'sessions = ["data/box"]\n[zip]\n"pose.n_layers" = [1, 2]\n"pose.n_particles" = [5]',
            "lists of different lengths",
        ),
        (
            'sessions = ["data/box"]\n[set]\n"pose.n_layers" = 1\n[grid]\n"pose.n_layers" = [5]',
            "'pose.n_layers' is given twice",
        ),
        ("sessions = [", "not valid TOML"),
    ],
)
def test_what_is_said_of_a_wrong_file(tmp_path: Path, text: str, message: str) -> None:
    path = write(tmp_path, text)
    with pytest.raises(MocapError, match=message.replace("[", r"\[")) as caught:
        read_sweep_spec(path)
    assert caught.value.path == path
    assert caught.value.remedy


def test_a_file_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(MocapError, match="cannot be read"):
        read_sweep_spec(tmp_path / "nothing.toml")


def test_too_many_cells(tmp_path: Path) -> None:
    many = ", ".join(map(str, range(2, 400)))
    spec = read_sweep_spec(
        write(
            tmp_path,
            f'sessions = ["data/box"]\nseeds = [{many}]\n[grid]\n"pose.n_particles" = [{many}]',
        )
    )
    with pytest.raises(MocapError, match="158404 cells, more than"):
        plan_cells(spec)
