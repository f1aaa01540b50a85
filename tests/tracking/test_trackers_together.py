"""What all three trackers must do: the same life cycle, invariances, determinism, and bad input."""

import itertools

import numpy as np
import pytest
from bodies import BLUE, FPS, GREEN, RED, SIDE, box, chair, confirmed, observe, person, run, settings, table

from mocap.data import VoxelGrid
from mocap.tracking import (
    TRACKERS,
    FrameVoxels,
    TrackerSettings,
    TrackerState,
    _kernels,
    published_settings,
    track_clip,
    track_step,
)
from mocap.tracking.claims import _add_fragments, _with_parts, claim_of, frame_of, part_claim
from mocap.tracking.features import components_of

WALK = [
    person(-1.2 + 0.06 * i, -0.6, RED) + person(1.2 - 0.05 * i, 0.6, BLUE, height=1.55) for i in range(25)
]


@pytest.mark.parametrize("tracker", TRACKERS)
def test_two_persons_are_found_followed_and_measured(tracker):
    s = settings(tracker=tracker)
    infos, _ = run(WALK, s)
    tracks = table(infos, s)
    assert tracks.persons == (1, 2)
    assert tracks.observed.all()
    assert tracks.covariance.shape == (50, 3, 3)
    for i, boxes in enumerate(WALK):
        where = {round(float(t.xyz[1]), 1): t.xyz[0] for t in infos[i].tracks}
        assert where[-0.6] == pytest.approx(boxes[0][0][0] + 0.15, abs=0.03)


@pytest.mark.parametrize("tracker", TRACKERS)
def test_same_seed_same_result_and_another_seed_another(tracker):
    s = settings(tracker=tracker, estimate="filter")
    xyz = [np.array([t.xyz for i in run(WALK[:8], s, seed=seed)[0] for t in i.tracks]) for seed in (1, 1, 2)]
    np.testing.assert_array_equal(xyz[0], xyz[1])
    assert np.array_equal(xyz[0], xyz[2]) == (tracker == "naive")


@pytest.mark.parametrize("tracker", TRACKERS)
def test_names_of_labels_and_place_of_the_room_change_nothing(tracker):
    s = settings(tracker=tracker)
    shift = np.array([3.0, -2.0, 0.0])
    plain = moved = TrackerState()
    names = np.random.default_rng(0).permutation(500)
    for frame, boxes in enumerate(WALK[:8]):
        a = observe(boxes, frame)
        b = FrameVoxels(frame, a.centers + shift, names[a.labels], a.is_surface, a.rgb, a.has_colour)
        plain, one = track_step(plain, a, s, rng=np.random.default_rng(frame))
        moved, two = track_step(moved, b, s, rng=np.random.default_rng(frame))
        assert [t.person for t in one.tracks] == [t.person for t in two.tracks]
        for x, y in zip(one.tracks, two.tracks, strict=True):
            np.testing.assert_allclose(x.xyz + shift, y.xyz, atol=1e-6)
            np.testing.assert_array_equal(one.voxels_of[x.person], two.voxels_of[x.person])


@pytest.mark.parametrize("side", [0.025, 0.05, 0.1, 0.15])
@pytest.mark.parametrize("tracker", TRACKERS)
def test_every_voxel_size_gives_the_same_persons(tracker, side):
    s = settings(tracker=tracker, voxel_size_m=side)
    clip = [person(-0.9 + 0.06 * i, -0.6, RED) + person(0.9, 0.6, BLUE) for i in range(8)]
    infos, _ = run(clip, s)
    assert confirmed(infos[-1]) == [1, 2]
    for track in infos[-1].tracks:
        near = min(np.hypot(*(track.xyz[:2] - p)) for p in ((-0.48, -0.6), (0.9, 0.6)))
        assert near < 0.6 * side + 0.02


