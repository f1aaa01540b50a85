"""The largest channel of a picture is what numpy says."""

from __future__ import annotations

import numpy as np
import pytest

from mocap.arrays import largest_channel


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float32])
@pytest.mark.parametrize("n_channels", [1, 2, 3, 4])
def test_is_the_largest(dtype: type, n_channels: int) -> None:
    picture = np.random.default_rng(4).integers(0, 256, (5, 7, n_channels)).astype(dtype)
    found = largest_channel(picture)
    assert found.dtype == dtype
    np.testing.assert_array_equal(found, picture.max(axis=2))


def test_what_is_not_known_stays_so() -> None:
    picture = np.array([[[1.0, np.nan, 3.0], [2.0, 5.0, 4.0]]])
    np.testing.assert_array_equal(largest_channel(picture), [[np.nan, 5.0]])
