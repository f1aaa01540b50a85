"""Root-aligned, rigid and Procrustes-aligned errors against SciPy and by invariance."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import procrustes
from scipy.spatial.transform import Rotation

from mocap.data import LANDMARKS
from mocap.metrics import point_errors, point_scores, procrustes_aligned, root_aligned

SEEDS = st.integers(0, 2**32 - 1)
AT = LANDMARKS.index


def poses(seed, T=4, noise=0.05):
    rng = np.random.default_rng(seed)
    truth = rng.normal(0, 0.4, (T, 15, 3)) + rng.normal(0, 2, (T, 1, 3))
    return truth + rng.normal(0, noise, truth.shape), truth, rng


@settings(max_examples=20, deadline=None)
@given(SEEDS)
def test_similarity_agrees_with_scipy(seed):
    """SciPy scales both shapes to unit size; its disparity is our squared error over the truth's size."""
    estimate, truth, _ = poses(seed)
    ours = procrustes_aligned(estimate, truth)
    for t in range(len(truth)):
        _, _, disparity = procrustes(truth[t], estimate[t])
        size = ((truth[t] - truth[t].mean(axis=0)) ** 2).sum()
        assert ((ours[t] - truth[t]) ** 2).sum() / size == pytest.approx(disparity, rel=1e-9)


@settings(max_examples=20, deadline=None)
@given(SEEDS)
def test_rigid_fit_agrees_with_scipy(seed):
    estimate, truth, _ = poses(seed)
    ours = procrustes_aligned(estimate, truth, with_scale=False)
    for x, y, mine in zip(estimate, truth, ours, strict=True):
        R, _ = Rotation.align_vectors(y - y.mean(axis=0), x - x.mean(axis=0))
        np.testing.assert_allclose(mine, R.apply(x - x.mean(axis=0)) + y.mean(axis=0), atol=1e-8)


@settings(max_examples=20, deadline=None)
@given(SEEDS)
def test_aligned_errors_do_not_see_what_alignment_takes_out(seed):
    estimate, truth, rng = poses(seed)
    R, t = Rotation.random(rng=rng).as_matrix(), rng.normal(0, 5, 3)
    moved = estimate @ R.T + t
    for with_scale in (False, True):
        a = point_errors(procrustes_aligned(estimate, truth, with_scale=with_scale), truth)
        b = point_errors(procrustes_aligned(moved, truth, with_scale=with_scale), truth)
        np.testing.assert_allclose(a, b, atol=1e-6)
    scaled = point_errors(procrustes_aligned(1.7 * moved, truth), truth)
    np.testing.assert_allclose(scaled, point_errors(procrustes_aligned(estimate, truth), truth), atol=1e-6)
    a, b = (point_errors(root_aligned(x, truth), truth) for x in (estimate, estimate + t))
    np.testing.assert_allclose(a, b, atol=1e-6)


def test_squared_errors_never_grow_with_the_freedom_of_the_fit():
    estimate, truth, _ = poses(3, T=50)
    squares = [
        (point_errors(x, truth) ** 2).sum(axis=1)
        for x in (
            estimate,
            procrustes_aligned(estimate, truth, with_scale=False),
            procrustes_aligned(estimate, truth),
        )
    ]
    assert (squares[1] <= squares[0] + 1e-6).all()
    assert (squares[2] <= squares[1] + 1e-6).all()


def test_a_mirrored_body_is_not_mirrored_back():
    _, truth, _ = poses(5)
    mirrored = truth * [1, -1, 1]
    assert point_scores(procrustes_aligned(mirrored, truth), truth).mean_mm > 50.0


def test_root_is_the_pelvis_and_else_the_middle_of_the_hips():
    _, truth, _ = poses(6, T=3)
    estimate = truth + np.array([0.3, -0.2, 0.1])
    estimate[1, AT("pelvis")] = np.nan
    estimate[2, [AT("pelvis"), AT("left_hip")]] = np.nan
    errors = point_errors(root_aligned(estimate, truth), truth)
    assert np.nanmax(errors[:2]) < 1e-9
    assert np.isnan(errors[1, AT("pelvis")])
    assert np.isnan(errors[2]).all()


def test_unknown_landmarks_take_no_part_and_two_points_are_too_few():
    estimate, truth, _ = poses(7, T=3)
    whole = procrustes_aligned(estimate[:, 3:], truth[:, 3:])
    estimate[0, :3] = np.nan
    truth[1, :3] = np.nan
    estimate[2, 2:] = np.nan
    part = procrustes_aligned(estimate, truth)
    np.testing.assert_allclose(part[:2, 3:], whole[:2], atol=1e-12)
    assert np.isnan(part[0, :3]).all()
    assert np.isnan(part[2]).all()
    assert procrustes_aligned(estimate[:0], truth[:0]).shape == (0, 15, 3)
    with pytest.raises(ValueError, match="expected the same"):
        procrustes_aligned(estimate, truth[:2])
    with pytest.raises(ValueError, match="landmarks"):
        root_aligned(estimate[:, :4], truth[:, :4])
