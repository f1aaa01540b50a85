"""The naive tracker on bodies of boxes: who owns which voxel, and how tracks live and die."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.ndimage import label

from mocap.tracking import (
    FrameVoxels,
    TrackerSettings,
    TrackerState,
    published_settings,
    tracks_from_history,
)
from mocap.tracking import track_clip as track_frames
from mocap.tracking import track_step as step_of
from mocap.tracking.state import COASTING, CONFIRMED, TENTATIVE

SIDE = 0.05
FPS = 25.0
SETTINGS = TrackerSettings(SIDE, lost_frames=4, confirm_frames=3, tentative_misses=1)


def track_step(state, centers, labels, frame, settings):
    observation = FrameVoxels(frame, centers, labels)
    return step_of(state, observation, settings, rng=np.random.default_rng(0))


def track_clip(frames, settings, fps):
    observations = (FrameVoxels(*frame) for frame in frames)
    return track_frames(observations, settings, fps, rng=np.random.default_rng(0))


def box(x, y, half_x, half_y, z0, z1):
    return ((x - half_x, y - half_y, z0), (x + half_x, y + half_y, z1))


def person(x, y, height=1.7):
    return [box(x, y, 0.15, 0.2, 0.0, height)]


def arms(x, y):
    """Outstretched arms, far outside the ellipsoid of influence."""
    return [box(x, y, 0.06, 0.9, 1.3, 1.45)]


def scene(*boxes):
    """Voxel centres and 26-connected labels of a union of boxes, as the volume stage gives them."""
    shape = (100, 100, 50)
    dense = np.zeros(shape, dtype=bool)
    origin = np.array([-2.5, -2.5, 0.0])
    for lower, upper in boxes:
        a = np.round((np.array(lower) - origin) / SIDE).astype(int).clip(0)
        b = np.round((np.array(upper) - origin) / SIDE).astype(int)
        dense[a[0] : b[0], a[1] : b[1], a[2] : b[2]] = True
    labels, _ = label(dense, structure=np.ones((3, 3, 3)))
    where = np.argwhere(dense)
    return origin + (where + 0.5) * SIDE, labels[dense] - 1


def run(clip, settings=SETTINGS, state=None):
    state = TrackerState() if state is None else state
    infos = []
    for boxes in clip:
        frame = 0 if state.frame is None else state.frame + 1
        state, info = track_step(state, *scene(*boxes), frame, settings)
        infos.append(info)
    return state, infos


def ids(info):
    return [t.person for t in info.tracks]


def test_single_frame_gives_a_confirmed_track_at_the_volume_centroid():
    centers, labels = scene(*person(0.5, -0.25))
    _, info = track_step(TrackerState(), centers, labels, 0, SETTINGS)
    assert [(t.person, t.status) for t in info.tracks] == [(1, CONFIRMED)]
    np.testing.assert_allclose(info.tracks[0].xyz, centers.mean(axis=0))
    np.testing.assert_array_equal(info.voxels_of[1], np.arange(len(centers)))
    tracks = track_clip([(0, centers, labels)], SETTINGS, FPS)
    assert (list(tracks.frame), list(tracks.person)) == ([0], [1])


def test_outstretched_arms_are_not_cut_off():
    clip = [person(0, 0), person(0, 0) + arms(0, 0)]
    _, infos = run(clip)
    centers, _ = scene(*clip[1])
    assert np.ptp(centers[:, 1]) > 1.7
    assert len(infos[1].voxels_of[1]) == len(centers)


def test_walking_person_keeps_id_and_position_is_the_centroid():
    clip = [person(-1.5 + 0.05 * i, 0.3) for i in range(40)]
    _, infos = run(clip)
    for info, boxes in zip(infos, clip, strict=True):
        assert ids(info) == [1]
        np.testing.assert_allclose(info.tracks[0].xyz, scene(*boxes)[0].mean(axis=0), atol=1e-9)


def test_late_track_is_tentative_then_confirmed_and_backdated():
    clip = [[]] * 2 + [person(0, 0)] * 5
    _, infos = run(clip)
    assert [[t.status for t in info.tracks] for info in infos] == [
        [],
        [],
        [TENTATIVE],
        [TENTATIVE],
        [CONFIRMED],
        [CONFIRMED],
        [CONFIRMED],
    ]
    history = [(i.frame, i.tracks) for i in infos]
    assert list(tracks_from_history(history, FPS).frame) == [2, 3, 4, 5, 6]
    assert list(tracks_from_history(history, FPS, backdate=False).frame) == [4, 5, 6]


def test_specks_and_furniture_make_no_track():
    chair = [box(1.5, 1.5, 0.25, 0.25, 0.0, 0.5)]
    specks = [box(-1.5, y, 0.05, 0.05, 1.0, 1.1) for y in (-1.0, 0.0, 1.0)]
    _, infos = run([chair + specks] * 5)
    assert all(not info.tracks for info in infos)
    assert infos[0].n_components == 4
    assert infos[0].n_unassigned == len(scene(*chair, *specks)[0])


def test_ghost_that_fuses_with_a_person_before_it_is_confirmed_is_dropped():
    """Tolerant carving makes a blob between two persons, which then melts into one of them."""
    clip = [person(0, 0)] * 3
    clip += [person(0, 0) + person(0.7, 0)] * 2 + [[*person(0, 0), box(0.4, 0, 0.35, 0.1, 0.0, 1.7)]] * 3
    _, infos = run(clip)
    assert infos[3].created == (2,)
    assert [(t.person, t.status) for t in infos[-1].tracks] == [(1, CONFIRMED)]
    assert len(infos[-1].voxels_of[1]) == len(scene(*clip[-1])[0])


def test_flicker_is_never_confirmed_and_its_id_is_used_again():
    clip = [person(-1, 0)] * 2 + [person(-1, 0) + person(1.5, 0)] + [person(-1, 0)] * 4
    clip += [person(-1, 0) + person(1.5, 1)] * 4
    _, infos = run(clip)
    assert infos[2].created == (2,)
    assert infos[4].deleted == {2: "lost"}
    assert infos[-1].tracks[1].status == CONFIRMED
    tracks = tracks_from_history([(i.frame, i.tracks) for i in infos], FPS)
    assert tracks.persons == (1, 2)
    assert list(tracks.of(2).frame) == [7, 8, 9, 10]


def test_phantom_lives_for_the_stated_number_of_frames_and_leaves_no_rows():
    clip = [person(0, 0)] * 4 + [[]] * 8
    _, infos = run(clip)
    alive = [bool(info.tracks) for info in infos]
    assert alive == [True] * (4 + SETTINGS.lost_frames) + [False] * (8 - SETTINGS.lost_frames)
    assert infos[4].tracks[0].status == COASTING
    assert len(infos[4].voxels_of[1]) == 0
    tracks = tracks_from_history([(i.frame, i.tracks) for i in infos], FPS)
    assert list(tracks.frame) == [0, 1, 2, 3]


def test_gap_is_bridged_by_interpolation_with_the_same_id():
    clip = [person(0, 0)] * 3 + [[]] * 3 + [person(0.4, 0)] * 3
    _, infos = run(clip)
    tracks = tracks_from_history([(i.frame, i.tracks) for i in infos], FPS)
    assert list(tracks.person) == [1] * 9
    np.testing.assert_allclose(tracks.xyz[2:7, 0], [0.0, 0.1, 0.2, 0.3, 0.4], atol=1e-9)


def test_confirmed_ids_are_never_given_to_somebody_else():
    clip = [person(0, 0)] * 3 + [[]] * 6 + [person(0, 0)] * 4
    _, infos = run(clip)
    assert ids(infos[-1]) == [2]


def test_persons_who_fuse_are_divided_and_separate_again():
    gaps = [1.2, 1.0, 0.8, 0.6, 0.5, 0.4, 0.4, 0.4, 0.5, 0.6, 0.8, 1.0, 1.2]
    clip = [person(-g / 2, 0) + person(g / 2, 0, 1.6) for g in gaps]
    handshake = [box(0, 0, 0.6, 0.06, 1.0, 1.1)]
    clip[4:9] = [boxes + handshake for boxes in clip[4:9]]
    assert len(np.unique(scene(*clip[6])[1])) == 1
    _, infos = run(clip)
    for info, gap, boxes in zip(infos, gaps, clip, strict=True):
        assert ids(info) == [1, 2]
        x = {t.person: t.xyz[0] for t in info.tracks}
        assert min(x.values()) == pytest.approx(-gap / 2, abs=0.08)
        assert max(x.values()) == pytest.approx(gap / 2, abs=0.08)
        sets = list(info.voxels_of.values())
        assert not set(sets[0]) & set(sets[1])
        assert len(sets[0]) + len(sets[1]) == len(scene(*boxes)[0])
    first, last = ({t.person: t.xyz[0] > 0 for t in infos[i].tracks} for i in (0, -1))
    assert first == last


def test_neighbour_takes_no_voxels_from_a_separate_person_with_arms_out():
    clip = [person(0, -0.9) + person(0, 0.9)] * 2
    clip += [person(0, -0.9) + person(0, 0.9) + [box(0, 0.15, 0.06, 0.75, 1.3, 1.45)]] * 2
    _, infos = run(clip)
    centers, labels = scene(*clip[-1])
    assert len(np.unique(labels)) == 2
    for voxels in infos[-1].voxels_of.values():
        assert len(np.unique(labels[voxels])) == 1
    assert sum(len(v) for v in infos[-1].voxels_of.values()) == len(centers)


def test_published_ellipsoids_drop_what_two_of_them_hold():
    """CF Eq. 4.4 and 4.7 as printed: arms are cut off, and the voxels between two persons are nobody's."""
    s = published_settings("naive", SIDE, confirm_frames=3, colour=False)
    _, infos = run([person(0, 0) + arms(0, 0)] * 3, s)
    centers, _ = scene(*person(0, 0), *arms(0, 0))
    held = centers[infos[-1].voxels_of[1]]
    assert np.abs(held[:, 1]).max() <= 0.45
    assert infos[-1].n_unassigned > 0
    clip = [person(-x, 0) + person(x, 0) for x in (0.7, 0.6, 0.5, 0.4, 0.3, 0.25)]
    _, infos = run(clip, s)
    x, y, z = scene(*clip[-1])[0].T
    middle = (np.abs(y) < 0.1) & (np.abs(z - 0.85) < 0.2)
    for voxels in infos[-1].voxels_of.values():
        # Half-way up each ellipsoid reaches 0.2 m, into the neighbour, who starts at 0.1 m: that is nobody's.
        mine = voxels[middle[voxels]]
        assert np.abs(x[mine]).min() > 0.15
    assert infos[-1].n_unassigned > 0


