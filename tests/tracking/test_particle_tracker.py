"""Likelihoods of the particle filter in closed form, exclusion zones, and the filter's estimate."""

import numpy as np
import pytest
from bodies import BLUE, RED, SIDE, box, observe, person, run, settings

from mocap.tracking import _kernels, published_settings
from mocap.tracking.claims import claim_of, frame_of
from mocap.tracking.colour import N_BINS, banded_histogram
from mocap.tracking.particle import estimate, exclusion, particle_likelihoods, start, systematic
from mocap.tracking.state import Track

RNG = np.random.default_rng


def frame(boxes, **changes):
    s = settings(tracker="particle", **changes)
    return frame_of(observe(boxes, side=s.voxel_size_m), s)


def test_overlap_is_one_in_a_solid_zero_in_the_air_and_half_at_a_wall():
    """A block that reaches below the floor's ellipsoid in every direction, cut at x = 0."""
    block = frame([box(-0.5, 0, 0.5, 1.0, 0.0, 2.4)])
    inside, half, outside = particle_likelihoods(
        np.array([[-0.5, 0, 0.9], [0.0, 0, 0.9], [1.0, 0, 0.9]]), None, block
    )[0]
    assert inside == 1.0
    assert half == pytest.approx(0.5, abs=0.02)
    assert outside == 0.0


def test_overlap_of_an_ellipsoid_with_a_column_has_a_closed_form():
    """A thin column through the middle: its share is (side / s_x)^2 * 2 s_z / (4/3 pi s_z) of the volume."""
    column = frame([box(0, 0, 0.1, 0.1, 0.0, 2.0)], voxel_size_m=0.025)
    (share,) = particle_likelihoods(np.array([[0.0, 0.0, 0.9]]), None, column)[0]
    # Integral of the ellipsoid's height over the square of half side a.
    a, s = 0.1, 0.3
    x = (np.arange(400) + 0.5) / 400 * 2 * a - a
    d2 = (x[:, None] ** 2 + x[None, :] ** 2) / s**2
    exact = (2 * 0.9 * np.sqrt(1 - d2)).mean() * (2 * a) ** 2 / (4 / 3 * np.pi * s * s * 0.9)
    assert share == pytest.approx(exact, rel=0.02)


def test_colour_share_is_one_for_the_own_clothes_and_zero_for_others():
    two = frame(person(-0.8, 0, RED, RED) + person(0.8, 0, BLUE, BLUE))
    rows = np.flatnonzero((two.voxels.centers[:, 0] < 0) & (two.voxels.centers[:, 2] < 1.4))
    reference = banded_histogram(two.bins, two.voxels.centers, rows)[0].sum(axis=0)
    near, far, nobody = particle_likelihoods(
        np.array([[-0.8, 0, 0.6], [0.8, 0, 0.6], [0, 2.0, 0.6]]), reference, two
    )[1]
    assert near == pytest.approx(1.0, abs=1e-6)
    assert (far, nobody) == (0.0, 0.0)


def test_exclusion_compares_the_particle_with_the_other_target():
    """Reading guide 4: the printed function has no particle in it."""
    here = np.array([[0.0, 0.0], [0.3, 0.0], [3.0, 0.0]])
    np.testing.assert_allclose(exclusion(here, np.array([[0.0, 0.0]]), 0.3), [0.0, 1 - np.exp(-1), 1.0])
    two = np.array([[0.0, 0.0], [0.6, 0.0]])
    expected = (1 - np.exp(-1)) ** 2
    np.testing.assert_allclose(exclusion(here[1:2], two, 0.3), [expected])
    np.testing.assert_array_equal(exclusion(here, np.zeros((0, 2)), 0.3), [1, 1, 1])
    assert exclusion(here[1:2], two, 0.3, scale=4.0)[0] > expected


def test_exclusion_keeps_particles_out_of_the_neighbour():
    """Beside a twin, 60 cm apart: the estimates with exclusion zones are further apart than without."""
    clip = [person(-0.8 + 0.05 * i, 0) + person(0.8 - 0.05 * i, 0) for i in range(11)]
    clip += [person(-0.3, 0) + person(0.3, 0)] * 8
    gap = {}
    for scale in (1e6, 1.0):  # a zone of no size, and that of a person
        s = settings(
            tracker="particle", estimate="filter", colour=False, exclusion_scale=scale, n_samples=200
        )
        infos, _ = run(clip, s, seed=3)
        a, b = (t.xyz[0] for t in infos[-1].tracks)
        gap[scale] = abs(a - b)
    assert gap[1.0] > gap[1e6]  # 0.54 to 0.57 m against 0.48 to 0.51 m over ten seeds


