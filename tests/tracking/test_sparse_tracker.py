"""Samples on the surface: pseudo-likelihood in closed form, one sample per voxel, and the estimate."""

import numpy as np
import pytest
from bodies import BLUE, RED, SIDE, box, observe, person, run, settings

from mocap.tracking import _kernels, published_settings
from mocap.tracking.claims import claim_of, frame_of
from mocap.tracking.colour import N_BINS
from mocap.tracking.features import components_of
from mocap.tracking.particle import exclusion, systematic
from mocap.tracking.sparse import estimate, start
from mocap.tracking.state import Track

RNG = np.random.default_rng


def shares(crop, samples, radius=2):
    raw, colour, crowd = np.empty((3, len(samples)))
    _kernels.local_shares(np.array(samples), radius, crop, raw, colour, crowd)
    return raw, colour, crowd


def test_raw_likelihood_of_a_flat_wall_has_a_closed_form():
    """Filled for x < 10. With radius 2 a sample at depth d sees 2 - d of 5 layers filled on this side."""
    crop = np.zeros((20, 20, 20), dtype=np.uint8)
    crop[:10] = _kernels.OCCUPIED
    xs = np.arange(5, 15)
    raw = shares(crop, [(x, 10, 10) for x in xs])[0]
    layers = np.clip(10 - (xs - 2), 0, 5)
    np.testing.assert_allclose(raw, 1 - np.abs(2 * layers / 5 - 1))
    assert raw.max() == pytest.approx(0.8)  # an odd number of layers is never half full
    assert shares(crop, [(0, 10, 10)])[0][0] == pytest.approx(1 - abs(2 * 3 / 5 - 1))  # outside is empty


def test_colour_likelihood_is_the_share_of_similar_colours():
    crop = np.zeros((9, 9, 9), dtype=np.uint8)
    crop[:4] = _kernels.OCCUPIED
    crop[3, :, :6] = _kernels.OCCUPIED | _kernels.COLOURED
    crop[3, :, :4] |= _kernels.SIMILAR
    _, colour, _ = shares(crop, [(3, 4, 4), (3, 4, 1), (7, 4, 4)])
    # z from 2 to 6 holds the coloured 2 .. 5, of which 2 and 3 are similar.
    np.testing.assert_allclose(colour, [2 / 4, 1.0, 0.0])


@pytest.mark.parametrize("seed", range(5))
def test_no_two_samples_share_a_voxel(seed):
    rng = RNG(seed)
    crop = np.zeros((12, 13, 14), dtype=np.uint8)
    start_at = rng.integers(2, 6, size=(500, 3))
    placed = np.empty((500, 3), dtype=np.int64)
    n = _kernels.scatter(start_at, np.uint64(seed + 1), 2, 26, crop, placed)
    voxels = placed[:n]
    assert len(np.unique(voxels, axis=0)) == n
    assert n > 300
    taken = np.argwhere(crop & _kernels.TAKEN)
    assert {tuple(v) for v in voxels} == {tuple(v) for v in taken}
    inside = (voxels >= 0).all(axis=1) & (voxels < crop.shape).all(axis=1)
    assert inside.all()


def test_a_full_block_takes_no_more_samples_than_it_has_voxels():
    crop = np.zeros((3, 3, 3), dtype=np.uint8)
    placed = np.empty((200, 3), dtype=np.int64)
    n = _kernels.scatter(np.ones((200, 3), dtype=np.int64), np.uint64(9), 1, 26, crop, placed)
    assert n == 27
    assert (crop & _kernels.TAKEN).all()


def test_scatter_reaches_every_voxel_of_its_cube_evenly():
    counts = np.zeros((9, 9, 9))
    for seed in range(3000):
        crop = np.zeros((9, 9, 9), dtype=np.uint8)
        placed = np.empty((1, 3), dtype=np.int64)
        _kernels.scatter(np.full((1, 3), 4), np.uint64(RNG(seed).integers(2**63)), 2, 26, crop, placed)
        counts[tuple(placed[0])] += 1
    cube = counts[2:7, 2:7, 2:7]
    assert cube.sum() == 3000
    # Chi-squared with 124 degrees of freedom: mean 124, deviation 15.7; five deviations.
    assert (((cube - 24) ** 2) / 24).sum() < 124 + 5 * 15.7