def test_lost_track_beside_another_person_does_not_cut_it():
    clip = [person(0, 0) + person(0.55, 0)] * 3 + [person(0.1, 0) + arms(0.1, 0)] * 3
    _, infos = run(clip)
    n = len(scene(*clip[-1])[0])
    assert sorted(len(v) for v in infos[-1].voxels_of.values()) == [0, n]


def test_cut_off_hand_belongs_to_its_person_and_a_far_piece_does_not():
    hand, far = box(0, 0.7, 0.1, 0.1, 1.3, 1.4), box(0, 2.0, 0.1, 0.1, 1.3, 1.4)
    centers, labels = scene(*person(0, 0), hand, far)
    _, info = track_step(TrackerState(), centers, labels, 0, SETTINGS)
    owned = centers[info.voxels_of[1]]
    assert owned[:, 1].max() == pytest.approx(0.775)
    assert info.n_unassigned == 16 * 2


def test_body_in_two_pieces_is_one_person():
    legs, trunk = box(0, 0, 0.15, 0.2, 0.0, 0.85), box(0, 0, 0.15, 0.2, 0.95, 1.7)
    _, infos = run([[legs, trunk]] * 4)
    assert ids(infos[-1]) == [1]
    assert infos[-1].n_unassigned == 0


def test_ellipsoid_cuts_a_person_out_of_a_wall():
    wall = [box(0.5, 0, 0.1, 2.4, 0.0, 2.3)]
    clip = [person(0, 0)] * 3 + [[*person(0.2, 0), *person(0.3, 0), *wall]] * 3
    _, infos = run(clip)
    track = infos[-1].tracks[0]
    assert (track.status, track.person) == (CONFIRMED, 1)
    assert np.linalg.norm(track.xyz[:2] - [0.35, 0]) < 0.2
    assert infos[-1].n_unassigned > 1000


