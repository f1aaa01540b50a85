"""Clocks from silhouettes: points on a body that moves, filmed by cameras that begin when they like."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from eval.bench.scene import ring
from mocap.volume.synchrony import Silhouettes, Synchrony, silhouette_hull, synchronise, tangent_curves

Array = NDArray[np.float64]

C, FPS, N = 5, 30.0, 240
RIG = ring(C, (640, 480))
NOISE_PX = 0.4
# Of an estimate from 8 s of noisy outlines; half of it is what one camera alone would reach.
MS = 1.5
RNG = np.random.default_rng(4)
SHAPE = RNG.normal(0.0, 1.0, (60, 3)) * (0.15, 0.2, 0.5)


def body_at(time_s: float) -> Array:
    """Points (60, 3) m of somebody who walks a curve and nods."""
    turn = 0.9 * time_s
    R = np.array([[np.cos(turn), -np.sin(turn), 0], [np.sin(turn), np.cos(turn), 0], [0, 0, 1.0]])
    place = (0.7 * np.sin(0.8 * time_s), 0.5 * np.sin(1.3 * time_s + 1), 0.95 + 0.05 * np.sin(9 * time_s))
    return SHAPE @ R.T + place


def film(
    offset_s: Array, drift: Array, *, n: int = N, fps: float = FPS, moves: bool = True
) -> list[Silhouettes]:
    """What every camera sees, its k-th picture taken at offset + (1 + drift) k / fps."""
    noise = np.random.default_rng(7)
    seen = []
    for camera, o, d in zip(RIG, offset_s, drift, strict=True):
        times = np.arange(n) / fps
        hulls = []
        for t in times:
            uv, _ = camera.project(body_at(o + (1 + d) * t if moves else 0.0))
            hull = cv2.convexHull(uv.astype(np.float32)).reshape(-1, 2).astype(np.float64)
            hulls.append(hull + noise.normal(0, NOISE_PX, hull.shape))
        seen.append(Silhouettes(times, hulls))
    return seen


def offsets_of(found: Synchrony, true: Array) -> tuple[Array, Array]:
    """Found and true offsets against the camera that was chosen as reference."""
    reference = RIG.names.index(found.reference)
    return np.array([c.offset_s for c in found.clocks.values()]), true - true[reference]


def test_fractions_of_a_frame() -> None:
    true = np.array([0.0, 0.0114, -0.0213, 0.0, 0.0061])
    found, expected = offsets_of(synchronise(RIG, film(true, np.zeros(C))), true)
    np.testing.assert_allclose(found, expected, atol=MS / 1000)


def test_seconds_apart_and_longer_clips() -> None:
    true = np.array([0.0, 2.04, -1.51, 0.7, 3.3])
    seen = film(true, np.zeros(C))
    seen[3] = Silhouettes(seen[3].times_s[:150], seen[3].hulls[:150])
    found, expected = offsets_of(synchronise(RIG, seen), true)
    np.testing.assert_allclose(found, expected, atol=2 * MS / 1000)


def test_a_clock_that_drifts() -> None:
    drift = np.array([0.0, 0.0, 700e-6, 0.0, 0.0])
    found = synchronise(RIG, film(np.zeros(C), drift, n=900))
    clocks = list(found.clocks.values())
    assert [c.is_off for c in clocks] == [False, False, True, False, False]
    assert clocks[2].drift == pytest.approx(700e-6, abs=70e-6)
    assert clocks[0].drift == clocks[1].drift == 0.0 or abs(clocks[0].drift) < 1e-8


def test_cameras_of_another_rate() -> None:
    true = np.array([0.0, 0.25, 0.0, 0.0, 0.0])
    seen = film(true, np.zeros(C))
    fast = film(true, np.zeros(C), n=2 * N, fps=2 * FPS)
    seen[1] = fast[1]
    found, expected = offsets_of(synchronise(RIG, seen), true)
    np.testing.assert_allclose(found, expected, atol=MS / 1000)


def test_clocks_that_agree_are_left_alone() -> None:
    found = synchronise(RIG, film(np.zeros(C), np.zeros(C)))
    assert not any(c.is_off for c in found.clocks.values())
    assert all(c.is_certain for c in found.clocks.values())


def test_deviations_cover_the_error() -> None:
    true = np.array([0.0, 0.01, -0.02, 0.03, 0.005])
    found = synchronise(RIG, film(true, np.zeros(C)))
    values, expected = offsets_of(found, true)
    deviation = np.array([c.offset_std_s for c in found.clocks.values()])
    assert (np.abs(values - expected) < 3 * deviation + 1e-12).all()
    assert deviation.max() < 0.003


def test_nobody_moves() -> None:
    found = synchronise(RIG, film(np.zeros(C), np.zeros(C), moves=False))
    assert not any(c.is_certain or c.is_off for c in found.clocks.values())


def test_a_camera_that_sees_nobody_is_not_corrected() -> None:
    seen = film(np.array([0.0, 0.0, 0.1, 0.0, 0.0]), np.zeros(C))
    seen[4] = Silhouettes(seen[4].times_s, [np.zeros((0, 2))] * N)
    found = synchronise(RIG, seen)
    assert not found.clocks[RIG.names[4]].is_certain
    assert found.clocks[RIG.names[2]].offset_s == pytest.approx(0.1, abs=MS / 1000)


def test_a_silhouette_that_the_border_cuts_has_no_tangent_there() -> None:
    seen = film(np.zeros(C), np.zeros(C), n=12)

    def sides_seen() -> list[int]:
        """Sides of camera 0's planes, for each other camera, of which anything is known."""
        known = [
            p[0].other
            for p in tangent_curves(RIG, seen)
            if p[0].camera == 0 and np.isfinite(p[0].values).any()
        ]
        return [known.count(other) for other in range(1, C)]

    # Between it and the two cameras across, people stand too near to the line.
    assert sides_seen() == [2, 0, 0, 2]
    # The legs are below the picture.
    border = RIG[0].size[1] - 1.0
    seen[0] = Silhouettes(
        seen[0].times_s,
        [
            np.column_stack([h[:, 0], np.where(h[:, 1] > h[:, 1].mean(), border, h[:, 1])])
            for h in seen[0].hulls
        ],
    )
    assert sides_seen() == [1, 0, 0, 1]


