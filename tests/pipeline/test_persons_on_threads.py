"""Several persons are followed on threads of their own, with the same result as one after the other."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from small_session import PLAIN, copy_session, small_session

from mocap.io.session import open_session
from mocap.io.store import StageStore
from mocap.pipeline.config import load_config
from mocap.pipeline.run import run_session
from mocap.pipeline.stage import Job
from mocap.pipeline.stages import pose
from mocap.pose.result import PersonPoses
from mocap.products.tracks import stored_tracks


def test_two_persons_on_two_threads_are_those_of_one(
    tmp_path_factory: pytest.TempPathFactory, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    base = tmp_path_factory.getbasetemp()
    root = copy_session(small_session(base), tmp_path / "session", masks=True, n_frames=4)
    config = load_config("default", (*PLAIN, "output.formats=[]"))
    run_session(root, tmp_path / "out", config=config, until="track")
    session, store = open_session(root), StageStore(tmp_path / "out" / "store.zarr")
    tracks = stored_tracks(store, session.fps)
    # Two who stand in the same place: the second one has the first one's hulls.
    names = ("frame", "time_s", "xyz", "covariance", "observed")
    both = replace(
        tracks,
        **{name: np.concatenate([getattr(tracks, name)] * 2) for name in names},
        person=np.repeat([1, 2], len(tracks)),
    )
    hulls_of = pose.hulls_of_person
    monkeypatch.setattr(
        pose, "hulls_of_person", lambda session, store, person, *more: hulls_of(session, store, 1)
    )
    said: list[int] = []

    def poses(n_threads: int) -> list[PersonPoses]:
        said.clear()
        job = Job(
            session, config, store, seed=3, n_threads=n_threads, progress=lambda *what: said.append(what[1])
        )
        return pose.estimate_poses(job, both)

    alone, together = poses(1), poses(2)
    assert said == list(range(1, len(both) + 1))
    assert [p.person for p in together] == [1, 2]
    for a, b in zip(alone, together, strict=True):
        np.testing.assert_array_equal(a.states, b.states)
        np.testing.assert_array_equal(a.landmark_covariance, b.landmark_covariance)
    assert np.abs(alone[0].states - alone[1].states).max() > 0, "each has random numbers of its own"