def on_one_person(weight_kg):
    """State with two tracks that both sit on the person at the origin, as after a mistake."""
    state, _ = run([person(-0.4, 0) + person(0.4, 0)] * 3)
    tracks = tuple(
        replace(t, xyz=np.array([0.02 * t.person, 0.0, 0.85]), weight_kg=weight_kg) for t in state.tracks
    )
    return replace(state, tracks=tracks)


def test_track_whose_person_vanished_into_another_is_lost():
    """The component weighs 224 kg, as each of the two tracks used to alone."""
    state, infos = run([person(0, 0)] * (SETTINGS.lost_frames + 1), state=on_one_person(224.0))
    assert len(state.tracks) == 1
    assert list(infos[-1].deleted.values()) == ["lost"]
    for info in infos:
        assert max(len(v) for v in info.voxels_of.values()) == len(scene(*person(0, 0))[0])


def test_two_tracks_too_near_for_too_long_are_merged():
    n = SETTINGS.merge_frames
    state, infos = run([person(0, 0)] * (n + 1), state=on_one_person(112.0))
    assert [len(info.tracks) for info in infos] == [2] * n + [1]
    assert infos[-1].deleted == {2: "merged"}
    assert len(infos[-1].voxels_of[1]) == len(scene(*person(0, 0))[0])
    assert state.confirmed_ids == {1, 2}


