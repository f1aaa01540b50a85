"""Who is who: crossings, hugs, exchanges, persons who return, and an expected number of persons."""

import numpy as np
import pytest
from bodies import BLUE, FPS, GREEN, RED, box, confirmed, person, run, settings, table

from mocap.tracking import TRACKERS

WALK = np.r_[np.linspace(-1.2, -0.2, 12), np.linspace(-0.2, 0.2, 3)[1:-1], np.linspace(0.2, 1.2, 12)]
U_TURN = np.r_[np.linspace(-1.2, -0.15, 12), [-0.15] * 12, np.linspace(-0.15, -1.2, 12)]


def side_of(info, x_of):
    """person -> whether it is the first of two persons at x_of (2,)."""
    return {t.person: bool(abs(t.xyz[0] - x_of[0]) < abs(t.xyz[0] - x_of[1])) for t in info.tracks}


def pair(xs, gap, first=RED, second=BLUE):
    """Two persons who walk towards one another along x on lines `gap` apart."""
    return [person(x, -gap / 2, first) + person(-x, gap / 2, second) for x in xs]


@pytest.mark.parametrize("tracker", TRACKERS)
@pytest.mark.parametrize("gap", [0.3, 0.45])
def test_ids_survive_a_crossing_with_colour(tracker, gap):
    """The blobs melt into one for several frames; the persons walk on."""
    infos, _ = run(pair(WALK, gap), settings(tracker=tracker))
    assert any(i.n_components == 1 for i in infos)
    first, last = side_of(infos[0], (WALK[0], -WALK[0])), side_of(infos[-1], (WALK[-1], -WALK[-1]))
    assert first == last
    assert [confirmed(i) for i in infos] == [[1, 2]] * len(infos)


@pytest.mark.parametrize("tracker", TRACKERS)
def test_ids_survive_a_turn_back_with_colour(tracker):
    """They meet, stand together for half a second and go back where they came from: motion alone says the opposite."""
    infos, _ = run(pair(U_TURN, 0.1), settings(tracker=tracker))
    assert any(i.n_components == 1 for i in infos)
    assert side_of(infos[0], (U_TURN[0], -U_TURN[0])) == side_of(infos[-1], (U_TURN[-1], -U_TURN[-1]))
    assert confirmed(infos[-1]) == [1, 2]


def meeting(gap, height, *between):
    """A tall and a shorter one who come together, `gap` from one another, and stay for three seconds; with what no
    camera sees about them then."""
    come = [person(-x, 0, RED) + person(x, 0, BLUE, height=height) for x in np.linspace(1.2, gap / 2, 20)]
    return [*come, *[[*come[-1], *between]] * 60]


@pytest.mark.parametrize("colour", [True, False])
@pytest.mark.parametrize("gap", [0.4, 0.5])
@pytest.mark.parametrize("height", [1.3, 1.45])
def test_the_shorter_of_two_who_stay_together_keeps_his_head(height, gap, colour):
    """Who lost his upper end to the other sank, and lost more."""
    infos, _ = run(meeting(gap, height, box(0.0, 0.0, 0.3, 0.15, 0.0, 1.2)), settings(colour=colour))
    assert confirmed(infos[-1]) == [1, 2]
    places = {t.person: float(t.xyz[0]) for t in infos[-1].tracks}
    assert places == pytest.approx({1: -gap / 2, 2: gap / 2}, abs=0.06)
    tops = {person: features.top_m for person, features in infos[-1].features_of.items()}
    assert tops == pytest.approx({1: 1.7, 2: height})


@pytest.mark.parametrize("colour", [True, False])
@pytest.mark.parametrize("height", [1.45, 1.6])
def test_heads_divide_where_each_has_one(height, colour):
    """By their places, which what lies behind the tall one draws to its side, the shorter one gets some of him."""
    behind = box(-0.45, 0.0, 0.2, 0.25, 0.0, 1.3), box(0.0, 0.0, 0.1, 0.1, 0.0, 1.1)
    infos, _ = run(meeting(0.4, height, *behind), settings(colour=colour))
    features = infos[-1].features_of
    assert {person: found.top_m for person, found in features.items()} == pytest.approx({1: 1.7, 2: height})
    assert features[2].box_min_m == pytest.approx(0.4, abs=0.1)
    assert {t.person: float(t.xyz[0]) for t in infos[-1].tracks}[2] == pytest.approx(0.2, abs=0.05)


