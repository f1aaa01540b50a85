"""The example of the sweep engine: CF Figure 6.13's grid, its jobs and its picture."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from eval import markers_figure_6_13 as figure


def test_the_grid_is_that_of_the_printed_levels() -> None:
    """5 x 6 x 6 detectors; CF prints 360, which its levels do not give."""
    grid = figure.cells(figure.RATES)
    assert len({detector for detector, _ in grid}) == 5 * 6 * 6
    assert len({which for _, which in grid}) == 20
    assert len(set(grid)) == len(grid) == 3600


def test_a_job_s_key_is_all_that_its_result_depends_on() -> None:
    grid = figure.cells((0.9,))[:50]
    keys = {
        figure.job_of(action, n_frames, seed, cell, code).key
        for action in ("walk", "box")
        for n_frames in (20, None)
        for seed in (0, 1)
        for code in ("a", "b")
        for cell in grid
    }
    assert len(keys) == 16 * len(grid)
    assert figure.job_of("walk", 20, 0, grid[0], "a") == figure.job_of("walk", 20, 0, grid[0], "a")


def test_means_and_picture(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rows = [
        {
            "rate": detector.rate,
            "false_positives": detector.false_positives,
            "variance_px2": detector.variance,
            "n_layers": which.n_layers,
            "n_particles": which.n_particles,
            "mmta_percent": 100.0 - detector.variance + which.n_layers,
        }
        for detector, which in figure.cells((0.9,))
        if which.n_particles != 300
    ]
    assert figure.mean_mmta(rows, variance_px2=20, n_layers=3) == pytest.approx(83.0)
    assert np.isnan(figure.mean_mmta(rows, n_particles=300))
    figure.draw(rows, tmp_path / "figure.png")
    assert 1_000 < (tmp_path / "figure.png").stat().st_size < 200_000
    figure.say(rows)
    said = capsys.readouterr().out
    assert "best at variance 40: 7 layers of 100" in said
    assert "ours:      103.0 % at variance 0 px2" in said