@pytest.mark.parametrize("tracker", TRACKERS)
@pytest.mark.parametrize("is_published", [False, True])
def test_bad_input_leaves_no_crash_and_no_phantom(tracker, is_published):
    """Nobody, somebody, specks, everybody leaves, everything is foreground, frames are missing."""
    make = published_settings if is_published else TrackerSettings
    common = {"fps": FPS, "confirm_frames": 3, "lost_frames": 6, "tentative_misses": 1}
    s = make(tracker=tracker, voxel_size_m=SIDE, **common)
    specks = [box(-1.5, y, 0.05, 0.05, 1.0, 1.1, GREEN) for y in (-1.0, 0.0, 1.0)]
    walls = [box(0, 0, 2.5, 2.0, 0.0, 0.6), box(0, 0, 2.5, 0.2, 0.6, 2.4)]
    clip = [[]] * 3 + [person(0, 0, RED)] * 6 + [specks] * 12 + [[]] * 4 + [walls] * 3 + [[]] * 8
    frames = np.arange(len(clip)) + np.where(np.arange(len(clip)) > 5, 3, 0)
    infos, _ = run(clip, s, frames=frames)
    persons = [len(confirmed(i)) for i in infos]
    assert persons[:5] == [0] * 5
    assert persons[8] == 1
    assert sum(persons[9:]) <= s.lost_frames
    assert set(table(infos, s).frame) <= set(frames[3:9])


@pytest.mark.parametrize("tracker", TRACKERS)
def test_ages_are_frames_and_not_calls(tracker):
    """Of a clip in which only every fourth frame is left, a lost person is given up after as many frames."""
    s = settings(tracker=tracker)
    frames = np.arange(0, 80, 4)
    infos, _ = run([person(0, 0, RED)] * 10 + [[]] * 10, s, frames=frames)
    alive = [i.frame for i in infos if i.tracks]
    assert max(alive) == 36 + 4  # 6 frames of patience: the sighting in frame 36 is 4 frames old, then 8
    assert infos[9].tracks[0].age == 36


@pytest.mark.parametrize("tracker", TRACKERS)
def test_person_is_found_again_behind_a_gap_in_the_clip(tracker):
    s = settings(tracker=tracker)
    clip = [person(-1.0 + 0.05 * i, 0, RED) for i in range(30)]
    keep = [i for i in range(30) if not 10 <= i < 15]
    infos, _ = run([clip[i] for i in keep], s, frames=keep)
    assert all(confirmed(i) == [1] for i in infos)


@pytest.mark.parametrize("tracker", TRACKERS)
@pytest.mark.parametrize("colours", [True, False])
def test_chair_that_is_carried_in_is_nobody(tracker, colours):
    """A person carries a chair in, puts it down and goes: the number stays with the person."""
    s = settings(tracker=tracker)
    xs = np.linspace(-2.0, 0.0, 20)
    carry = [person(x, 0, RED) + chair(x + 0.35, 0) for x in xs]
    leave = [person(x, 0, RED) + chair(0.35, 0) for x in xs[::-1]]
    infos, _ = run(carry + leave + [chair(0.35, 0)] * 10, s, colours=colours)
    assert all(len(confirmed(i)) <= 1 for i in infos)
    assert table(infos, s).persons == (1,)
    # The track ends with the person who left, and not on the chair.
    assert table(infos, s).frame.max() == 39
    assert infos[39].tracks[0].xyz[0] == pytest.approx(-2.0, abs=0.05)


@pytest.mark.parametrize("tracker", TRACKERS)
def test_chair_that_stands_there_in_the_first_frame_is_nobody(tracker):
    infos, _ = run([chair(1.0, 0)] * 20, settings(tracker=tracker))
    assert not any(confirmed(i) for i in infos)


@pytest.mark.parametrize("tracker", TRACKERS)
def test_child_who_walks_is_somebody(tracker):
    """As tall as the chair's back, but it moves."""
    clip = [person(-1 + 0.05 * i, 0, RED, height=0.95) for i in range(20)]
    infos, _ = run(clip, settings(tracker=tracker))
    assert confirmed(infos[-1]) == [1]


