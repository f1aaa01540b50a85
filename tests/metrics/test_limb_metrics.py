"""Scores of lost limbs in closed form, and limbs in hulls of plain boxes."""

import numpy as np
import pytest

from mocap.data import VoxelGrid
from mocap.metrics import limb_scores, share_in_hull


def test_counts_are_the_closed_form() -> None:
    """Truth 3 lost of 8, said 4, two in common: precision 1/2, recall 2/3, F1 4/7."""
    lost = np.array([[1, 1, 1, 0], [0, 0, 0, 0]], dtype=bool)
    said = np.array([[1, 1, 0, 0], [1, 0, 0, 1]], dtype=bool)
    scores = limb_scores(lost, said)
    assert (scores.precision, scores.recall) == (0.5, 2 / 3)
    assert scores.f1 == pytest.approx(4 / 7)
    assert (scores.n_lost, scores.n_said, scores.n_scored) == (3, 4, 8)
    known = np.ones_like(lost)
    known[1] = False
    assert limb_scores(lost, said, known).precision == 1.0
    assert limb_scores(lost, said, known).n_scored == 4


def test_perfect_and_undefined() -> None:
    lost = np.array([[True, False, True]])
    assert limb_scores(lost, lost).f1 == 1.0
    assert limb_scores(lost, ~lost).f1 == 0.0
    nothing = limb_scores(np.zeros_like(lost), np.zeros_like(lost))
    assert (nothing.precision, nothing.recall, nothing.f1) == (None, None, None)
    assert limb_scores(lost, np.zeros_like(lost)).precision is None
    assert limb_scores(lost, np.zeros_like(lost)).f1 == 0.0
    with pytest.raises(ValueError, match="shapes"):
        limb_scores(lost, lost[:, :2])


def test_share_of_a_leg_in_a_hull_that_ends_at_the_knee() -> None:
    grid = VoxelGrid(np.zeros(3), (10, 12, 14), 0.1)
    hip, knee, ankle = np.array([[0.5, 0.6, 1.2], [0.5, 0.6, 0.7], [0.5, 0.6, 0.2]])
    inside = np.argwhere(np.ones(grid.shape, dtype=bool))
    above = grid.linear(inside[inside[:, 2] >= 7])
    assert share_in_hull(np.array([hip, knee]), above, grid) == 1.0
    assert share_in_hull(np.array([knee, ankle]), above, grid) == 0.0
    assert share_in_hull(np.array([hip, knee, ankle]), above, grid) == 0.5
    assert share_in_hull(np.array([hip, knee]), above[:0], grid) == 0.0
    assert np.isnan(share_in_hull(np.array([hip, [np.nan, 0, 0]]), above, grid))