def body_track(s, x=0.0):
    observation = observe(person(x, 0, RED))
    frame = frame_of(observation, s)
    claim = claim_of(frame, np.arange(len(observation)))
    bare = Track(1, claim.centroid, "confirmed", 0)
    return frame, start(bare, frame, claim, rng=RNG(0)), claim


def test_first_samples_are_distinct_surface_voxels():
    s = settings(tracker="sparse", n_samples=300)
    frame, track, _ = body_track(s)
    assert track.samples.shape == (300, 3)
    assert len(np.unique(track.samples, axis=0)) == 300
    surface = {tuple(np.round(c, 6)) for c in frame.voxels.centers[frame.voxels.is_surface]}
    assert {tuple(np.round(c, 6)) for c in track.samples} <= surface
    few = settings(tracker="sparse", n_samples=10**6)
    assert len(body_track(few)[1].samples) == len(surface)


def test_weighted_samples_give_the_centroid():
    """A person who stands still: CF Eq. 4.14 says that the surface has the centroid of the body."""
    s = settings(tracker="sparse", n_samples=800, colour=False)
    frame, track, claim = body_track(s)
    places = []
    for seed in range(12):
        track = estimate(track, np.zeros((0, 2)), frame, rng=RNG(seed))
        assert track.weights.sum() == pytest.approx(1.0)
        places.append(track.xyz)
    error = np.abs(np.array(places) - claim.centroid)
    assert error[:, :2].max() < 0.03  # less than a voxel; 0.012 over 40 seeds
    assert error[:, 2].max() < 0.15  # a head on a trunk is no ellipsoid: surface and volume differ


def test_samples_far_from_the_last_estimate_weigh_nothing():
    """A wall joins the person: samples walk along it, but not further than 1.5 * 30 cm."""
    s = settings(tracker="sparse", n_samples=600)
    wall = [box(0.6, 0, 0.6, 0.1, 0.0, 2.0, BLUE)]
    infos, state = run([person(0, 0, RED)] * 3 + [person(0, 0, RED) + wall] * 30, s)
    track = state.tracks[0]
    far = np.linalg.norm(track.samples[:, :2] - infos[-2].tracks[0].xyz[:2], axis=1) > 0.45 + SIDE
    assert track.weights[far].sum() == 0.0


def test_without_any_voxel_the_prediction_stays():
    s = settings(tracker="sparse")
    _, track, _ = body_track(s)
    empty = frame_of(observe([]), s)
    lost = estimate(track, np.zeros((0, 2)), empty, rng=RNG(0))
    assert lost.efficiency == 0.0
    np.testing.assert_array_equal(lost.xyz, track.xyz)


@pytest.mark.parametrize("colour", [False, True])
def test_filter_estimate_follows_a_person(colour):
    """The published samples spread by two voxels a frame and lag behind; moved with the person they do not."""
    xs = np.linspace(-1.5, 1.5, 60)
    clip = [person(x, 0.3, RED) for x in xs]
    error = {}
    for motion in ("none", "velocity"):
        s = published_settings("sparse", SIDE, colour=colour, fps=20.0, confirm_frames=3, motion=motion)
        infos, _ = run(clip, s, seed=1)
        gaps = [np.hypot(*(i.tracks[0].xyz[:2] - (x, 0.3))) for i, x in zip(infos, xs, strict=True)]
        error[motion] = np.mean(gaps)
    assert error["none"] < 0.14  # 0.09 to 0.11 m over twelve seeds
    assert error["velocity"] < 0.04  # 0.01 to 0.02 m