@pytest.mark.parametrize("tracker", TRACKERS)
def test_person_sits_down_on_a_chair_and_gets_up(tracker):
    s = settings(tracker=tracker)
    seated = [box(0, 0, 0.25, 0.2, 0.45, 0.65, (60, 60, 60)), box(-0.1, 0, 0.15, 0.2, 0.65, 1.1, RED)]
    seated += [box(-0.1, 0, 0.1, 0.1, 1.1, 1.3, (220, 180, 150))]
    here = chair(0, 0)
    clip = [person(1.5 - 0.06 * i, 0, RED) for i in range(18)] + [seated + here] * 30
    clip += [person(0.3 + 0.06 * i, 0, RED) + here for i in range(18)]
    infos, _ = run(clip, s)
    assert table(infos, s).persons == (1,)
    assert infos[-1].tracks[0].xyz[0] == pytest.approx(0.3 + 0.06 * 17, abs=0.06)


@pytest.mark.parametrize("tracker", TRACKERS)
def test_person_who_comes_in_through_the_border_is_one_person(tracker):
    """Cut off by the volume at first, then whole, then cut off again on the other side."""
    s = settings(tracker=tracker)
    clip = [person(x, 0, RED) for x in np.linspace(-2.9, 2.9, 70)]
    infos, _ = run(clip, s)
    tracks = table(infos, s)
    assert tracks.persons == (1,)
    assert len(tracks) >= 60


def test_covariance_grows_while_nobody_is_seen_and_between_sightings():
    s = settings()
    infos, _ = run([person(0, 0, RED)] * 5 + [[]] * 5 + [person(0.3, 0, RED)] * 5, s)
    std = [i.tracks[0].std_m[0] for i in infos]
    assert all(a < b for a, b in itertools.pairwise(std[4:10]))
    assert std[10] < std[5]
    tracks = table(infos, s)
    assert np.flatnonzero(~tracks.observed).tolist() == [5, 6, 7, 8, 9]
    assert tracks.std[7, 0] > tracks.std[5, 0] > tracks.std[4, 0]
    assert tracks.std[7, 0] > tracks.std[9, 0]


def test_clip_and_steps_agree():
    s = settings(tracker="sparse")
    infos, _ = run(WALK[:10], s, seed=4)
    clip = track_clip((observe(b, i) for i, b in enumerate(WALK[:10])), s, FPS, rng=np.random.default_rng(4))
    np.testing.assert_array_equal(clip.xyz, table(infos, s).xyz)


def test_wrong_settings_and_observations_are_named():
    for changes, name in (
        ({"tracker": "kalman"}, "tracker"),
        ({"n_samples": 0}, "n_samples"),
        ({"expected_persons": 0}, "expected_persons"),
        ({"colour_weight": 1.5}, "colour_weight"),
        ({"estimate": "mean"}, "estimate"),
        ({"motion": "fast"}, "motion"),
        ({"fps": 0.0}, "fps"),
        ({"reid_s": -1.0}, "reid_s"),
    ):
        with pytest.raises(ValueError, match=name):
            TrackerSettings(SIDE, **changes)
    good = observe(person(0, 0))
    for name, value in (
        ("labels", good.labels[:-1]),
        ("is_surface", good.is_surface[1:]),
        ("rgb", good.rgb[:, :2]),
        ("has_colour", good.has_colour[:-2]),
    ):
        values = {
            k: getattr(good, k) for k in ("frame", "centers", "labels", "is_surface", "rgb", "has_colour")
        }
        with pytest.raises(ValueError, match=name):
            FrameVoxels(**(values | {name: value}))