@pytest.mark.parametrize("tracker", TRACKERS)
@pytest.mark.parametrize("clip", [WALK, U_TURN], ids=["walk on", "turn back"])
def test_without_colour_two_persons_remain_two(tracker, clip):
    """Who is who after an encounter is then a matter of motion alone: whoever turns back may get the other's number."""
    infos, _ = run(pair(clip, 0.45), settings(tracker=tracker, colour=False))
    assert all(confirmed(i) == [1, 2] for i in infos)
    if clip is WALK:
        assert side_of(infos[0], (clip[0], -clip[0])) == side_of(infos[-1], (clip[-1], -clip[-1]))


def test_exchange_is_repaired_by_colour_and_only_by_colour():
    """Two persons change places in the dark (frames that nobody saw): the positions say the opposite of the clothes."""
    before = [person(-0.25, 0, RED) + person(0.25, 0, BLUE)] * 8
    apart = [person(-0.6, 0, RED) + person(0.6, 0, BLUE)] * 6
    swapped = [person(-0.25, 0, BLUE) + person(0.25, 0, RED)] * 8
    for colour in (True, False):
        infos, _ = run(apart + before + swapped, settings(colour=colour))
        left = min(infos[-1].tracks, key=lambda t: t.xyz[0]).person
        was_left = min(infos[0].tracks, key=lambda t: t.xyz[0]).person
        assert (left != was_left) == colour
        assert any(i.exchanged for i in infos) == colour


def test_equal_clothes_never_cause_an_exchange():
    infos, _ = run(pair(U_TURN, 0.1, GREEN, GREEN) + pair(WALK, 0.3, GREEN, GREEN), settings())
    assert not any(i.exchanged for i in infos)


def test_hug_is_divided_by_colour_where_the_persons_stand():
    """Two persons in one blob, of whom the prediction knows nothing any more: each gets the voxels of its clothes."""
    hug = [person(-0.15, 0, RED) + person(0.15, 0, BLUE)] * 10
    walk = pair(np.linspace(-1.2, -0.15, 12), 0.0)
    infos, _ = run(walk + hug, settings())
    assert infos[-1].n_components == 1
    x = {t.person: t.xyz[0] for t in infos[-1].tracks}
    red = min(infos[0].tracks, key=lambda t: t.xyz[0]).person
    assert x[red] == pytest.approx(-0.15, abs=0.1)
    assert x[3 - red] == pytest.approx(0.15, abs=0.1)


@pytest.mark.parametrize(
    ("fps", "step_m", "is_same"), [(1.0, 1.8, True), (1.0, 2.2, False), (20.0, 1.8, False), (20.0, 0.9, True)]
)
def test_who_walks_between_slow_pictures_is_the_same(fps: float, step_m: float, is_same: bool):
    """Further than anybody walks from one picture to the next there is somebody else."""
    s = settings(fps=fps, confirm_frames=1)
    infos, _ = run([*[person(-1.0, 0, RED)] * 2, person(step_m - 1.0, 0, RED)], s)
    there = [t for t in infos[-1].tracks if t.is_seen]
    assert len(there) == 1
    assert there[0].xyz[0] == pytest.approx(step_m - 1.0, abs=0.1)
    assert (there[0].serial == infos[0].tracks[0].serial) == is_same


ABSENCE = [[]] * 30
ENTRY = [person(x, 0, RED) for x in np.linspace(-2.4, -0.6, 20)]
EXIT = [person(x, 0, RED) for x in np.linspace(-0.6, -2.4, 20)]


def test_person_who_returns_gets_the_old_number():
    s = settings()
    infos, _ = run(ENTRY + EXIT + ABSENCE + ENTRY, s)
    tracks = table(infos, s)
    assert tracks.persons == (1,)
    assert any(i.recognised == (1,) for i in infos)
    # Nobody is invented while the room is empty, and nothing is interpolated over the absence.
    assert not np.isin(tracks.frame, range(42, 68)).any()
    # What was seen before the recognition belongs to the same person.
    assert tracks.frame.tolist()[-19:] == list(range(71, 90))


