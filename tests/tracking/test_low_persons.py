"""Who lies, falls or crouches is followed; chairs, shadows and ghosts that are left behind are nobody."""

import numpy as np
import pytest
from bodies import BLUE, RED, box, chair, confirmed, person, run, settings, table

from mocap.tracking import TRACKERS, person_tree, published_settings

GREY = (60, 60, 60)


def sinking(x, y, height, shirt=RED):
    """A body of one volume (0.2 m^3) at any height: the lower it is, the longer."""
    length = 0.204 / (0.4 * height)
    return [
        box(x, y, length / 2, 0.2, 0.0, height / 2, GREY),
        box(x, y, length / 2, 0.2, height / 2, height, shirt),
    ]


def lying(x, y, shirt=RED, height=0.3):
    """Stretched out along x: trousers on one side, shirt on the other, as high as a chest is deep."""
    return [
        box(x - 0.425, y, 0.425, 0.2, 0.0, height, GREY),
        box(x + 0.425, y, 0.425, 0.2, 0.0, height, shirt),
    ]


FALL = [sinking(0, 0, h) for h in np.linspace(1.7, 0.35, 14)]
STILL = [lying(0, 0)] * 40


@pytest.mark.parametrize("tree", ["wide", "trained"])
@pytest.mark.parametrize("colours", [True, False])
@pytest.mark.parametrize("tracker", TRACKERS)
def test_who_falls_and_lies_still_is_seen_all_the_time(tracker, colours, tree):
    s = settings(tracker=tracker, person_tree=person_tree(tree))
    clip = [person(-0.5 + 0.05 * i, 0, RED) for i in range(11)] + FALL + STILL + FALL[::-1]
    infos, _ = run(clip, s, colours=colours)
    assert [confirmed(i) for i in infos] == [[1]] * len(clip)
    assert all(i.tracks[0].is_seen for i in infos)
    tracks = table(infos, s)
    assert tracks.persons == (1,)
    assert tracks.observed.all()
    np.testing.assert_allclose(tracks.xyz[30:60, :2], 0.0, atol=0.03)


def test_published_trackers_let_the_classifier_decide_alone():
    """CF 4.2.3: what the tree refuses is no person."""
    s = published_settings("naive", 0.05, fps=20.0, confirm_frames=3, lost_frames=6)
    infos, _ = run([person(0, 0, RED)] * 5 + STILL, s)
    assert not infos[-1].tracks


LEFT_BEHIND = {
    "chair": chair(0.45, 0),
    "shadow": [box(0.2, 0, 0.9, 0.35, 0.0, 0.1, GREY)],
    "thick shadow": [box(0.2, 0, 0.9, 0.35, 0.0, 0.15, GREY)],
    "bag": [box(0.2, 0, 0.25, 0.25, 0.0, 0.4, (10, 90, 10))],
    "low ghost": [box(0.2, 0, 0.5, 0.3, 0.1, 0.4, (200, 200, 190))],
    "box of a person's weight": [box(0.3, 0, 0.35, 0.35, 0.0, 0.4, (10, 90, 10))],
}


@pytest.mark.parametrize(
    ("tracker", "name"), [("naive", name) for name in LEFT_BEHIND] + [(t, "chair") for t in TRACKERS[1:]]
)
@pytest.mark.parametrize("colours", [True, False])
def test_what_somebody_leaves_behind_does_not_keep_him_alive(tracker, colours, name):
    """He vanishes beside it from one frame to the next: the track ends after lost_frames, at its last sighting."""
    s = settings(tracker=tracker)
    left = LEFT_BEHIND[name]
    come = [person(x, 0, RED) + left for x in np.linspace(-1.5, 0, 20)]
    infos, _ = run(come + [left] * 30, s, colours=colours)
    assert all(confirmed(i) == [1] for i in infos[:20])
    assert not any(confirmed(i) for i in infos[20 + s.lost_frames :])
    assert table(infos, s).frame.max() == 19


@pytest.mark.parametrize("colours", [True, False])
@pytest.mark.parametrize("tracker", TRACKERS)
def test_chair_that_is_pushed_through_the_room_is_nobody(tracker, colours):
    """It stands there, is taken along for 1.5 m, and its mover walks away and goes out of the room."""
    s = settings(tracker=tracker)
    come = [person(x, 0, RED) + chair(-0.6, 0) for x in np.linspace(-2.4, -0.95, 24)]
    push = [person(x - 0.35, 0, RED) + chair(x, 0) for x in np.linspace(-0.6, 0.9, 25)]
    go = [person(0.55, y, RED) + chair(0.9, 0) for y in np.linspace(0, -2.8, 45)]
    infos, _ = run(come + push + go + [chair(0.9, 0)] * 15, s, colours=colours)
    assert all(len(confirmed(i)) <= 1 for i in infos)
    assert not any(confirmed(i) for i in infos[-8:])
    assert table(infos, s).persons == (1,)


