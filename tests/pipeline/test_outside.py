"""No command puts its results into a session, whatever they are."""

from __future__ import annotations

from pathlib import Path

import pytest
from small_session import mocap, small_session

from mocap.errors import MocapError
from mocap.pipeline.outside import check_outside

REFUSED = "do not belong into the session"
COMMANDS = {
    "run": "run {session} -o {out}",
    "segment": "segment {session} -o {out}",
    "export voxels": "export {run} -o {out}",
    "export motion": "export {run} --what motion -o {out}",
    "view": "view {run} {session} -o {out}/scene.rrd",
    "bundle": "bundle {run} -o {out}/bundle.zip",
    "bundle with session": "bundle {run} {session} -o {out}/bundle.zip",
    "depth": "depth {session} -o {out}",
    "room": "depth {session} --what room -o {out}",
    "batch": "batch {session} -o {out} --workers 0",
    "sweep": "sweep {spec} -o {out} --workers 0",
}


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return small_session(tmp_path_factory.mktemp("outside"))


@pytest.mark.parametrize("place", [".", "masks", "results/deep"])
@pytest.mark.parametrize("command", COMMANDS)
def test_results_of_no_command_go_into_the_session(
    session: Path, tmp_path: Path, command: str, place: str
) -> None:
    spec = tmp_path / "sweep.toml"
    spec.write_text(f'sessions = ["{session}"]\n')
    before = sorted(session.rglob("*"))
    words = COMMANDS[command].format(session=session, run=tmp_path / "run", out=session / place, spec=spec)
    said = mocap(*words.split())
    assert said.code == 2, said
    assert REFUSED in said.err
    assert "Remedy: choose a place beside it with -o" in said.err
    assert sorted(session.rglob("*")) == before


def test_of_a_session_that_is_not_known_its_form_tells(session: Path, tmp_path: Path) -> None:
    link = tmp_path / "link"
    link.symlink_to(session, target_is_directory=True)
    for place in (session, session / "masks" / "cam_0", link / "bvh"):
        with pytest.raises(MocapError, match=REFUSED):
            check_outside(place)
    check_outside(session.parent / "bvh")


@pytest.mark.parametrize("name", ["calibration.toml", "session.toml", "videos"])
def test_a_working_folder_with_one_thing_of_a_session_is_none(tmp_path: Path, name: str) -> None:
    (tmp_path / name).mkdir()
    check_outside(tmp_path / "bvh")


def test_beside_a_known_session_a_folder_above_may_look_like_one(session: Path) -> None:
    """Clips and a calibration lie in the working folder, `mocap init` has made a session in it."""
    inner = session / "session"
    check_outside(session / "result", inner)
    with pytest.raises(MocapError, match=REFUSED):
        check_outside(inner / "result", inner)
