"""Points from several views: exact on perfect data, least squares on noise, and found without correspondence."""

from __future__ import annotations

import numpy as np
import pytest
from marker_world import ring

from mocap.geometry.triangulation import triangulate, triangulate_unlabelled

RIG = ring(5, dist=np.zeros(4))
P = np.stack([c.K @ np.column_stack([c.R, c.t]) for c in RIG])
EXACT_M = 1e-8


def points(n: int) -> np.ndarray:
    return np.random.default_rng(0).uniform([-0.5, -0.5, 0.2], [0.5, 0.5, 1.7], (n, 3))


def views_of(x: np.ndarray) -> np.ndarray:
    """(n, C, 2)."""
    return np.stack([camera.project(x)[0] for camera in RIG], axis=1)


def test_perfect_pixels_give_the_point_back() -> None:
    x = points(9)
    np.testing.assert_allclose(triangulate(P, views_of(x)), x, atol=EXACT_M)


def test_views_that_do_not_see_the_point_are_left_out() -> None:
    x = points(4)
    uv = views_of(x)
    uv[0, 2:] = np.nan
    uv[1, 1:] = np.nan
    uv[2] = np.nan
    found = triangulate(P, uv)
    np.testing.assert_allclose(found[[0, 3]], x[[0, 3]], atol=EXACT_M)
    assert np.isnan(found[1:3]).all()


def test_parallel_rays_have_no_point() -> None:
    uv = views_of(points(1))[:, [0, 0]]
    assert np.isnan(triangulate(P[[0, 0]], uv)).all()


def test_no_points_give_no_points() -> None:
    assert triangulate(P, np.zeros((0, 5, 2))).shape == (0, 3)


def test_more_views_are_more_accurate() -> None:
    x = points(300)
    noisy = views_of(x) + np.random.default_rng(1).standard_normal((300, 5, 2))
    two, five = (np.linalg.norm(triangulate(P[:n], noisy[:, :n]) - x, axis=1).mean() for n in (2, 5))
    assert five < 0.8 * two


def test_unlabelled_points_are_found_amid_false_detections() -> None:
    x = points(8)
    rng = np.random.default_rng(2)
    uv = views_of(x) + 0.3 * rng.standard_normal((8, 5, 2))
    detections = [
        rng.permutation(np.concatenate([uv[:, c], rng.uniform([60, 20], [260, 230], (6, 2))]))
        for c in range(5)
    ]
    found = triangulate_unlabelled(P, detections, max_error_px=2.0, min_views=4)
    nearest = np.linalg.norm(x[:, None] - found.points[None], axis=2).min(axis=1)
    assert np.all(nearest < 0.02)
    assert len(found.points) <= 10
    assert np.all(found.n_views >= 4)
    assert np.all(found.error_px <= 2.0)
    assert np.all(np.diff(found.n_views[:4]) <= 0)


def test_order_of_detections_is_irrelevant() -> None:
    uv = views_of(points(5))
    rng = np.random.default_rng(3)
    a = triangulate_unlabelled(P, [uv[:, c] for c in range(5)], max_error_px=1.0, min_views=3)
    b = triangulate_unlabelled(
        P, [rng.permutation(uv[:, c]) for c in range(5)], max_error_px=1.0, min_views=3
    )
    np.testing.assert_allclose(a.points[np.lexsort(a.points.T)], b.points[np.lexsort(b.points.T)], atol=1e-6)


def test_nothing_seen_gives_no_point() -> None:
    none = [np.zeros((0, 2))] * 5
    assert triangulate_unlabelled(P, none, max_error_px=2.0, min_views=2).points.shape == (0, 3)
    one = [np.array([[100.0, 100.0]]), *none[1:]]
    assert triangulate_unlabelled(P, one, max_error_px=2.0, min_views=2).points.shape == (0, 3)
    with pytest.raises(ValueError, match="min_views"):
        triangulate_unlabelled(P, none, max_error_px=2.0, min_views=1)