@pytest.mark.parametrize(
    ("why", "changes", "shirt"),
    [
        ("other clothes", {}, BLUE),
        ("no colour", {"colour": False}, RED),
        ("switched off", {"reid_s": 0.0}, RED),
        ("too late", {"reid_s": 0.5}, RED),
    ],
)
def test_nobody_inherits_a_number_by_accident(why, changes, shirt):
    other = [
        person(x, 0, shirt, (60, 60, 60) if shirt == RED else (200, 200, 190))
        for x in np.linspace(-2.4, -0.6, 20)
    ]
    infos, _ = run(ENTRY + EXIT + ABSENCE + other, settings(**changes))
    assert confirmed(infos[-1]) == [2]
    assert not any(i.recognised for i in infos)


def test_of_two_who_left_in_equal_clothes_nobody_is_recognised():
    two = [person(-1, y, RED) + person(1, y, RED) for y in np.linspace(-2.2, -1, 10)]
    infos, _ = run(
        two + two[::-1] + ABSENCE + [person(-1, y, RED) for y in np.linspace(-2.2, -1, 10)], settings()
    )
    assert confirmed(infos[-1]) == [3]


def test_somebody_cannot_have_run_through_the_room():
    """Equal clothes at the other end of the room a fraction of a second later are somebody else."""
    s = settings(lost_frames=1)
    leave = [person(x, 0, RED) for x in np.linspace(-1.0, -2.4, 10)]
    enter = [person(2.4, 2.0 - 0.1 * i, RED) for i in range(8)]
    infos, _ = run(leave + [[]] * 3 + enter, s)
    assert confirmed(infos[-1]) == [2]


@pytest.mark.parametrize("tracker", TRACKERS)
def test_never_more_persons_than_expected(tracker):
    clip = [person(-1.5, 0, RED) + person(0, 0, BLUE) + person(1.5, 0, GREEN)] * 12
    for n in (1, 2, 3, 5):
        infos, _ = run(clip, settings(tracker=tracker, expected_persons=n))
        assert [len(confirmed(i)) for i in infos] == [min(n, 3)] * 12


def test_expected_person_is_waited_for_whatever_he_wears():
    """One person is expected: whoever comes later is that person, also in other clothes and after minutes."""
    s = settings(expected_persons=1, reid_s=1.0)
    changed = [person(x, 0, BLUE, (200, 200, 190)) for x in np.linspace(-2.4, -0.6, 20)]
    infos, _ = run(ENTRY + EXIT + ABSENCE * 3 + changed, s)
    assert table(infos, s).persons == (1,)
    assert confirmed(infos[-1]) == [1]


def test_expected_persons_who_jump_keep_their_numbers():
    """A cut in the clip: both are elsewhere at once; with two expected, the two tracks find them by their clothes."""
    start = [person(-2, 1, RED) + person(2, 1, BLUE)] * 6
    after = [person(1.5, -2, RED) + person(-1.5, -2, BLUE)] * 12
    infos, _ = run(start + after, settings(expected_persons=2))
    red = min(infos[0].tracks, key=lambda t: t.xyz[0]).person
    x = {t.person: t.xyz[0] for t in infos[-1].tracks if t.status != "tentative"}
    assert set(x) == {1, 2}
    assert x[red] > 0


def test_expected_person_with_voxels_is_not_given_up():
    """Somebody sinks behind a desk: what is left of him is no person to the classifier."""
    low = [box(0, 0, 0.15, 0.2, 0.0, 0.4, RED)]
    clip = [person(0, 0, RED)] * 5 + [low] * 20 + [person(0, 0, RED)] * 5
    patient, _ = run(clip, settings(expected_persons=1))
    plain, _ = run(clip, settings())
    assert all(len(i.tracks) == 1 for i in patient)
    assert any(not i.tracks for i in plain)


def test_mistaken_first_frame_is_settled_when_the_real_person_comes():
    """A ghost in the first frame takes the only number that is expected; it goes to the person who stays."""
    ghost, real = person(-1.5, 0, GREEN), person(1.5, 0, RED)
    infos, _ = run([ghost] + [real] * 15, settings(expected_persons=1))
    assert confirmed(infos[-1]) == [1]
    assert infos[-1].tracks[0].xyz[0] == pytest.approx(1.5, abs=0.05)


def test_speed_is_in_the_state_and_does_not_overshoot():
    infos, _ = run([person(-1.5 + 0.06 * i, 0, RED) for i in range(30)], settings())
    velocity = infos[-1].tracks[0].velocity
    assert 0.8 * 0.06 * FPS <= velocity[0] <= 0.06 * FPS
    np.testing.assert_allclose(velocity[1:], 0, atol=1e-9)
