"""A run writes the body that it has sized, and another run takes it over instead of measuring again."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from small_session import PLAIN, copy_session, small_session

from mocap.body import load_body_model, scale_body
from mocap.body.stretch import lengths_of
from mocap.io.store import StageStore
from mocap.pipeline.config import load_config
from mocap.pipeline.run import run_session
from mocap.products.poses import body_files, stored_poses

SETTINGS = (*PLAIN, "output.formats=[]")


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Path:
    base = tmp_path_factory.getbasetemp()
    return copy_session(
        small_session(base), tmp_path_factory.mktemp("body") / "session", masks=True, n_frames=5
    )


@pytest.fixture(scope="module")
def out(session: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("body") / "out"
    run_session(session, folder, config=load_config("default", SETTINGS))
    return folder


def test_a_run_takes_over_the_body_of_another(
    session: Path, out: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (first,) = stored_poses(StageStore(out / "store.zarr"))

    def measured(*_: object) -> None:
        raise AssertionError("the height was measured again")

    monkeypatch.setattr("mocap.pipeline.stages.pose.estimate_height", measured)
    # The session says another height, and the body file, which is named for this run, wins.
    (session / "session.toml").write_text(
        (session / "session.toml").read_text() + "\nperson_height_m = 1.5\n"
    )
    config = load_config("default", (*SETTINGS, f"body.model={out / 'body.toml'}"))
    again = run_session(session, tmp_path / "again", config=config)
    (second,) = again.poses
    assert second.height.height_m == pytest.approx(first.height.height_m, abs=0.5e-4)
    assert second.height.is_measured
    for key, value in lengths_of(first.body).items():
        np.testing.assert_allclose(lengths_of(second.body)[key], value, atol=1e-4)
    assert (tmp_path / "again" / "body.toml").read_text() == (out / "body.toml").read_text()


def test_the_poses_can_be_read_when_the_body_file_is_gone(session: Path, out: Path, tmp_path: Path) -> None:
    own = tmp_path / "own.toml"
    own.write_text((out / "body.toml").read_text())
    run_session(
        session,
        tmp_path / "out",
        config=load_config("default", (*SETTINGS, f"body.model={own}")),
        until="pose",
    )
    own.unlink()
    (poses,) = stored_poses(StageStore(tmp_path / "out" / "store.zarr"))
    assert np.isfinite(poses.landmarks).all()


def test_several_persons_have_a_file_each(out: Path) -> None:
    store = StageStore(out / "store.zarr")
    (one,) = stored_poses(store)
    other = replace(
        one,
        person=4,
        body=scale_body(load_body_model("whole"), 1.61),
        height=replace(one.height, is_measured=False),
    )
    files = body_files(store, [one, other])
    assert set(files) == {f"body_{one.person}.toml", "body_4.toml"}
    assert "\nheight_m = 1.61\n" in files["body_4.toml"]
    assert "not measured" in files["body_4.toml"].splitlines()[0]
    assert "person 4" in files["body_4.toml"].splitlines()[0]


def test_the_motion_is_described_in_run_json(out: Path) -> None:
    person = json.loads((out / "run.json").read_text())["numbers"]["pose"]["persons"]["1"]
    assert person["jitter_m_s3"] > 0
    assert 0 <= person["observed_percent"] <= 100
