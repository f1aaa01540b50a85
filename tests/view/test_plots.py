"""Plots: each returns a PNG that shows its data, and none touches matplotlib's global state."""

from __future__ import annotations

import subprocess
import sys

import cv2
import numpy as np

from mocap.data import LANDMARKS
from mocap.view.plots import (
    plot_error_over_time,
    plot_landmark_errors,
)

T = 23


def decoded(png: bytes) -> np.ndarray:
    assert png.startswith(b"\x89PNG")
    image = cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_COLOR)
    assert image is not None
    assert min(image.shape[:2]) > 100
    assert image.std() > 5  # a blank figure has next to none
    return image


def test_errors_over_time_survive_missing_values():
    errors = np.random.default_rng(0).uniform(10, 150, (T, 15))
    errors[3:6] = np.nan
    errors[:, 2] = np.nan
    full = decoded(plot_error_over_time({1: (np.arange(T), errors), 2: (np.arange(T - 4), errors[4:])}))
    assert full.shape[0] > decoded(plot_error_over_time({1: (np.arange(T), errors)})).shape[0]
    decoded(plot_error_over_time({1: (np.arange(T), errors * np.nan)}))
    decoded(plot_error_over_time({}))
    decoded(plot_error_over_time({1: (np.arange(1), errors[:1])}))


def test_landmark_bars():
    means = dict(zip(LANDMARKS, np.linspace(20, 120, 15), strict=True))
    decoded(plot_landmark_errors(means, dict.fromkeys(LANDMARKS, 12.0)))
    decoded(plot_landmark_errors({**means, "head": float("nan")}))
    decoded(plot_landmark_errors({}))


def test_same_data_gives_the_same_bytes():
    assert plot_landmark_errors({"head": 1.0}) == plot_landmark_errors({"head": 1.0})


def test_matplotlib_and_rerun_are_imported_only_when_needed():
    code = (
        "import sys, mocap.view; print([m for m in ('matplotlib', 'rerun', 'pyarrow') if m in sys.modules])"
    )
    answer = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert answer.stdout.strip() == "[]"
    code = "import sys; from mocap.view import plot_landmark_errors as plot; plot({'head': 1.0}); "
    code += "print('matplotlib.pyplot' in sys.modules)"
    answer = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert answer.stdout.strip() == "False"
