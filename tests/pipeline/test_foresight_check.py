"""What `mocap check` expects of where cameras stand."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from small_session import copy_session, mocap, small_session

from mocap.data import CameraRig
from mocap.io.session import Session, open_session
from mocap.pipeline.foresight_check import check_foresight, whole_places


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Session:
    base = small_session(tmp_path_factory.getbasetemp())
    return open_session(copy_session(base, tmp_path_factory.mktemp("foresight") / "session", masks=True))


def expected_mm(said: str) -> float:
    found = re.search(r"expected (\d+) mm off in the middle", said)
    assert found is not None
    return float(found[1])


def test_fewer_cameras_are_expected_to_do_worse(session: Session) -> None:
    said = [
        check_foresight(replace(session, rig=session.rig.subset(session.rig.names[:n])))[0].message
        for n in (2, 3, 4)
    ]
    found = [expected_mm(text) for text in said]
    assert found[0] > found[1] > found[2]


def test_every_kind_of_landmark_is_told_the_surest_first(session: Session) -> None:
    inside = re.search(r"in the middle \((.*)\)", check_foresight(session)[0].message)
    assert inside is not None
    found = [tuple(one.split()) for one in inside[1].split(", ")]
    assert {word for word, _ in found} == {
        "head", "neck", "pelvis", "shoulders", "elbows", "wrists", "hips", "knees", "ankles"
    }  # fmt: skip
    numbers = [int(mm) for _, mm in found]
    assert numbers == sorted(numbers)
    assert found[-1][0] == "wrists"


def test_one_more_camera_is_proposed_where_it_helps(session: Session) -> None:
    said = check_foresight(session)
    assert [finding.severity for finding in said] == ["ok", "ok"]
    found = re.search(
        r"x (-?[\d.]+), y (-?[\d.]+) m: (\d+) mm in the middle would become (\d+)", said[1].message
    )
    assert found is not None
    x, y, before, after = map(float, found.groups())
    assert after < before == expected_mm(said[0].message)
    away = [np.hypot(*(camera.center[:2] - [x, y])) for camera in session.rig]
    assert min(away) > 0.5


def test_cameras_at_one_side_see_what_is_before_them(session: Session) -> None:
    centers = np.array([camera.center[:2] for camera in session.rig])
    apart = np.linalg.norm(centers[:, None] - centers[None], axis=2) + 9 * np.eye(len(centers))
    pair = session.rig.subset([session.rig.names[k] for k in np.unravel_index(apart.argmin(), apart.shape)])
    places = whole_places(pair, 1.75)
    assert np.linalg.norm(places, axis=1).min() < 0.3, "the middle of the room"
    assert len(check_foresight(replace(session, rig=pair))) == 2


def test_many_cameras_need_no_other(session: Session) -> None:
    more = [replace(c, name=f"{c.name}_{i}") for i in range(2) for c in session.rig]
    assert len(check_foresight(replace(session, rig=CameraRig(tuple(more))))) == 1


def test_nothing_is_foreseen_where_nothing_is_seen_in_common(session: Session) -> None:
    one = session.rig[0]
    R = np.diag([-1.0, 1.0, -1.0]) @ one.R
    turned = replace(one, name="turned", R=R, t=-R @ one.center)
    apart = CameraRig((one, turned))
    assert not len(whole_places(apart, 1.75))
    assert check_foresight(replace(session, rig=apart)) == []


def test_the_command_says_it(session: Session, tmp_path: Path) -> None:
    done = mocap("check", session.root)
    assert done.code == 0
    assert "by where the cameras stand, landmarks can be expected" in " ".join(done.out.split())
