"""A sample of the silhouettes' pixels, and the rays through those of one person."""

from __future__ import annotations

import numpy as np
import pytest

from mocap.data import Camera, CameraRig
from mocap.data.pixels import SilhouettePixels, lattice_step
from mocap.foreground.pixels import sample_silhouettes
from mocap.likelihood.colours import colour_bins_of_pixels, person_rays

SIZE = (320, 240)


def camera(name: str, x: float, dist: tuple[float, ...] = ()) -> Camera:
    """Looks along +y from (x, -3, 1)."""
    K = np.array([[250.0, 0.0, 160.0], [0.0, 250.0, 120.0], [0.0, 0.0, 1.0]])
    R = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
    return Camera(name=name, size=SIZE, K=K, dist=np.array(dist), R=R, t=-R @ np.array([x, -3.0, 1.0]))


def ball(center: tuple[float, float, float], radius: float = 0.3) -> np.ndarray:
    """Points on a sphere, (N, 3) m."""
    rng = np.random.default_rng(0)
    points = rng.normal(size=(4000, 3))
    return np.array(center) + radius * points / np.linalg.norm(points, axis=1, keepdims=True)


def picture_of(
    view: Camera, balls: list[tuple[np.ndarray, tuple[int, int, int]]]
) -> tuple[np.ndarray, np.ndarray]:
    """Mask and picture of some balls of one colour each."""
    mask, picture = np.zeros(SIZE[::-1], dtype=np.bool_), np.zeros((*SIZE[::-1], 3), dtype=np.uint8)
    for points, colour in balls:
        col, row = np.rint(view.project(points)[0]).astype(int).T
        for dv in range(-3, 4):
            for du in range(-3, 4):
                at = np.clip(row + dv, 0, SIZE[1] - 1), np.clip(col + du, 0, SIZE[0] - 1)
                mask[at] = True
                picture[at] = colour
    return mask, picture


def test_the_sample_lies_in_the_masks_and_has_their_colours() -> None:
    rig = CameraRig((camera("a", 0.0), camera("b", 0.5)))
    seen = [picture_of(c, [(ball((0.0, 0.0, 1.0)), (200, 40, 20))]) for c in rig]
    pixels = sample_silhouettes([m for m, _ in seen], [p for _, p in seen])
    assert set(pixels.camera.tolist()) == {0, 1}
    step = lattice_step(SIZE[0])
    for c, (mask, _) in enumerate(seen):
        uv = pixels.uv[pixels.camera == c]
        assert mask[uv[:, 1], uv[:, 0]].all()
        assert len(uv) == pytest.approx(mask.sum() / step**2, rel=0.2)
    inner = np.median(pixels.rgb, axis=0)
    assert inner.tolist() == [200, 40, 20]


def test_a_colour_is_the_mean_of_its_neighbourhood() -> None:
    picture = np.zeros((*SIZE[::-1], 3), dtype=np.uint8)
    first = max(1, lattice_step(SIZE[0]) // 2)
    picture[first, first] = 90
    pixels = sample_silhouettes([np.ones(SIZE[::-1], dtype=np.bool_)], [picture])
    assert pixels.rgb[0].tolist() == [10, 10, 10]


def test_cameras_that_are_not_used_and_sessions_without_pictures_give_nothing() -> None:
    mask = np.ones(SIZE[::-1], dtype=np.bool_)
    picture = np.zeros((*SIZE[::-1], 3), dtype=np.uint8)
    only = sample_silhouettes([mask, mask], [picture, picture], np.array([False, True]))
    assert set(only.camera.tolist()) == {1}
    none = sample_silhouettes([mask, mask], None)
    assert len(none.camera) == len(none.uv) == len(none.rgb) == 0
    empty = sample_silhouettes([np.zeros_like(mask)], [picture])
    assert len(empty.camera) == 0


@pytest.mark.parametrize("dist", [(), (-0.2, 0.05, 0.001, -0.001, 0.0)])
def test_rays_pass_where_the_person_is(dist: tuple[float, ...]) -> None:
    rig = CameraRig((camera("a", -0.4, dist), camera("b", 0.4, dist)))
    points = ball((0.0, 0.0, 1.0))
    seen = [picture_of(c, [(points, (200, 40, 20))]) for c in rig]
    pixels = sample_silhouettes([m for m, _ in seen], [p for _, p in seen])
    rays = person_rays(rig, pixels, points)
    assert len(rays) > 50
    np.testing.assert_allclose(np.linalg.norm(rays.directions, axis=1), 1.0)
    to = np.array([0.0, 0.0, 1.0]) - rays.origins[rays.camera]
    along = (to * rays.directions).sum(axis=1)
    gap = np.linalg.norm(to - along[:, None] * rays.directions, axis=1)
    assert gap.max() < 0.3 + 0.08
    assert (np.bincount(rays.bins).max() / len(rays)) > 0.6
    assert (
        colour_bins_of_pixels(np.array([[200, 40, 20]], dtype=np.uint8))[0] == np.bincount(rays.bins).argmax()
    )


def test_pixels_of_another_person_are_left_out() -> None:
    rig = CameraRig((camera("a", 0.0),))
    own, other = ball((-0.5, 0.0, 1.0)), ball((0.5, 0.0, 1.0))
    mask, picture = picture_of(rig[0], [(own, (200, 40, 20)), (other, (20, 40, 200))])
    pixels = sample_silhouettes([mask], [picture])
    rays = person_rays(rig, pixels, own, other)
    assert 0 < len(rays) < len(pixels.camera)
    assert (rays.directions[:, 0] < 0).all()
    covered = person_rays(rig, pixels, own, own)
    assert len(covered) == 0


def test_no_pixels_give_no_rays() -> None:
    rig = CameraRig((camera("a", 0.0),))
    none = SilhouettePixels(
        np.zeros(0, dtype=np.uint8), np.zeros((0, 2), dtype=np.int16), np.zeros((0, 3), dtype=np.uint8)
    )
    assert len(person_rays(rig, none, ball((0.0, 0.0, 1.0)))) == 0
