"""Single mistakes of a calibration, told from outlines of somebody who walks."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from test_rig_refinement import RIG, film, wrong

from mocap.data import CameraRig
from mocap.volume.rig_doubts import doubt_rig

HULLS = [own[::4] for own in film()]


def test_a_right_rig_agrees_and_people_have_their_height() -> None:
    found = doubt_rig(RIG, HULLS)
    assert found.agrees
    assert found.mistake is None
    assert 1.2 < found.height_m < 2.4


def test_exchanged_cameras() -> None:
    found = doubt_rig(RIG, [HULLS[k] for k in (0, 3, 2, 1, 4)])
    assert (found.mistake, found.cameras) == ("exchanged", (RIG.names[1], RIG.names[3]))
    assert not found.agrees


@pytest.mark.parametrize("factor", [0.6, 0.75, 1.3, 1.8])
def test_another_zoom(factor: float) -> None:
    zoomed = replace(RIG[2], K=RIG[2].K * [[factor, 1, 1], [1, factor, 1], [1, 1, 1]])
    found = doubt_rig(CameraRig((*RIG.cameras[:2], zoomed, *RIG.cameras[3:])), HULLS)
    assert (found.mistake, found.cameras) == ("zoom", (RIG.names[2],))
    assert found.factor == pytest.approx(1 / factor, rel=0.03)


def test_mirrored_pictures_of_all_and_of_one() -> None:
    mirrored = [[(c.size[0] - 1 - h[:, 0], h[:, 1]) for h in own] for c, own in zip(RIG, HULLS, strict=True)]
    flipped = [[np.column_stack(h) for h in own] for own in mirrored]
    found = doubt_rig(RIG, flipped)
    assert (found.mistake, found.cameras) == ("mirrored", RIG.names)
    one = doubt_rig(RIG, [*HULLS[:3], flipped[3], HULLS[4]])
    assert (one.mistake, one.cameras) == ("mirrored", (RIG.names[3],))


def test_a_picture_upside_down() -> None:
    far = np.array(RIG[0].size) - 1.0
    found = doubt_rig(RIG, [[far - hull for hull in HULLS[0]], *HULLS[1:]])
    assert (found.mistake, found.cameras) == ("upside_down", (RIG.names[0],))


def test_a_rig_that_is_off_everywhere_is_no_single_mistake() -> None:
    found = doubt_rig(wrong(), HULLS)
    assert not found.agrees
    assert found.mistake is None
    assert found.worst in RIG.names


def test_a_rig_in_another_unit_agrees_and_its_people_are_giants() -> None:
    found = doubt_rig(CameraRig(tuple(replace(c, t=10 * c.t) for c in RIG)), HULLS)
    assert found.agrees
    assert found.height_m > 10


def test_nobody() -> None:
    found = doubt_rig(RIG, [[np.zeros((0, 2))] * 5] * len(RIG))
    assert np.isnan(found.apart_m)
    assert not found.agrees
