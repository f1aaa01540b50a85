"""What pieces of a volume cover in the pictures, and how much of that is theirs alone."""

import numpy as np
import pytest
from marker_world import ring

from mocap.data.covered import Covered

RIG = ring(4, size=(320, 248), dist=np.zeros(4))


def post(x, y, half_m=0.2):
    rows = np.arange(-half_m, half_m + 0.01, 0.02)
    grid = np.meshgrid(x + rows, y + rows, np.arange(0.0, 1.6, 0.02), indexing="ij")
    return np.stack(grid, axis=-1).reshape(-1, 3)


def covered(*posts, **more):
    labels = np.concatenate([np.full(len(points), i) for i, points in enumerate(posts)])
    return Covered(more.pop("rig", RIG), np.concatenate(posts), labels, len(posts), **more)


def test_who_stands_apart_has_his_pixels_for_himself():
    apart = covered(post(-0.7, -0.7), post(0.7, -0.7))
    assert apart.own_share(0) > 0.9
    assert apart.own_share(1) > 0.9


def test_what_is_within_another_has_no_pixels_of_its_own():
    within = covered(post(0.0, 0.0, 0.1), post(0.0, 0.0, 0.3))
    assert within.own_share(0) == 0.0
    assert within.own_share(1) > 0.5
    assert within.own_share(0, np.array([False, True])) == 1.0, "what is gone covers nothing"


@pytest.mark.parametrize(("names", "is_own"), [("013", True), ("012", False)])
def test_the_median_camera_decides(names, is_own):
    """Of two posts in line with two cameras that face each other, the thin one has pixels of its own in the others."""
    first = RIG.cameras[0]
    away = (first.R.T @ first.t)[:2]
    rig = RIG.subset([f"cam_{name}" for name in names])
    thin = post(*(0.7 * away / np.linalg.norm(away)), 0.1)
    assert (covered(post(0.0, 0.0, 0.3), thin, rig=rig).own_share(1) > 0.5) == is_own


def test_a_camera_that_sees_hardly_anything_of_a_piece_has_no_say():
    """Within another, and ten points of it alone beside."""
    within, around = post(0.0, 0.0, 0.1), post(0.0, 0.0, 0.3)
    beside = np.array([[0.9, -0.9, 0.1 * k] for k in range(10)])
    assert covered(within, around).own_share(0) == 0.0
    assert covered(beside, around).own_share(0) == 1.0
    assert covered(within[:10], around).own_share(0) == 1.0


def test_only_pixels_of_the_silhouettes_count():
    masks = [np.zeros(camera.size[::-1], dtype=np.bool_) for camera in RIG]
    posts = post(-0.7, -0.7), post(0.7, -0.7)
    nobody = covered(*posts, masks=masks)
    assert nobody.own_share(0) == 1.0, "no camera has a say"
    assert covered(*posts, masks=[~mask for mask in masks]).own_share(0) == covered(*posts).own_share(0)