def test_even_samples_stay_all_over_a_large_surface():
    """Fewer samples than voxels of the surface: copies of copies gather on one side, and the mean with them."""
    error = {True: 0.0, False: 0.0}
    for is_even in error:
        s = published_settings("sparse", SIDE, fps=20.0, confirm_frames=3, n_samples=60, even_samples=is_even)
        for seed in range(6):
            infos, _ = run([person(0.0, 0.3, RED)] * 30, s, seed=seed)
            error[is_even] += sum(np.hypot(*(i.tracks[0].xyz[:2] - (0.0, 0.3))) for i in infos[10:])
    assert error[True] < 0.85 * error[False]  # 0.58 over eight seeds of 40 frames


@pytest.mark.parametrize("radius", [1, 2])
def test_eight_voxels_at_a_time_say_the_same(radius):
    """Also at the ends of the crop, where the neighbourhood reaches outside."""
    rng = RNG(radius)
    crop = rng.integers(0, 16, (7, 6, 24)).astype(np.uint8)
    samples = np.argwhere(np.ones(crop.shape, dtype=bool))
    one, two, three = np.empty((3, 3, len(samples)))
    _kernels.local_shares(samples, radius, crop, *one)
    _kernels.local_shares_in_words(samples, radius, crop.view(np.uint64), *two)
    np.testing.assert_array_equal(one, two)
    words = crop.view(np.uint64)
    with np.errstate(over="ignore"):  # what leaves a word at its upper end is meant to
        _kernels.local_shares_in_words.py_func(samples[::40], radius, words, *three[:, ::40])
    np.testing.assert_array_equal(three[:, ::40], one[:, ::40])


def test_crowd_counts_the_samples_around():
    crop = np.zeros((12, 9, 9), dtype=np.uint8)
    places = [(3, 4, 4), (4, 4, 4), (5, 4, 6), (9, 4, 4)]
    for place in places:
        crop[place] |= _kernels.TAKEN
    assert shares(crop, places)[2].tolist() == [3, 3, 3, 1]


def test_kernels_equal_their_python():
    rng = RNG(6)
    crop = rng.integers(0, 16, (9, 8, 10)).astype(np.uint8)
    samples = rng.integers(0, 8, (40, 3))
    results = []
    for fn in (_kernels.local_shares, _kernels.local_shares.py_func):
        out = np.empty((3, 40))
        fn(samples, 2, crop, *out)
        results.append(out)
    np.testing.assert_array_equal(results[0], results[1])
    points = np.argwhere(crop & 1) * SIDE + SIDE / 2
    bins = rng.integers(-1, 5, len(points)).astype(np.int32)
    byte_of = np.array(
        [1, 7, 3, 7, 7, 3], dtype=np.uint8
    )  # no colour, and five bins of which three are similar
    parts = components_of(points, rng.integers(-1, 5, len(points)), SIDE)
    groups = (points, parts.order, parts.start, parts.lower, parts.upper)
    crops = [np.zeros((6, 8, 10), dtype=np.uint8) for _ in range(3)]
    corner = np.array([0.1, 0, 0])
    _kernels.fill_crop(*groups, bins, byte_of, corner, SIDE, crops[0])
    _kernels.fill_crop.py_func(*groups, bins, byte_of, corner, SIDE, crops[1])
    np.testing.assert_array_equal(crops[0], crops[1])
    assert (crops[0] & _kernels.SIMILAR).any()
    # The same voxel by voxel: nobody's voxels are not there, without colours there is nothing but occupancy.
    where = np.floor((points - corner) / SIDE + 1e-9).astype(int)
    own = (parts.component_of >= 0) & ((where >= 0) & (where < (6, 8, 10))).all(axis=1)
    expected = np.zeros((6, 8, 10), dtype=np.uint8)
    expected[tuple(where[own].T)] = byte_of[bins[own] + 1]
    np.testing.assert_array_equal(crops[0], expected)
    _kernels.fill_crop(*groups, bins[:0], byte_of[:1], corner, SIDE, crops[2])
    np.testing.assert_array_equal(crops[2], _kernels.OCCUPIED * (expected > 0))


