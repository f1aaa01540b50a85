"""The corner error of the decomposition papers."""

import numpy as np
import pytest

from mocap.polygons import corner_error


def test_a_shift_counts_once_per_corner() -> None:
    truth = np.random.default_rng(0).uniform(0, 100, (3, 7, 2))
    assert corner_error(truth, truth).tolist() == [0.0, 0.0, 0.0]
    np.testing.assert_allclose(corner_error(truth + np.array([3.0, -4.0]), truth), 7 * 5.0)


def test_distances_are_summed_not_squared() -> None:
    truth = np.zeros((5, 2))
    corners = truth.copy()
    corners[0] = [6.0, 8.0]
    corners[3] = [0.0, -2.0]
    assert corner_error(corners, truth) == pytest.approx(12.0)


def test_a_missing_corner_is_not_an_error_of_zero() -> None:
    truth = np.zeros((2, 4, 2))
    corners = truth.copy()
    corners[1, 2, 0] = np.nan
    error = corner_error(corners, truth)
    assert error[0] == 0.0
    assert np.isnan(error[1])


def test_other_polygons_are_refused() -> None:
    with pytest.raises(ValueError, match="corners"):
        corner_error(np.zeros((3, 8, 2)), np.zeros((3, 7, 2)))
