"""How dark shadows get: a person's dark trousers and shadows on the floor, told apart by who else sees the floor."""

from __future__ import annotations

import numpy as np
import pytest
from test_occluders import ROOM, on_floor, ring_rig, standing_silhouettes
from test_witness import facing_away

from mocap.data import CameraRig
from mocap.volume import Shade, darkest_shadow

AT, BESIDE = np.array([0.1, -0.2]), np.array([0.9, 0.5])
USUAL = 0.5


def instants(trousers: float | None, lying: float, n: int = 3) -> list[list[Shade | None]]:
    """Somebody who stands beside a shadow.  trousers : the light of all that he is, taken for a shadow; None = he is
    not.  lying : of the shadow's middle; its rim is lighter.
    """
    found: list[Shade | None] = []
    for i, person in enumerate(standing_silhouettes(AT)):
        light = np.ones(person.shape, dtype=np.float32)
        for radius_m in (0.4, 0.3):
            light[on_floor(i, BESIDE, radius_m)] = lying + (0.1 if radius_m > 0.3 else 0.0)
        shadow = (light < 1) & ~person
        light[person] = 1.0 if trousers is None else trousers
        dark = person if trousers is not None else np.zeros_like(person)
        found.append(Shade(shadow | dark, person & ~dark, light))
    return [found] * n


@pytest.mark.parametrize(("trousers", "lying"), [(0.55, 0.66), (0.31, 0.42), (0.55, 0.9)])
def test_the_limit_lies_between_trousers_and_shadows(trousers: float, lying: float) -> None:
    darkest = darkest_shadow(ring_rig(), ROOM, instants(trousers, lying), USUAL)
    assert trousers < darkest <= lying


def test_shadows_alone_are_all_taken_for_shadows() -> None:
    assert darkest_shadow(ring_rig(), ROOM, instants(None, 0.35), USUAL) <= 0.35
    assert darkest_shadow(ring_rig(), ROOM, instants(None, 0.6), USUAL) == USUAL


def test_what_is_hardly_darker_is_not_asked_about() -> None:
    """Other cameras miss shadows that are as faint."""
    assert darkest_shadow(ring_rig(), ROOM, instants(0.8, 0.9), USUAL) == USUAL


def test_two_cameras_can_tell_and_one_cannot() -> None:
    rig = CameraRig(tuple(ring_rig())[:2])
    seen = [own[:2] for own in instants(0.31, 0.42)]
    assert 0.31 < darkest_shadow(rig, ROOM, seen, USUAL) <= 0.42
    assert darkest_shadow(rig, ROOM, [[own[0], None] for own in seen], USUAL) == USUAL
    assert darkest_shadow(rig, ROOM, [], USUAL) == USUAL


def test_who_sees_nothing_of_the_floor_there_has_no_say() -> None:
    """It is out of his picture, or somebody stands before it."""
    one, other = tuple(ring_rig())[:2]
    seen = [own[:2] for own in instants(0.55, 0.9)]
    assert darkest_shadow(CameraRig((one, other)), ROOM, seen, USUAL) > USUAL
    assert darkest_shadow(CameraRig((one, facing_away(other))), ROOM, seen, USUAL) == USUAL
    before = [
        [own[0], own[1]._replace(shadow=own[1].person, person=~own[1].person)] for own in seen if own[1]
    ]
    assert darkest_shadow(CameraRig((one, other)), ROOM, before, USUAL) == USUAL


@pytest.mark.parametrize(("side_px", "is_told"), [(7, False), (20, True)])
def test_a_few_pixels_change_nothing(side_px: int, is_told: bool) -> None:
    few = []
    for i, person in enumerate(standing_silhouettes(AT)):
        rows, columns = np.nonzero(person)
        light = np.ones(person.shape, dtype=np.float32)
        if i == 0:
            light[rows.max() - side_px : rows.max(), columns.min() : columns.min() + side_px] = 0.55
        light[rows.max() + 2] = 0.55  # a rim, wide as a pixel: colours of both sides are mixed there
        few.append(Shade(light < 1, np.zeros_like(person), light))
    assert (darkest_shadow(ring_rig(), ROOM, [few] * 2, USUAL) > USUAL) == is_told


def test_of_large_shadows_some_places_are_asked_about(monkeypatch: pytest.MonkeyPatch) -> None:
    whole = darkest_shadow(ring_rig(), ROOM, instants(0.55, 0.66), USUAL)
    monkeypatch.setattr("mocap.volume.shade._PIXELS", 30)
    assert darkest_shadow(ring_rig(), ROOM, instants(0.55, 0.66), USUAL) == pytest.approx(whole, abs=0.05)


def test_trousers_do_not_witness_for_each_other() -> None:
    """The floor behind a dark leg is hidden by the other one from the camera opposite, and lit in no picture."""
    rig = CameraRig(tuple(ring_rig())[:4])
    seen = []
    for dark, person in zip((0.31, 0.42, 0.53, 0.64), standing_silhouettes(AT), strict=False):
        seen.append(Shade(person, ~person, np.where(person, np.float32(dark), np.float32(0.1))))
    assert darkest_shadow(rig, ROOM, [seen], USUAL) == USUAL
    same = [shade._replace(light=np.where(shade.shadow, np.float32(0.4), np.float32(0))) for shade in seen]
    assert darkest_shadow(rig, ROOM, [same], USUAL) <= 0.4
