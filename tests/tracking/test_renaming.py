"""Renaming of tracks: swaps, merges, splits and deletions are all of this kind."""

import numpy as np

from mocap.data import Tracks
from mocap.tracking.renaming import DELETED, Renaming, renamed, renamed_tracks, sources_of


def tracks() -> Tracks:
    frame = np.repeat(np.arange(6), 2)
    person = np.tile([1, 2], 6)
    return Tracks(frame, person, frame / 10.0, np.stack([person, frame, frame], axis=1).astype(float))


def test_a_swap_is_its_own_inverse_and_sorts_rows() -> None:
    swap = Renaming(range(2, 4), {1: 2, 2: 1})
    once = renamed_tracks(tracks(), [swap])
    assert once.person.tolist() == tracks().person.tolist(), "rows are sorted by person in every frame"
    assert once.of(1).xyz[:, 0].tolist() == [1, 1, 2, 2, 1, 1]
    twice = renamed_tracks(tracks(), [swap, swap])
    np.testing.assert_array_equal(twice.xyz, tracks().xyz)


def test_names_are_those_that_the_renaming_before_has_given() -> None:
    steps = [Renaming(range(3, 6), {1: 3}), Renaming(range(3), {1: DELETED}), Renaming(range(6), {3: 1})]
    found = renamed_tracks(tracks(), steps)
    assert found.of(1).frame.tolist() == [3, 4, 5]
    assert found.of(2).frame.tolist() == list(range(6))
    assert sources_of(tracks(), steps, 1) == ((3, 6, 1),)
    assert sources_of(tracks(), [Renaming(range(2, 4), {1: 2, 2: 1})], 1) == ((0, 2, 1), (2, 4, 2), (4, 6, 1))


def test_owners_of_one_frame_keep_their_kind() -> None:
    owner = np.array([0, 1, 2, 1], dtype=np.uint16)
    found = renamed(owner, 3, [Renaming(range(3, 4), {1: DELETED, 2: 1})])
    assert found.tolist() == [0, DELETED, 1, DELETED]
    assert found.dtype == np.uint16
    assert renamed(owner, 4, [Renaming(range(3, 4), {1: 2})]).tolist() == owner.tolist()
