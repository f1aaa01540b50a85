"""The table of tracks: rows of one person, pieces, and uncertainty."""

import numpy as np
import pytest

from mocap.data import Tracks


def tracks():
    """Person 1 in frames 0, 1, 4, 5; person 2 in frame 1."""
    frame, person = np.array([0, 1, 1, 4, 5]), np.array([1, 1, 2, 1, 1])
    xyz = np.arange(15.0).reshape(5, 3)
    variance = np.arange(1.0, 6.0)[:, None, None] * np.eye(3)
    return Tracks(frame, person, frame / 10, xyz, variance, np.array([True, True, True, False, True]))


def test_rows_of_one_person_keep_everything():
    own = tracks().of(1)
    assert own.frame.tolist() == [0, 1, 4, 5]
    np.testing.assert_allclose(own.std[:, 1], np.sqrt([1, 2, 4, 5]))
    assert own.observed.tolist() == [True, True, False, True]


def test_pieces_end_where_frames_are_missing():
    pieces = tracks().paths(1)
    assert [p.frame.tolist() for p in pieces] == [[0, 1], [4, 5]]
    assert pieces[1].observed.tolist() == [False, True]
    assert len(tracks().paths(2)) == 1
    assert tracks().paths(7) == []


def test_wrong_shapes_are_named():
    t = tracks()
    with pytest.raises(ValueError, match="covariance"):
        Tracks(t.frame, t.person, t.time_s, t.xyz, t.covariance[:4])
    with pytest.raises(ValueError, match="observed"):
        Tracks(t.frame, t.person, t.time_s, t.xyz, t.covariance, t.observed[1:])