@pytest.mark.parametrize("colour", [False, True])
def test_filter_estimate_follows_a_person(colour):
    """The likelihood is flat and nothing predicts: the published filter lags; with the person's speed less."""
    xs = np.linspace(-1.5, 1.5, 60)
    clip = [person(x, 0.3, RED) for x in xs]
    error = {}
    for motion in ("none", "velocity"):
        s = published_settings(
            "particle", SIDE, colour=colour, fps=20.0, confirm_frames=3, n_samples=200, motion=motion
        )
        infos, _ = run(clip, s, seed=5)
        gaps = [np.hypot(*(i.tracks[0].xyz[:2] - (x, 0.3))) for i, x in zip(infos, xs, strict=True)]
        error[motion] = np.mean(gaps)
        assert all(np.linalg.eigvalsh(i.tracks[0].covariance).min() > 0 for i in infos)
    assert error["none"] < 0.25  # 0.12 to 0.19 m over twelve seeds
    assert error["velocity"] < 0.13  # 0.06 to 0.10 m


def test_systematic_counts_are_floor_or_ceiling():
    rng = RNG(0)
    for _ in range(50):
        w = rng.random(17) * (rng.random(17) < 0.6) + 1e-12
        w /= w.sum()
        n = int(rng.integers(1, 60))
        count = np.bincount(systematic(w, n, rng.random()), minlength=17)
        assert count.sum() == n
        assert (np.abs(count - n * w) < 1 + 1e-9).all()
    assert systematic(np.array([0.0, 1.0, 0.0]), 5, 0.999999).tolist() == [1] * 5


def test_kernels_equal_their_python():
    rng = RNG(4)
    points = np.unique(np.floor(rng.random((400, 3)) * [6, 7, 9]), axis=0) * SIDE + SIDE / 2
    particles = rng.random((7, 3)) * [0.4, 0.4, 0.5]
    below = [np.zeros((6, 7, 10), dtype=np.int16) for _ in range(2)]
    _kernels.fill_columns(points, np.zeros(3), SIDE, below[0])
    _kernels.fill_columns.py_func(points, np.zeros(3), SIDE, below[1])
    np.testing.assert_array_equal(*below)
    raw = np.empty((2, 7))
    _kernels.overlap_shares(particles, 0.2, 0.3, SIDE, np.zeros(3), below[0], raw[0])
    _kernels.overlap_shares.py_func(particles, 0.2, 0.3, SIDE, np.zeros(3), below[0], raw[1])
    np.testing.assert_allclose(raw[0], raw[1], rtol=1e-12)
    # The same by counting lattice points one by one.
    lattice = (
        np.stack(np.meshgrid(*[np.arange(-30, 40)] * 3, indexing="ij"), axis=-1).reshape(-1, 3) * SIDE
        + SIDE / 2
    )
    for p, value in zip(particles, raw[0], strict=True):
        axes = np.array([0.2, 0.2, max(p[2], 0.3)])
        n_all = ((((lattice - p) / axes) ** 2).sum(axis=1) <= 1).sum()
        n_full = ((((points - p) / axes) ** 2).sum(axis=1) <= 1).sum()
        assert value == pytest.approx(n_full / n_all)
    bins = rng.integers(0, 5, len(points)).astype(np.int32)
    root = np.sqrt(np.r_[rng.dirichlet(np.ones(5)), np.zeros(N_BINS - 5)])
    colour = np.empty((2, 7))
    _kernels.colour_shares(particles, 0.2, 0.3, points, bins, root, colour[0])
    _kernels.colour_shares.py_func(particles, 0.2, 0.3, points, bins, root, colour[1])
    np.testing.assert_allclose(colour[0], colour[1], rtol=1e-12)


def test_colour_weight_mixes_overlap_and_colour():
    """CF Eq. 4.8: a target in other clothes keeps the share 1 - weight of its likelihood, one without colours all."""
    s = settings(tracker="particle", n_samples=60, colour_weight=0.3)
    here = frame_of(observe(person(0.0, 0.0, RED)), s)
    stranger = np.zeros(N_BINS, dtype=np.float32)
    stranger[0] = 1.0
    bare = Track(1, here.voxels.centers.mean(axis=0), "confirmed", 0)
    track = start(bare, here, claim_of(here, np.arange(len(here.voxels))), rng=RNG(0))
    likelihood = [
        estimate(track.replace(histogram=histogram), np.zeros((0, 2)), here, rng=RNG(1)).efficiency
        for histogram in (None, stranger)
    ]
    assert likelihood[0] > 0.1
    assert likelihood[1] == pytest.approx(0.7 * likelihood[0])
