"""The page of an evaluation and its pictures, also where there is hardly anything to show."""

from __future__ import annotations

import struct
from typing import Any

import numpy as np
import pytest

from mocap.compare.page import EvalPage, eval_html
from mocap.compare.plots import plot_angle_errors, plot_epsilon, plot_reliability, plot_sweep
from mocap.view.html import Figure


def size(png: bytes) -> tuple[int, int]:
    assert png.startswith(b"\x89PNG\r\n\x1a\n")
    width, height = struct.unpack(">II", png[16:24])
    return width, height


def test_pictures_are_pictures() -> None:
    rng = np.random.default_rng(0)
    errors = np.concatenate([rng.normal(60, 12, 400), rng.uniform(200, 500, 40), [np.nan]])
    at = np.linspace(50, 500, 30)
    wide = plot_epsilon(errors, at, np.linspace(0.1, 0.3, 30), np.linspace(1, 0.5, 30), 90.0, 95.0)
    assert size(wide)[0] > 2 * size(wide)[1]
    few = plot_epsilon(errors[:2], at[:1], at[:1], at[:1], 90.0, 95.0)
    assert size(few) == size(wide)
    assert few != wide
    curve = np.array([np.nan, 10.0, 20.0])
    assert size(plot_sweep(np.array([5.0, 50.0, 100.0]), curve, curve, curve, {"epsilon": 100.0}))[0] > 1000
    level = np.linspace(5, 95, 19)
    assert size(plot_reliability(level, level, np.linspace(5, 50, 10), np.linspace(8, 80, 10)))[0] > 1000
    tall = plot_angle_errors({f"angle_{i}": 3.0 for i in range(15)}, {"angle_0": None})
    assert size(tall)[1] > size(plot_angle_errors({"left_knee": None}, {}))[1]


def scores(**more: Any) -> dict[str, Any]:
    row = {"mean_error_mm": 20.0, "mmtp_mm": 18.0, "mmta_percent": 97.5}
    return {
        "mean_error_mm": 20.0,
        "mmta_percent": 97.5,
        "epsilon_mm": 100.0,
        "unit_warning": None,
        "aligned": {"none": row, "procrustes": row},
        "per_landmark": {"left_knee": {"mean_mm": 12.0, "mmta_percent": None}},
        "angles": {"direct": {"mean_deg": 3.0}, "inverse_kinematics": {"mean_deg": None}},
        "estimate": {"path": "a<b>.trc", "format": "TRC", "fps": None},
        "truth": {"path": "t", "format": "C3D"},
        "notes": ["taken as mm by the size of the body"],
        "warnings": ["too <far>. Remedy: come closer"],
        **more,
    }


def test_the_page_says_what_was_assumed_and_escapes_what_it_was_told() -> None:
    figure = Figure("Error over time.", "What it shows.", b"\x89PNG")
    text = eval_html(EvalPage("a & b", scores(), {"points": [figure]}, "mocap eval a b"))
    for words in (
        "a &amp; b",
        "a&lt;b&gt;.trc",
        "too &lt;far&gt;.",
        "What helps:",
        "taken as mm by the size of the body",
        "20 mm from the truth on average",
        "left knee",
        "not scored",
        "not known",
        "Procrustes-aligned (PA)",
        "Too few errors",
        "Too few common frames",
        "mocap eval a b",
    ):
        assert words in text, words
    assert text.count("<section") == text.count("</section>") == 9
    for absent in ("Actions</h2>", "Uncertainty</h2>", "In the pictures</h2>", "Lost limbs</h2>", "<far>"):
        assert absent not in text


@pytest.mark.parametrize(
    ("more", "words"),
    [
        ({"mean_error_mm": None}, "Nobody of the truth was found"),
        ({"unit_warning": "unit mistake"}, "A unit is probably wrong"),
        (
            {"epsilon_search": {"by_lilliefors_mm": 16.0, "by_r2_mm": 17.0, "mmtp_mm": 9.0, "mmtp_std_mm": 3.0,
                                    "mmta_percent": 50.0, "at_bound": True}},
            "no Gaussian part",
        ),
        ({"reliability": {"std_factor": 1.7, "calibration_error_percent": 30.0}}, "overconfident: multiplied by 1.70"),
        ({"reliability": {"std_factor": 0.5, "calibration_error_percent": 30.0}}, "too cautious"),
        ({"per_action": {"wave_both": {"frames": 3, "mean_error_mm": None}}}, "wave_both"),
        ({"per_person": {"1": {"mean_error_mm": 5.0}, "2": {"mean_error_mm": 6.0}}}, "Person"),
        (
            {"lost_limbs": {"precision": 0.75, "recall": 0.5, "f1": 0.6, "n_lost": 6, "n_said": 4, "n_scored": 64}},
            "Precision 75\u00a0%, recall 50\u00a0%",
        ),
        (
            {"lost_limbs": {"precision": None, "recall": None, "f1": None, "n_lost": 0, "n_said": 0, "n_scored": 64}},
            "None of 64 limbs",
        ),
        ({"image": {"epsilon_px": 5.0, "mean_error_px": 2.0, "per_camera": {"cam_0": {}}}}, "epsilon is 5 px"),
    ],
)  # fmt: skip
def test_sections_that_are_not_always_there(more: dict[str, Any], words: str) -> None:
    text = eval_html(EvalPage("t", scores(**more), {}))
    assert words in text.replace(" %", "\u00a0%")
