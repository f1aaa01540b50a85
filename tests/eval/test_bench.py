"""The benchmark's registry, its command line and its committed baseline."""

from __future__ import annotations

import json

import numpy as np
import pytest

from eval.bench.__main__ import BASELINE, main
from eval.bench.registry import Measure, interleaved_medians, load_measures, measure, select
from eval.bench.scene import make_scene


def test_every_measure_has_a_direction_and_needed_names_exist():
    measures = {m.name: m for m in load_measures()}
    needed = {
        "carve_ms", "carve_over_bruteforce", "carve_over_open3d",
        "segmentation_over_mog2", "surface_colour_ms", "components_ms",
    }  # fmt: skip
    assert needed <= set(measures)
    assert all(m.better in ("higher", "lower") and m.unit for m in measures.values())
    assert all(m.run.__doc__ for m in measures.values())


def test_baseline_agrees_with_the_registry():
    measures = {m.name: m for m in load_measures()}
    baseline = json.loads(BASELINE.read_text())
    assert set(baseline) <= set(measures)
    for name, entry in baseline.items():
        m = measures[name]
        assert (entry["unit"], entry["better"], entry["tolerance"]) == (m.unit, m.better, m.tolerance)
        assert entry["value"] > 0


def test_one_measure_prints_one_json_object(capsys):
    assert main(["--json", "--only", "components_ms", "--compare"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert set(result) == {"components_ms"}
    assert result["components_ms"]["unit"] == "ms"
    assert 0 < result["components_ms"]["value"] < 1000
    assert result["components_ms"]["of_baseline"] > 0


def test_worse_than_the_tolerance_fails_whatever_the_direction():
    time = Measure("t", "ms", "lower", lambda: 1.0, 0.5)
    ratio = Measure("r", "x", "higher", lambda: 1.0, 0.25)
    assert time.worsening(3.0, 2.0) == pytest.approx(1.5)
    assert ratio.worsening(8.0, 10.0) == pytest.approx(1.25)
    assert [time.passes(v, 2.0) for v in (0.1, 2.9, 3.1)] == [True, True, False]
    assert [ratio.passes(v, 10.0) for v in (99.0, 8.1, 7.9, 0.0)] == [True, True, False, False]


def test_the_gate_names_what_is_worse_and_ends_with_1(monkeypatch, tmp_path, capsys):
    measures = (
        Measure("a_ms", "ms", "lower", lambda: 5.0, 1.0),
        Measure("b", "x", "higher", lambda: 6.0, 0.4),
    )
    monkeypatch.setattr("eval.bench.__main__.load_measures", lambda: measures)
    file = tmp_path / "baseline.json"
    monkeypatch.setattr("eval.bench.__main__.BASELINE", file)
    assert main(["--write-baseline"]) == 0
    assert json.loads(file.read_text())["b"] == {
        "value": 6.0, "unit": "x", "better": "higher", "tolerance": 0.4,
    }  # fmt: skip
    assert main(["--gate"]) == 0
    file.write_text(json.dumps({"a_ms": {"value": 2.0}, "b": {"value": 7.0}}))
    assert main(["--compare"]) == 0
    capsys.readouterr()
    assert main(["--gate"]) == 1
    assert capsys.readouterr().err == "a_ms: 2.5 times worse than the baseline\n"


def test_unknown_names_are_an_error_and_patterns_select(capsys):
    assert main(["--only", "nothing_like_this"]) == 2
    assert "nothing_like_this" in capsys.readouterr().err
    measures = load_measures()
    assert {m.name for m in select(measures, "carve_over_*")} == {
        "carve_over_bruteforce",
        "carve_over_open3d",
    }
    assert select(measures, None) == measures
    assert main(["--list", "--only", "carve_ms"]) == 0
    assert capsys.readouterr().out == "carve_ms\n"


def test_registering_twice_or_without_direction_is_refused():
    load_measures()
    with pytest.raises(ValueError, match="registered twice"):
        measure("carve_ms", unit="ms", better="lower")(lambda: 1.0)
    with pytest.raises(ValueError, match="better"):
        measure("other", unit="ms", better="smaller")


def test_medians_are_interleaved():
    calls: list[str] = []
    times = interleaved_medians([lambda: calls.append("a"), lambda: calls.append("b")], 3)
    assert "".join(calls) == "abababab"
    assert all(t >= 0 for t in times)


def test_the_scene_is_the_same_for_the_same_seed_and_shows_the_person_everywhere():
    a = make_scene(1, rng=np.random.default_rng(1))
    b = make_scene(1, rng=np.random.default_rng(1))
    assert np.array_equal(a.images[0][3], b.images[0][3])
    assert all(m.sum() > 2000 for m in a.masks[0])
