"""Somebody in trousers of the floor's colour, and his shadow, in pictures of several cameras."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any
from unittest import mock

import cv2
import numpy as np
import pytest
from outline_world import box_silhouettes, make_rig

from mocap.foreground import Background, ForegroundMask, ForegroundSettings, Segmenter
from mocap.pipeline.shade import with_shadows_in

SETTINGS = ForegroundSettings()
FLOOR = np.array([120.0, 100.0, 90.0])
TROUSERS, SHADE = 0.57, 0.72  # of the light


def room() -> Any:
    return SimpleNamespace(rig=make_rig(), room_bounds_m=None)


def pictures(
    light: float, exposure: float = 1.0, shade: float = SHADE
) -> tuple[list[Background], list[np.ndarray], list[np.ndarray]]:
    """What every camera has of the empty room, shows, and should find; somebody is as dark as `light`."""
    rng = np.random.default_rng(6)
    persons = box_silhouettes(make_rig(), (-0.2, -0.2, 0.0), (0.2, 0.2, 1.4), 0.02)
    shadows = box_silhouettes(make_rig(), (0.2, -0.5, 0.0), (0.9, 0.4, 0.01), 0.02)
    backgrounds, shown = [], []
    for person, shadow in zip(persons, shadows, strict=True):
        mean = FLOOR * cv2.resize(rng.uniform(0.85, 1.15, (8, 10)), person.shape[::-1])[..., None]
        picture = np.where(person, light, np.where(shadow, shade, 1.0))[..., None] * mean * exposure
        shown.append(np.clip(picture + rng.normal(0, 1.0, mean.shape), 0, 255).astype(np.uint8))
        backgrounds.append(
            Background(mean.astype(np.float32), np.ones_like(mean, np.float32), 12, "clip", 0.0)
        )
    return backgrounds, shown, persons


def iou(
    backgrounds: list[Background], shown: list[np.ndarray], persons: list[np.ndarray], s: ForegroundSettings
) -> float:
    found = [Segmenter(b, s).segment(picture).mask for b, picture in zip(backgrounds, shown, strict=True)]
    hit = sum(np.count_nonzero(a & b) for a, b in zip(found, persons, strict=True))
    return hit / sum(np.count_nonzero(a | b) for a, b in zip(found, persons, strict=True))


@pytest.mark.parametrize("exposure", [1.0, 0.8])
def test_trousers_of_the_floors_colour_are_told_from_shadows(exposure: float) -> None:
    backgrounds, shown, persons = pictures(TROUSERS, exposure)
    settings = with_shadows_in([shown] * 3, room(), backgrounds, SETTINGS)
    assert TROUSERS < settings.shadow_darkest <= SHADE
    assert replace(settings, shadow_darkest=SETTINGS.shadow_darkest) == SETTINGS
    assert iou(backgrounds, shown, persons, settings) > 0.85
    assert iou(backgrounds, shown, persons, SETTINGS) < 0.5


def test_shadows_of_a_hard_light_are_shadows() -> None:
    backgrounds, shown, persons = pictures(1.8, shade=0.38)
    settings = with_shadows_in([shown] * 3, room(), backgrounds, SETTINGS)
    assert settings.shadow_darkest <= 0.38
    assert iou(backgrounds, shown, persons, settings) > 0.85
    assert iou(backgrounds, shown, persons, SETTINGS) < 0.75


def all_in_shade(picture: np.ndarray) -> ForegroundMask:
    nobody = np.zeros(picture.shape[:2], dtype=np.bool_)
    return ForegroundMask(nobody, ~nobody, nobody, 0.0, 1.0, is_usable=True, box=(0, 199, 0, 159))


def test_cameras_that_show_nothing_have_no_say() -> None:
    backgrounds, shown, _ = pictures(TROUSERS)
    whole = [np.full_like(picture, 250) for picture in shown]
    nothing = np.zeros((0, 0, 3), np.uint8)
    settings = with_shadows_in([[*shown[:3], whole[3], nothing]] * 3, room(), backgrounds, SETTINGS)
    assert TROUSERS < settings.shadow_darkest <= SHADE
    assert with_shadows_in([[nothing] * 5], room(), backgrounds, SETTINGS) == SETTINGS
    shaded = [np.clip(b.mean * 0.6, 0, 255).astype(np.uint8) for b in backgrounds]
    with mock.patch.object(Segmenter, "segment", lambda _, picture: all_in_shade(picture)):
        assert with_shadows_in([shaded], room(), backgrounds, SETTINGS) == SETTINGS


def test_settings_stay_where_nobody_wears_the_floors_colour_and_with_tests_of_others() -> None:
    backgrounds, shown, _ = pictures(1.8)
    assert with_shadows_in([shown] * 3, room(), backgrounds, SETTINGS) == SETTINGS
    backgrounds, shown, _ = pictures(TROUSERS)
    mog2 = replace(SETTINGS, method="mog2")
    assert with_shadows_in([shown] * 3, room(), backgrounds, mog2) == mog2
