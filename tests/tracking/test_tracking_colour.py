"""Colour models in closed form, and the bins against OpenCV."""

import cv2
import numpy as np
import pytest

from mocap.tracking import _kernels
from mocap.tracking.colour import (
    BINS_PER_CHANNEL,
    N_BINS,
    adapt,
    banded_histogram,
    bhattacharyya,
    colour_bins,
    similar_colours,
)


def test_bins_are_those_of_opencv_and_unknown_colours_have_none():
    rng = np.random.default_rng(1)
    rgb = rng.integers(0, 256, (4000, 3), dtype=np.uint8)
    rgb[:8] = np.array(np.meshgrid(*[[0, 255]] * 3)).reshape(3, 8).T
    known = np.arange(4000) % 7 != 3
    y, cr, cb = (cv2.cvtColor(rgb[None], cv2.COLOR_RGB2YCrCb)[0].astype(int) * BINS_PER_CHANNEL // 256).T
    expected = np.where(known, (y * BINS_PER_CHANNEL + cb) * BINS_PER_CHANNEL + cr, -1)
    np.testing.assert_array_equal(colour_bins(rgb, known), expected)
    assert expected.max() < N_BINS


def test_histogram_is_split_by_height_and_sums_to_one():
    centers = np.array([[0, 0, 0.2], [0, 0, 0.9], [0, 0, 1.0], [0, 0, 1.5], [0, 0, 2.0], [0, 0, 1.9]])
    bins = np.array([5, 5, 7, 7, 9, -1], dtype=np.int32)
    histogram, n = banded_histogram(bins, centers, np.arange(6))
    assert n == 5
    assert histogram.sum() == pytest.approx(1.0)
    # Bands end at 0.5 and 0.82 of 2.0 m.
    assert histogram[0, 5] == pytest.approx(2 / 5)
    assert histogram[1, 7] == pytest.approx(2 / 5)
    assert histogram[2, 9] == pytest.approx(1 / 5)
    empty, none = banded_histogram(bins, centers, np.array([5]))
    assert (none, empty.sum()) == (0, 0.0)


def test_bhattacharyya_is_one_for_equals_and_zero_for_strangers():
    p = np.array([0.5, 0.5, 0, 0])
    assert bhattacharyya(p, p) == pytest.approx(1.0)
    assert bhattacharyya(p, np.array([0, 0, 0.3, 0.7])) == 0.0
    assert bhattacharyya(p, np.array([0.5, 0, 0.5, 0])) == pytest.approx(0.5)
    assert bhattacharyya(p, np.array([1.0, 0, 0, 0])) == pytest.approx(np.sqrt(0.5))


def test_adaptation_forgets_geometrically_and_leaves_no_denormal_numbers():
    old, new = np.array([1.0, 0.0], dtype=np.float32), np.array([0.0, 1.0], dtype=np.float32)
    model = old
    for _ in range(10):
        model = adapt(model, new, 0.9)
    assert model[0] == pytest.approx(0.9**10)
    assert model.sum() == pytest.approx(1.0)
    for _ in range(400):
        model = adapt(model, new, 0.9)
    assert model[0] == 0.0


def test_similar_colours_hold_the_stated_share():
    histogram = np.array([0.05, 0.4, 0.1, 0.3, 0.15, 0.0])
    assert np.flatnonzero(similar_colours(histogram, 0.8)).tolist() == [1, 3, 4]
    assert np.flatnonzero(similar_colours(histogram, 0.7)).tolist() == [1, 3]
    assert np.flatnonzero(similar_colours(histogram, 1.0)).tolist() == [0, 1, 2, 3, 4]
    assert not similar_colours(np.zeros(4)).any()


def test_kernels_equal_their_python():
    rng = np.random.default_rng(2)
    rgb = rng.integers(0, 256, (60, 3), dtype=np.uint8)
    known = rng.random(60) < 0.7
    centers = rng.random((60, 3))
    fast, slow = np.empty(60, dtype=np.int32), np.empty(60, dtype=np.int32)
    _kernels.colour_bins(rgb, known, 21, fast)
    _kernels.colour_bins.py_func(rgb, known, 21, slow)
    np.testing.assert_array_equal(fast, slow)
    rows, edges = np.arange(0, 60, 2), np.array([0.3, 0.6])
    a, b = np.zeros((3, N_BINS)), np.zeros((3, N_BINS))
    assert _kernels.add_histogram(fast, centers, rows, edges, a) == _kernels.add_histogram.py_func(
        fast, centers, rows, edges, b
    )
    np.testing.assert_array_equal(a, b)