def test_leaping_person_is_taken_over_by_the_track_without_voxels():
    _, infos = run([person(0, 0)] * 3 + [person(0.9, 0)] * 2)
    assert ids(infos[-1]) == [1]
    _, infos = run([person(0, 0)] * 3 + [person(1.6, 0)] * 4)
    assert [(t.person, t.status) for t in infos[-1].tracks] == [(1, COASTING), (2, CONFIRMED)]


def test_empty_room_and_ignored_labels():
    state, info = track_step(TrackerState(), np.zeros((0, 3)), np.zeros(0, int), 0, SETTINGS)
    assert (state.tracks, info.n_components, info.n_unassigned) == ((), 0, 0)
    centers, labels = scene(*person(0, 0))
    _, info = track_step(state, centers, np.full_like(labels, -1), 1, SETTINGS)
    assert not info.tracks
    assert len(track_clip([], SETTINGS, FPS)) == 0
    assert track_clip([(0, np.zeros((0, 3)), np.zeros(0, int))], SETTINGS, FPS).xyz.shape == (0, 3)


def test_wrong_arguments_are_named():
    centers, labels = scene(*person(0, 0))
    with pytest.raises(ValueError, match="centers"):
        track_step(TrackerState(), centers[:, :2], labels, 0, SETTINGS)
    with pytest.raises(ValueError, match="labels"):
        track_step(TrackerState(), centers, labels[:-1], 0, SETTINGS)
    with pytest.raises(ValueError, match="frame 3"):
        track_step(TrackerState(frame=3), centers, labels, 3, SETTINGS)
    with pytest.raises(ValueError, match="voxel_size_m"):
        TrackerSettings(0.0)
    with pytest.raises(ValueError, match="confirm_frames"):
        TrackerSettings(SIDE, confirm_frames=0)
    with pytest.raises(ValueError, match="fps"):
        track_clip([], SETTINGS, 0.0)


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_order_of_voxels_and_names_of_labels_change_nothing(seed):
    rng = np.random.default_rng(seed)
    clip = [person(-0.5 + 0.04 * i, -0.3) + person(0.6, 0.5 - 0.04 * i, 1.5) for i in range(4)]
    plain = shuffled = TrackerState()
    for frame, boxes in enumerate(clip):
        centers, labels = scene(*boxes)
        order = rng.permutation(len(centers))
        names = rng.permutation(1000)[: labels.max() + 1]
        # Equal up to the numbering, which follows weight and then label: the persons' weights differ.
        plain, a = track_step(plain, centers, labels, frame, SETTINGS)
        shuffled, b = track_step(shuffled, centers[order], names[labels][order], frame, SETTINGS)
        assert ids(a) == ids(b)
        for p in a.voxels_of:
            np.testing.assert_array_equal(a.voxels_of[p], np.sort(order[b.voxels_of[p]]))


def test_state_is_not_changed_by_a_step():
    state, _ = run([person(0, 0)] * 2)
    before = [(t.person, t.xyz.copy(), t.status, t.age) for t in state.tracks]
    for dx in (0.0, 0.1):
        track_step(state, *scene(*person(dx, 0)), 2, SETTINGS)
    for (p, xyz, status, age), t in zip(before, state.tracks, strict=True):
        assert (p, status, age) == (t.person, t.status, t.age)
        np.testing.assert_array_equal(xyz, t.xyz)


def test_one_frame_ghost_in_the_first_frame_is_left_out_of_a_long_clip():
    clip = [person(-1, 0) + person(1.5, 0)] + [person(-1, 0)] * 8
    frames = [(i, *scene(*boxes)) for i, boxes in enumerate(clip)]
    assert track_clip(frames, SETTINGS, FPS).persons == (1,)
    assert track_clip(frames[:1], SETTINGS, FPS).persons == (1, 2)


def test_rows_are_sorted_and_timed():
    clip = [person(-1, 0) + person(1.0, 0, 1.5)] * 3
    tracks = track_clip([(7 + i, *scene(*boxes)) for i, boxes in enumerate(clip)], SETTINGS, FPS)
    rows = list(zip(tracks.frame.tolist(), tracks.person.tolist(), strict=True))
    assert rows == list(itertools.product([7, 8, 9], [1, 2]))
    np.testing.assert_allclose(tracks.time_s, tracks.frame / FPS)
