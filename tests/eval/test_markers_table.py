"""The script of CF Table 6.3: its cells, its averages, its picture."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from marker_world import FPS, marker_world

from eval.markers_table_6_3 import (
    PUBLISHED,
    PUBLISHED_AVERAGE,
    TABLE_DETECTOR,
    TABLE_FILTER,
    Clip,
    average,
    draw,
    grid,
    observations,
    run_cell,
)
from mocap.body.initial import HeightEstimate
from mocap.likelihood.markers import marker_views
from mocap.pipeline.config import load_config
from mocap.pipeline.pose_settings import marker_tools
from mocap.pose.marker_person import Prepared

N_FRAMES = 4


def clip() -> Clip:
    """The marching person as the script's clips are: nothing hides a marker."""
    world = marker_world(12)
    uv, box = [], []
    for camera in world.rig:
        projected = np.stack([camera.project(p)[0] for p in world.points[:N_FRAMES]])
        uv.append(projected[:, None])
        box.append(np.concatenate([projected.min(axis=1), projected.max(axis=1)], axis=1)[:, None])
    visible = tuple(np.ones(u.shape[:3], dtype=np.bool_) for u in uv)
    return Clip(
        "walk", FPS, marker_views(world.rig), world.landmarks[:N_FRAMES], tuple(uv), visible, tuple(box)
    )


def known_person() -> Prepared:
    world = marker_world(12)
    config = load_config("reference_markers")
    tools = marker_tools(world.body, world.markers, FPS, config)
    return Prepared(tools, 0, world.states[0], "known", HeightEstimate(1.7, True), False, {})


def test_detector_rates_are_as_configured() -> None:
    c = clip()
    perfect = replace(TABLE_DETECTOR, rate=1.0, false_positives=0, variance=0)
    for seen in observations(c, perfect, 0):
        assert len(seen.uv) == 20 * c.views.n_views
    few = sum(len(s.uv) for s in observations(c, replace(perfect, rate=0.5), 0))
    assert 0.4 < few / (20 * c.views.n_views * N_FRAMES) < 0.6


def test_a_cell_runs_and_has_the_columns_of_the_table() -> None:
    quick = replace(TABLE_FILTER, n_particles=60)
    row = run_cell(clip(), known_person(), replace(TABLE_DETECTOR, false_positives=2), quick, 0)
    assert row["n_frames"] == N_FRAMES
    assert 0.0 < row["mean_error_mm"] < 150.0
    assert 0.0 <= row["mmta_percent"] <= 100.0
    again = run_cell(clip(), known_person(), replace(TABLE_DETECTOR, false_positives=2), quick, 0)
    assert again == row


def test_the_default_grid_is_a_part_of_the_published_one_beside_our_own_rows() -> None:
    full = set(grid(is_full=True))
    assert len(full) == 5 * 6 * 6 * 4 * 5
    short = grid(is_full=False)
    assert short[0] == (TABLE_DETECTOR, TABLE_FILTER)
    assert len(short) == len(set(short))


def test_published_averages_are_those_of_the_rows() -> None:
    """The source weighs by frames, so a plain mean is only near."""
    rows = np.array(list(PUBLISHED.values()))
    assert rows[:, 0].mean() == pytest.approx(PUBLISHED_AVERAGE[0], abs=3.0)
    assert rows[:, 3].mean() == pytest.approx(PUBLISHED_AVERAGE[3], abs=4.0)


def test_averages_and_picture(tmp_path: Path) -> None:
    base = {
        "action": "walk",
        "rate": 0.9,
        "false_positives": 20,
        "variance_px2": 4,
        "n_layers": 3,
        "n_particles": 700,
        "cost": "printed",
        "mode": "filter",
        "mean_error_mm": 60.0,
        "mmta_percent": 90.0,
    }
    rows = [base, {**base, "mmta_percent": 80.0}, {**base, "n_layers": 5, "mmta_percent": 70.0}]
    assert average(rows, "mmta_percent") == 85.0
    assert average(rows, "mmta_percent", n_layers=5) == 70.0
    assert np.isnan(average(rows, "mmta_percent", n_layers=9))
    draw(rows, tmp_path / "table.png")
    assert (tmp_path / "table.png").stat().st_size > 5000