@pytest.mark.parametrize("colours", [True, False])
@pytest.mark.parametrize("tracker", TRACKERS)
def test_who_drags_a_chair_to_the_door_and_leaves_does_not_live_on_in_it(tracker, colours):
    s = settings(tracker=tracker)
    xs = np.linspace(0.0, -3.0, 45)
    clip = [person(x, 0, RED) + chair(max(x + 0.35, -2.2), 0) for x in xs] + [chair(-2.2, 0)] * 25
    infos, _ = run(clip, s, colours=colours)
    assert all(len(confirmed(i)) <= 1 for i in infos)
    assert not any(confirmed(i) for i in infos[-15:])


@pytest.mark.parametrize("tracker", TRACKERS)
def test_who_lies_when_first_seen_is_a_person_once_he_moves(tracker):
    s = settings(tracker=tracker)
    infos, _ = run(STILL + FALL[::-1] + [person(0.05 * i, 0, RED) for i in range(8)], s)
    assert not any(confirmed(i) for i in infos[:40])
    assert confirmed(infos[-1]) == [1]
    tracks = table(infos, s)
    assert tracks.persons == (1,)
    assert len(tracks) == len(infos)  # backdated to the first frame


@pytest.mark.parametrize("tracker", TRACKERS)
def test_who_lies_still_in_a_room_that_is_known_empty_is_a_person(tracker):
    """After two seconds, say; a chair or a bag that somebody has put down is shorter."""
    s = settings(tracker=tracker, lying_frames=12)
    infos, _ = run(STILL[:1] * 20, s)
    assert not any(confirmed(i) for i in infos[:11])
    assert confirmed(infos[-1]) == [1]
    assert len(table(infos, s)) == len(infos)  # backdated to the first frame
    for thing in (chair(0, 0), [box(0, 0, 0.5, 0.25, 0.0, 0.5, (90, 60, 30))]):
        infos, _ = run([thing] * 20, s)
        assert not any(confirmed(i) for i in infos)


@pytest.mark.parametrize("tracker", TRACKERS)
def test_low_furniture_that_stands_still_is_never_a_person(tracker):
    bench = [box(0, 0, 0.75, 0.2, 0.0, 0.45, (90, 60, 30))]
    infos, _ = run([bench] * 60, settings(tracker=tracker))
    assert not any(confirmed(i) for i in infos)


@pytest.mark.parametrize("tracker", TRACKERS)
def test_helper_bends_over_somebody_who_lies(tracker):
    """One blob for a second, and two persons before and after."""
    s = settings(tracker=tracker)
    away = person(1.6, 0.9, BLUE)
    fall = [boxes + away for boxes in [person(0, 0, RED)] * 6 + FALL + STILL[:6]]
    walk = [lying(0, 0) + person(1.6 - 1.6 * u, 0.9 - 0.6 * u, BLUE) for u in np.linspace(0, 1, 20)]
    help_ = [lying(0, 0) + person(0, 0.3, BLUE)] * 15
    infos, _ = run(fall + walk + help_ + walk[::-1], s)
    assert any(i.n_components == 1 for i in infos)
    assert all(len(confirmed(i)) == 2 for i in infos)
    x = {t.person: t.xyz[0] for t in infos[-1].tracks}
    assert x[1] == pytest.approx(0.0, abs=0.05) or x[2] == pytest.approx(0.0, abs=0.05)
    first = {t.person: t.xyz[0] > 0.8 for t in infos[0].tracks}
    assert first == {p: v > 0.8 for p, v in x.items()}


def test_who_is_cut_off_while_crouching_is_followed_when_his_clothes_agree():
    """The hull of a crouching person loses and regains a third from frame to frame."""
    whole, part = (
        sinking(0, 0, 0.7),
        [box(0.1, 0, 0.2, 0.2, 0.0, 0.6, RED), box(0.1, 0, 0.2, 0.2, 0, 0.3, GREY)],
    )
    clip = [sinking(0, 0, h) for h in np.linspace(1.7, 0.7, 10)] + [whole, part] * 10
    infos, _ = run(clip, settings())
    assert all(i.tracks[0].is_seen for i in infos)


def test_who_is_out_of_sight_does_not_sink_into_the_floor():
    """The centroid drops fast, then nobody is there: the track walks on at its height."""
    sink = [sinking(0.04 * i, 0, h) for i, h in enumerate(np.linspace(1.7, 1.1, 8))]
    s = settings()
    infos, _ = run([person(0, 0, RED)] * 5 + sink + [[]] * 5, s)
    seen, *coasting = (i.tracks[0] for i in infos[12:])
    assert not seen.misses
    assert seen.velocity[2] < -0.3
    z = [t.xyz[2] for t in coasting]
    assert z == pytest.approx([z[0]] * len(z), abs=1e-12)
    assert coasting[-1].xyz[0] > coasting[0].xyz[0]