def test_samples_are_copied_as_by_systematic_resampling():
    """The kernel against the function of the particle filter, and against its Python."""
    rng = RNG(2)
    for _ in range(30):
        m, n = rng.integers(1, 40, 2)
        weights = rng.random(m) * (rng.random(m) < 0.7) + 1e-12
        samples, offset = rng.random((m, 3)), rng.random()
        fast, slow = np.empty((2, n, 3), dtype=np.int64)
        corner = np.array([-0.2, -0.1, 0.0])
        _kernels.systematic_voxels(samples, weights, offset, corner, SIDE, fast)
        _kernels.systematic_voxels.py_func(samples, weights, offset, corner, SIDE, slow)
        np.testing.assert_array_equal(fast, slow)
        chosen = systematic(weights, n, offset)
        np.testing.assert_array_equal(fast, np.floor((samples[chosen] - corner) / SIDE))


@pytest.mark.parametrize(("n_others", "is_even"), [(0, True), (2, True), (2, False)])
def test_weights_mean_and_covariance_are_those_of_the_formulas(n_others, is_even):
    """CF Eq. 4.12 to 4.19 in numpy against the kernel, and the kernel against its Python."""
    rng = RNG(n_others)
    likelihood, crowd = rng.random(60), rng.integers(1, 9, 60).astype(float)
    others, centre = rng.random((n_others, 2)), np.array([0.4, 0.5, 0.6])
    placed, corner = rng.integers(0, 20, (60, 3)), np.array([0.1, 0.05, 0.0])
    points = corner + (placed + 0.5) * SIDE
    fast, slow, where = np.empty(60), np.empty(60), np.empty((60, 3))
    arguments = (placed, corner, SIDE, centre, 0.4, likelihood, is_even, crowd, others, 1 / 0.3**2, where)
    total, mean, covariance = _kernels.weigh_samples(*arguments, fast)
    np.testing.assert_allclose(where, points)
    for a, b in zip(_kernels.weigh_samples.py_func(*arguments, slow), (total, mean, covariance), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-12, atol=1e-15)
    near = ((points[:, :2] - centre[:2]) ** 2).sum(axis=1) <= 0.4**2
    assert 0 < near.sum() < 60
    w = np.where(near, likelihood, 0) / (crowd if is_even else 1) * exclusion(points[:, :2], others, 0.3)
    assert total == pytest.approx(w.sum())
    w /= w.sum()
    np.testing.assert_allclose(fast, w, atol=1e-15)
    np.testing.assert_allclose(slow, w, atol=1e-15)
    np.testing.assert_allclose(mean, w @ points)
    centred = points - w @ points
    np.testing.assert_allclose(covariance, (w[:, None] ** 2 * centred).T @ centred, atol=1e-15)
    # Nobody within reach: zeros, and nothing that is no number.
    arguments = (placed, corner + 5.0, SIDE, centre, 0.4, likelihood, is_even, crowd, others, 1.0, where)
    nothing = _kernels.weigh_samples(*arguments, fast)
    assert nothing[0] == 0.0
    assert not np.any(nothing[1])
    assert not np.any(nothing[2])


def test_colour_weight_mixes_places_and_colours():
    """CF Eq. 4.19: a target in other clothes keeps the share 1 - weight of its likelihood, one without colours all."""
    s = settings(tracker="sparse", n_samples=200, colour_weight=0.3)
    frame, track, _ = body_track(s)
    stranger = np.zeros(N_BINS, dtype=np.float32)
    stranger[0] = 1.0
    likelihood = [
        estimate(track.replace(histogram=histogram), np.zeros((0, 2)), frame, rng=RNG(1)).efficiency
        for histogram in (None, stranger)
    ]
    assert likelihood[0] > 0.1
    assert likelihood[1] == pytest.approx(0.7 * likelihood[0])
