"""Compiled loops over masks against their definitions."""

import numpy as np
import pytest

from mocap.volume import _mask_kernels as kernels


def masks() -> list[np.ndarray]:
    rng = np.random.default_rng(0)
    some = np.zeros((23, 34), dtype=np.uint8)
    some[5:17, 3:30] = rng.random((12, 27)) < 0.5
    last = np.zeros_like(some)
    last[-1, -1] = 1
    return [some, np.zeros_like(some), np.ones_like(some), last]


@pytest.mark.parametrize("mask", masks())
def test_rectangle_holds_the_foreground_and_nothing_more(mask: np.ndarray) -> None:
    v, u = np.nonzero(mask)
    expected = (u.min(), u.max(), v.min(), v.max()) if len(v) else (0, -1, 0, -1)
    assert kernels.rectangle_of(mask) == expected


@pytest.mark.parametrize("mask", masks())
def test_cells_count_their_foreground(mask: np.ndarray) -> None:
    counts = np.zeros((7, 9), dtype=np.uint8)
    kernels.count_in_cells(mask, counts)
    np.testing.assert_array_equal(
        counts[:5, :8], mask[:20, :32].reshape(5, 4, 8, 4).sum(axis=(1, 3), dtype=np.uint8)
    )
    assert not counts[5:].any()
    assert not counts[:, 8:].any()


def test_copied_foreground_leaves_nothing_of_the_one_before() -> None:
    own, rectangle = np.zeros((23, 34), dtype=np.uint8), np.array([0, -1, 0, -1])
    for mask in masks() + masks()[::-1]:
        kernels.copy_foreground(mask, own, rectangle)
        np.testing.assert_array_equal(own, mask)
        assert tuple(rectangle) == kernels.rectangle_of(mask)
