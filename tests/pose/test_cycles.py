"""Gait cycles: which strides make one, and angles on the scale of percent."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from mocap.data import AngleSeries
from mocap.pipeline.outputs import CYCLE_COLUMNS, write_cycles_csv
from mocap.pipeline.replay import _cycle_charts
from mocap.pose.cycles import PERCENT, cycles_of
from mocap.pose.steps import Gait, Stance
from mocap.view.curves import charts_html

STRIDE, OFF = 30, 18  # frames of a cycle, and of its stance


def stance(side: str, strike: int | None, off: int | None) -> Stance:
    return Stance(side, strike, off, 0.4, 0.4, (0.0, 0.0))


def gait(left: int = 4) -> Gait:
    """So many stances of the left foot, and those of the right half a cycle later."""
    stances = []
    for k in range(left):
        stances += [stance("left", k * STRIDE + 5, k * STRIDE + 5 + OFF)]
        stances += [stance("right", k * STRIDE + 5 + STRIDE // 2, k * STRIDE + 5 + STRIDE // 2 + OFF)]
    return Gait(1, None, tuple(stances))


def angles(scale: float = 0.0) -> AngleSeries:
    """A knee that goes through one period per cycle of its foot, by `scale` more from cycle to cycle; a pelvis."""
    frame = np.arange(140)
    phase = 2 * np.pi * (frame - 5) / STRIDE
    growth = 1.0 + scale * ((frame - 5) // STRIDE)
    values = np.stack([np.sin(phase) * growth, np.sin(phase - np.pi), 0.1 * np.cos(2 * phase)], axis=1)
    names = ("left_knee_flexion", "right_knee_flexion", "pelvis_tilt")
    return AngleSeries(1, names, frame, frame / 30.0, values, np.full(values.shape, 0.02))


def test_both_feet_begin_at_their_own_strike() -> None:
    left, right = cycles_of(gait(), angles())
    assert (left.side, right.side) == ("left", "right")
    assert left.rows.tolist() == [[5, 35], [35, 65], [65, 95]]
    assert left.names == ("left_knee_flexion", "pelvis_tilt")
    assert left.off_percent == pytest.approx(60.0)
    for cycles in (left, right):
        mean, between, measured = cycles.mean(f"{cycles.side}_knee_flexion")
        # Straight lines between frames a thirtieth of a period apart miss a sine by half a percent.
        assert mean == pytest.approx(np.sin(2 * np.pi * PERCENT / 100), abs=0.006)
        assert between == pytest.approx(0.0, abs=1e-9)
        assert measured == pytest.approx(0.02)


def test_deviation_between_cycles_is_that_of_a_sample() -> None:
    left, _ = cycles_of(gait(), angles(scale=0.1))
    _, between, _ = left.mean("left_knee_flexion")
    assert between[25] == pytest.approx(0.1 * np.sin(np.pi / 2), rel=0.05)  # of 1.0, 1.1 and 1.2
    (only, *_) = cycles_of(gait(left=2), angles())
    assert len(only) == 1
    assert np.isnan(only.mean("left_knee_flexion")[1]).all()


@pytest.mark.parametrize(
    ("missed", "rows"),
    [
        (2, [[65, 95]]),  # a stance of the left foot: two cycles would be taken for one
        (1, [[35, 65], [65, 95]]),  # the right foot was not seen to strike within the first cycle
    ],
)
def test_a_missed_step_makes_no_cycle(missed: int, rows: list[list[int]]) -> None:
    stances = [s for i, s in enumerate(gait().stances) if i != missed]
    left = cycles_of(Gait(1, None, tuple(stances)), angles())[0]
    assert left.rows.tolist() == rows


def test_what_the_clip_cuts_off_is_no_cycle() -> None:
    cut = (stance("left", None, 10), stance("right", 20, 38), stance("left", 35, None))
    assert cycles_of(Gait(1, None, cut), angles()) == ()


def test_an_angle_that_passes_a_half_turn_is_not_averaged_across_it() -> None:
    turning = angles()
    values = np.pi - 0.1 + 0.2 * np.sin(2 * np.pi * (np.arange(140) - 5) / STRIDE)
    turning.values[:, 2] = np.angle(np.exp(1j * values))
    left, _ = cycles_of(gait(), turning)
    assert np.abs(np.diff(left.mean("pelvis_tilt")[0])).max() < 0.05


def walker(found: Gait) -> SimpleNamespace:
    """What the table asks of `Kinematics`."""
    return SimpleNamespace(poses=SimpleNamespace(person=found.person), cycles=cycles_of(found, angles()))


def test_the_table_has_a_row_per_percent(tmp_path: Path) -> None:
    path = tmp_path / "cycles.csv"
    write_cycles_csv(path, [walker(gait(left=2))])
    head, *rows = path.read_text().splitlines()
    assert tuple(head.split(",")) == CYCLE_COLUMNS
    assert len(rows) == 4 * len(PERCENT)  # a cycle of each foot, each with its knee and the pelvis
    assert rows[25] == "1,left,1,60.0,left_knee_flexion,25,56.98,,1.15,100"
    write_cycles_csv(path, [walker(Gait(1, None))])
    assert path.read_text() == ",".join(CYCLE_COLUMNS) + "\n"


def test_cycles_say_how_much_of_them_was_observed() -> None:
    series = angles()
    observed = np.ones(series.values.shape, dtype=bool)
    observed[:, 2] = False
    observed[20:50, 0] = False  # of the left foot's cycles, frames 5 to 94
    left, right = cycles_of(gait(), replace(series, observed=observed))
    assert left.observed == pytest.approx([1.0 - 30 / 90, 0.0])
    assert right.observed == pytest.approx([1.0, 0.0])


def test_charts_count_percent_and_do_not_follow_the_replay() -> None:
    (chart,) = _cycle_charts(cycles_of(gait(), angles()))
    assert chart.title == "Knee flexion over the gait cycle"
    assert [curve.label for curve in chart.curves] == [
        "left, cycles: 3, toe off at 60 %",
        "right, cycles: 3, toe off at 60 %",
    ]
    page = charts_html([chart])
    assert ">100 %<" in page
    assert "cursor" not in page
    assert "data-first" not in page


@pytest.mark.parametrize("ahead_deg", [0.0, 90.0, 170.0, -135.0])
def test_the_turn_of_the_pelvis_counts_from_the_way_that_it_goes(ahead_deg: float) -> None:
    """Passes to and fro have headings of 0 and 180 degrees, whose mean says nothing."""
    ahead, frame = np.deg2rad(ahead_deg), np.arange(140)
    turning = 0.1 * np.sin(2 * np.pi * (frame - 5) / STRIDE)
    heading = np.arctan2(np.sin(ahead + turning), np.cos(ahead + turning))
    series = AngleSeries(1, ("pelvis_rotation",), frame, frame / 30.0, heading[:, None])
    way = 0.04 * frame[:, None] * np.array([np.cos(ahead), np.sin(ahead)])
    left, _ = cycles_of(gait(), series, way)
    assert left.mean("pelvis_rotation")[0] == pytest.approx(
        0.1 * np.sin(2 * np.pi * PERCENT / 100), abs=0.002
    )
    on_the_spot, _ = cycles_of(gait(), series, 0.0 * way)
    assert on_the_spot.mean("pelvis_rotation")[0].mean() == pytest.approx(0.0, abs=1e-9)