def kernel_calls():
    """name -> call of a kernel that returns what it has written."""
    rng = np.random.default_rng(8)
    points, labels = rng.random((80, 3)), rng.integers(-1, 4, 80)
    centers, axes = rng.random((3, 3)), rng.random((3, 3)) + 0.2
    parts = components_of(points, labels, 0.1)
    groups = (points, parts.order, parts.start, parts.lower, parts.upper)
    count = np.bincount(labels[labels >= 0], minlength=4)
    first = np.r_[0, np.cumsum(count)]
    order = np.argsort(labels, kind="stable")[-count.sum() :]

    def write(fn, *inputs, out):
        fn(*inputs, *out)
        return out

    def empty(*shape):
        return np.zeros(shape)

    def whole(*shape):
        return np.zeros(shape, dtype=np.int64)

    voxels, origin = np.arange(0, 300, 6, dtype=np.int32), np.array([0.1, 0.2, 0.3])
    return {
        "count_labels": lambda fn: write(fn, labels, out=[whole(4)]),
        "group_by_label": lambda fn: write(
            fn, labels, np.arange(4), first, out=[whole(len(order)), whole(80)]
        ),
        "measure_groups": lambda fn: write(fn, points, order, first, out=[empty(4, 3) for _ in range(3)]),
        "ellipsoid_distances": lambda fn: write(fn, points, centers, axes, out=[empty(3, 80)]),
        "count_votes": lambda fn: write(fn, *groups, centers, axes, out=[whole(3, 4), whole(3, 4)]),
        "rows_in_box": lambda fn: write(fn, *groups, np.full(2, 0.2), np.full(2, 0.7), out=[whole(80)]),
        "extent": lambda fn: fn(points),
        "mark_similar": lambda fn: write(fn, points[:, 0], 0.6, 4, out=[np.ones(81, dtype=np.uint8)]),
        "voxel_centers": lambda fn: write(fn, voxels, 5, 7, origin, 0.05, out=[empty(50, 3)]),
    }


@pytest.mark.parametrize("name", sorted(kernel_calls()))
def test_shared_kernels_equal_their_python(name):
    call, kernel = kernel_calls()[name], getattr(_kernels, name)
    for fast, slow in zip(call(kernel), call(kernel.py_func), strict=True):
        np.testing.assert_allclose(fast, slow, rtol=1e-12)
        assert np.any(fast != 0)


def test_votes_and_boxes_agree_with_numpy():
    """Components in spheres that reach into one another, counted voxel by voxel."""
    rng = np.random.default_rng(3)
    points = rng.random((500, 3)) + np.repeat(np.arange(5), 100)[:, None] * [0.7, 0.2, 0.0]
    labels = np.repeat([0, 3, -1, 1, 2], 100)
    centers, axes = np.array([[0.5, 0.5, 0.5], [0.9, 0.6, 0.5], [3.0, 0.7, 0.4]]), np.full((3, 3), 0.45)
    p = components_of(points, labels, 0.1)
    exclusive, every = np.zeros((2, 3, 4), dtype=np.int64)
    groups = (points, p.order, p.start, p.lower, p.upper)
    _kernels.count_votes(*groups, centers, axes, exclusive, every)
    inside = (((points[None] - centers[:, None]) / 0.45) ** 2).sum(axis=2) <= 1
    alone = inside & (inside.sum(axis=0) == 1)
    for k in range(4):
        np.testing.assert_array_equal(every[:, k], inside[:, p.component_of == k].sum(axis=1))
        np.testing.assert_array_equal(exclusive[:, k], alone[:, p.component_of == k].sum(axis=1))
    assert (exclusive != every).any()
    low, high, out = np.array([0.4, 0.3]), np.array([1.6, 0.9]), np.zeros(500, dtype=np.int64)
    rows = out[: _kernels.rows_in_box(*groups, low, high, out)]
    wanted = ((points[:, :2] > low) & (points[:, :2] < high)).all(axis=1) & (labels >= 0)
    np.testing.assert_array_equal(np.sort(rows), np.flatnonzero(wanted))


