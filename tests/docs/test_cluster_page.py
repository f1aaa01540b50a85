"""The page on batches and sweeps: its file is read, its example runs, its options exist."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from small_session import copy_session, small_session

ROOT = Path(__file__).resolve().parents[2]
PAGE = (ROOT / "docs" / "cluster.md").read_text(encoding="utf-8")


def block(language: str) -> str:
    (found,) = re.findall(rf"^```{language}\n(.*?)^```", PAGE, re.M | re.S)
    return str(found)


def test_the_file_of_the_page_is_read(tmp_path: Path) -> None:
    from mocap.pipeline.cluster import plan_cells, read_sweep_spec

    for name in ("sessions/walk", "sessions/jog", "sweep/box"):
        (tmp_path / name).mkdir(parents=True)
    path = tmp_path / "sweep" / "sweep.toml"
    path.write_text(block("toml"), encoding="utf-8")
    spec = read_sweep_spec(path)
    everything = plan_cells(spec, sample=10**6)
    assert len(everything) == 3 * 2 * 3 * (3 * 2) * 2
    assert len(plan_cells(spec)) == 40
    from mocap.pipeline.config import load_config

    for cell in everything:
        load_config(cell.preset, cell.settings)


def test_the_python_of_the_page_runs(
    tmp_path: Path,
    tmp_path_factory: pytest.TempPathFactory,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    copy_session(small_session(tmp_path_factory.getbasetemp()), tmp_path / "walk", masks=True, n_frames=2)
    (tmp_path / "sweep.toml").write_text(
        'sessions = ["walk"]\n[set]\n"volume.voxel_size_m" = 0.05\n"pose.n_layers" = 1\n'
        '"pose.n_start_frames" = 1\n"pose.n_first_poses" = 1\n"pose.n_particles" = 40\n'
    )
    monkeypatch.chdir(tmp_path)
    exec(compile(block("python"), "cluster.md", "exec"), {"__name__": "docs"})
    first, second = capsys.readouterr().out.splitlines()
    assert first == "1 cells"
    assert re.fullmatch(r"\{'cell': 0, 'session': 'walk', 'preset': 'default', 'seed': 0\} \d+\.\d+", second)