def test_hull_of_a_mask_leaves_specks_out() -> None:
    mask = np.zeros((100, 120), dtype=np.bool_)
    mask[20:80, 30:50] = True
    mask[5, 110] = True
    hull = silhouette_hull(mask)
    assert sorted(map(tuple, hull.tolist())) == [(30, 20), (30, 79), (49, 20), (49, 79)]
    assert silhouette_hull(np.zeros((10, 10), dtype=np.bool_)).shape == (0, 2)


def test_as_many_silhouettes_as_cameras() -> None:
    with pytest.raises(ValueError, match="2 silhouettes for 5 cameras"):
        synchronise(RIG, film(np.zeros(C), np.zeros(C), n=5)[:2])


def hull_by_definition(mask: np.ndarray) -> set[tuple[float, ...]]:
    """Corners of the convex hull of all pixels in regions of a tenth of the largest."""
    _, labels, stats, _ = cv2.connectedComponentsWithStats(mask.astype(np.uint8), connectivity=8)
    areas = stats[:, cv2.CC_STAT_AREA].copy()
    areas[0] = 0
    if areas.max() < 2e-4 * mask.size:
        return set()
    v, u = np.nonzero((areas >= 0.1 * areas.max())[labels])
    return set(map(tuple, cv2.convexHull(np.column_stack([u, v]).astype(np.float32)).reshape(-1, 2).tolist()))


@pytest.mark.parametrize("blur", [1, 2, 3, 5, 9])
def test_silhouette_hulls_are_those_of_the_large_regions(blur: int) -> None:
    """From speckles of single pixels to blots, with a mask of nothing and a full one."""
    rng = np.random.default_rng(blur)
    masks = [cv2.blur(rng.random((41, 56)), (blur, blur)) > share for share in (0.45, 0.5, 0.6, 0.95, 0.0)]
    for mask in [*masks, np.zeros((41, 56), dtype=np.bool_)]:
        assert set(map(tuple, silhouette_hull(mask).tolist())) == hull_by_definition(mask)