def test_claim_with_loose_parts_is_measured_as_a_whole():
    frame = frame_of(observe([*person(0, 0, RED), box(0, 0.4, 0.1, 0.1, 1.3, 1.4, RED)]), settings())
    (body, hand) = (part_claim(frame, k) for k in np.argsort(-frame.parts.weight_kg))
    both = _with_parts(frame, body, np.array([int(np.argmin(frame.parts.weight_kg))]))
    whole = claim_of(frame, np.sort(np.r_[body.voxels, hand.voxels]))
    np.testing.assert_array_equal(both.voxels, whole.voxels)
    np.testing.assert_allclose(both.box, whole.box)
    np.testing.assert_allclose(both.centroid, whole.centroid, atol=1e-12)
    for name, value in vars(whole.features).items():
        assert getattr(both.features, name) == pytest.approx(value)


@pytest.mark.parametrize(
    ("dx", "lower", "is_his"),
    [(0.0, 0.85, True), (0.25, 0.85, True), (0.35, 0.3, False), (0.25, 0.0, False)],
)
def test_a_trunk_above_its_legs_is_the_rest_of_him(dx, lower, is_his):
    """Legs that lost masks have cut off are lighter; what stands on the floor or hangs beside them is another's."""
    legs = [box(-0.05, y, 0.05, 0.05, 0.0, 0.75) for y in (-0.1, 0.1)] + [box(-0.05, 0, 0.05, 0.1, 0.7, 0.75)]
    frame = frame_of(observe([*legs, box(dx - 0.05, 0, 0.1, 0.2, lower, lower + 0.85)]), settings())
    low, heavy = np.argsort(frame.parts.weight_kg)
    assert frame.parts.weight_kg[heavy] > 2 * frame.parts.weight_kg[low]
    claims, is_taken = {0: part_claim(frame, int(low))}, np.arange(2) == low
    _add_fragments(frame, claims, is_taken, [0])
    assert len(claims[0].voxels) == (len(frame.voxels) if is_his else len(frame.parts.voxels(int(low))))
    assert is_taken[heavy] == is_his


def in_two(x, y):
    """Somebody whose hips the masks have lost."""
    return [
        box(x, y, 0.15, 0.2, 0.0, 0.85),
        box(x, y, 0.15, 0.2, 0.95, 1.45),
        box(x, y, 0.1, 0.1, 1.45, 1.7),
    ]


@pytest.mark.parametrize("dx", [0.55, 0.6, 0.7])
def test_a_trunk_belongs_to_the_legs_below_it_and_not_to_somebody_beside(dx):
    """The ellipsoid of legs alone is low: that of who stands half a metre away reaches farther up."""
    whole = [[*person(0, 0), *person(dx, 0)]] * 5
    infos, _ = run(whole + [[*person(0, 0), *in_two(dx, 0)]] * 8, settings())
    for info in infos:
        both = {round(float(t.xyz[0]) / dx): t for t in info.tracks}
        assert both[1].weight_kg == pytest.approx(both[0].weight_kg, rel=0.1)


