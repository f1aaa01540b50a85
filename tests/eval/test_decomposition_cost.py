"""The cost script: its object, its fit, and that it sees the work of the filters."""

import numpy as np
import pytest

from eval.decomposition_cost import Cheap, arms_layout, exponent, milliseconds
from mocap.filters.parts import part_sets


def test_the_object_has_a_centre_and_arms() -> None:
    layout = arms_layout(3, 4)
    assert layout.n_parts == 10
    assert layout.n_columns == 12
    assert [len(s) for s in part_sets(layout)] == [1, 3, 3, 3]


def test_the_exponent_of_a_power_is_found() -> None:
    sizes = [10, 20, 40, 80, 160]
    assert exponent(sizes, [3.0 * n**1.5 for n in sizes]) == pytest.approx(1.5)


def test_a_part_is_likely_where_its_first_column_is_small() -> None:
    layout = arms_layout(2, 2)
    x = np.arange(10.0).reshape(2, 5)
    np.testing.assert_array_equal(Cheap(layout).log_likelihood(x, [2, 0]), -50.0 * x[:, [4, 0]] ** 2)


@pytest.mark.parametrize(("name", "swaps"), [("ps", False), ("sbps", True), ("pfcr", False)])
def test_times_are_measured(name: str, swaps: bool) -> None:
    resampling, swapping = milliseconds(name, arms_layout(2, 3), 50)
    assert resampling > 0
    assert (swapping > 0) == swaps