@pytest.mark.parametrize(
    ("first", "loose", "firm", "owner"),
    [
        (box(0.6, 0, 0.15, 0.2, 0.0, 0.85), box(0.6, 0, 0.15, 0.2, 0.95, 1.7), [0, 1], 0),
        (box(0.6, 0, 0.15, 0.2, 0.0, 0.85), box(0.6, 0, 0.15, 0.2, 0.95, 1.7), [1], 1),
        (box(0.5, 0, 0.15, 0.2, 0.0, 1.7), box(0.25, 0, 0.05, 0.05, 0.5, 0.6), [0, 1], 0),
        (box(0.56, 0, 0.15, 0.2, 0.0, 1.7), box(0.27, 0, 0.05, 0.05, 0.5, 0.6), [0, 1], 1),
        (box(0.5, 0, 0.15, 0.2, 0.0, 0.85), box(0.5, 0, 0.3, 0.4, 0.95, 1.75), [1], None),
        (box(-1.5, 0, 0.15, 0.2, 0.0, 1.1), box(0, 0.45, 0.05, 0.05, 1.3, 1.4), [0, 1], 1),
    ],
    ids=[
        "trunk above",
        "above who may be nobody",
        "hand of the first",
        "hand of the second",
        "heavier",
        "hand held up",
    ],
)
def test_whose_a_loose_part_is(first, loose, firm, owner):
    """Beside somebody in the middle of the room, the second."""
    frame = frame_of(observe([first, box(0, 0, 0.15, 0.2, 0.0, 1.75), loose]), settings())
    places = [np.mean([b[0], b[1]], axis=0) for b in (first, loose)]
    k, part = (int(np.linalg.norm(frame.parts.centroid - place, axis=1).argmin()) for place in places)
    other = 3 - k - part
    claims = {0: part_claim(frame, k), 1: part_claim(frame, other)}
    is_taken = np.arange(3) != part
    _add_fragments(frame, claims, is_taken, firm)
    before = {0: len(frame.parts.voxels(k)), 1: len(frame.parts.voxels(other))}
    assert [len(claims[i].voxels) > before[i] for i in (0, 1)] == [owner == 0, owner == 1]


@pytest.mark.parametrize(
    ("dx", "hips_m", "half_m", "lower_m", "lean_m"),
    [(0.62, 1.1, 0.34, 1.27, -0.04), (0.65, 1.1, 0.28, 1.24, 0.04), (0.62, 1.05, 0.31, 1.28, 0.0)],
)
def test_legs_of_whose_trunk_touches_another_are_nobody_else(dx, hips_m, half_m, lower_m, lean_m):
    """Of one volume with a stout man he holds a share that is elsewhere; the legs, as high as a child, are where he
    was."""
    stout = [box(0, 0, half_m, 0.2, 0.0, 1.45), box(0, 0, 0.1, 0.1, 1.45, 1.75)]
    trunk, head = (
        box(dx + lean_m, 0, half, half, *z) for half, z in ((0.15, (hips_m + 0.1, 1.5)), (0.1, (1.5, 1.75)))
    )
    scene = [*stout, box(dx, 0, 0.15, 0.2, 0.0, hips_m), trunk, head]
    touch = box((half_m + dx) / 2, 0, max((dx - half_m) / 2, 0.05) + 0.05, 0.1, lower_m, lower_m + 0.15)
    infos, _ = run([scene] * 5 + [[*scene, touch]] * 8, settings())
    assert [len(info.tracks) for info in infos] == [2] * 13


def test_centres_and_groups_agree_with_numpy():
    grid = VoxelGrid(np.array([-1.0, 0.5, 0.0]), (7, 5, 11), 0.05)
    voxels = np.flatnonzero(np.random.default_rng(0).random(grid.n_voxels) < 0.3).astype(np.int32)
    seen = FrameVoxels.of_grid(0, grid, voxels, np.zeros(len(voxels), dtype=int))
    np.testing.assert_allclose(seen.centers, grid.centers(voxels), atol=1e-12)


@pytest.mark.parametrize("tracker", TRACKERS)
def test_somebody_on_the_floor_is_somebody_as_soon_as_he_moves(tracker):
    """Low from the first frame on: arms that open tell him from a chair."""
    trunk = [box(0, 0, 0.2, 0.45, 0.0, 0.6, RED)]
    arms = [box(0.3, 0.3, 0.4, 0.1, 0.2, 0.35, RED)]
    s = settings(tracker=tracker)
    infos, _ = run([trunk] * 20 + [trunk + arms] * 5, s)
    assert not any(confirmed(i) for i in infos[:20])
    assert confirmed(infos[-1]) == [1]
    assert len(table(infos, s)) == 25  # backdated to the first frame


def test_long_confirmation_is_possible():
    infos, _ = run([[]] + [person(0, 0, RED)] * 60, settings(confirm_frames=50, tentative_frames=10))
    assert confirmed(infos[-1]) == [1]
