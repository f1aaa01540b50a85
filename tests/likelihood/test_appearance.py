"""Colours of the body: zones, what is learnt of them, and what they say of a pose."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from flesh_voxels import Flesh

from mocap.body import load_body_model, neutral_state, scale_body
from mocap.likelihood import Appearance, ColourProblem, colour_bins_of_voxels, new_appearance
from mocap.likelihood import _appearance_kernels as kernels
from mocap.likelihood.appearance import N_COLOURS, body_zones

SHIRT, TROUSERS, SKIN = (200, 120, 30), (40, 45, 70), (220, 170, 150)


@pytest.fixture
def standing(coarse_flesh: Flesh) -> np.ndarray:
    """Arms away from the trunk, so that every part has a surface of its own."""
    state = neutral_state(coarse_flesh.body)
    names = coarse_flesh.body.layout.names
    state[2] = 1.0
    state[names.index("right_shoulder_x")] = 0.6
    state[names.index("left_shoulder_x")] = -0.6
    return state


def dressed(flesh: Flesh, state: np.ndarray, appearance: Appearance | None = None) -> ColourProblem:
    """The surface of the body's own hull: skin below the elbow and above the neck, a shirt, trousers."""
    hull = flesh.hull(state)
    surface = hull.voxels[hull.is_surface]
    rgb = np.empty((len(surface), 3), dtype=np.uint8)
    rgb[:] = SHIRT
    parts = flesh.body.layout.parts
    for k, name in enumerate(parts):
        colour = (
            SKIN
            if "forearm" in name or name == "head"
            else TROUSERS
            if "thigh" in name or "shank" in name
            else None
        )
        if colour is not None:
            own = flesh.hull(state, without=tuple(p for p in range(len(parts)) if p != k)).voxels
            rgb[np.isin(surface, own)] = colour
    known = new_appearance(flesh.body) if appearance is None else appearance
    return ColourProblem(flesh.body, flesh.grid.centers(surface), colour_bins_of_voxels(rgb), known)


def all_parts(flesh: Flesh) -> np.ndarray:
    return np.ones(flesh.body.layout.n_parts, dtype=np.bool_)


def moved_arm(flesh: Flesh, state: np.ndarray) -> np.ndarray:
    moved = state.copy()
    moved[flesh.body.layout.names.index("right_shoulder_x")] -= 1.2
    return moved


def test_bins_tell_clothes_from_skin_and_stay_in_range() -> None:
    rng = np.random.default_rng(0)
    rgb = rng.integers(0, 256, (500, 3)).astype(np.uint8)
    bins = colour_bins_of_voxels(rgb)
    assert bins.shape == (500,)
    assert bins.min() >= 0
    assert bins.max() < N_COLOURS
    apart = colour_bins_of_voxels(np.array([SHIRT, TROUSERS, SKIN], dtype=np.uint8))
    assert len(set(apart.tolist())) == 3
    assert len(colour_bins_of_voxels(np.zeros((0, 3), dtype=np.uint8))) == 0


@pytest.mark.parametrize("name", ["anthropometric", "thesis"])
def test_mirrored_cones_share_their_zones(name: str) -> None:
    body = scale_body(load_body_model(name), 1.7)
    zones = body_zones(body)
    assert (zones.first + zones.n).max() == zones.n_zones
    by_part = {p: set(zones.first[body.cones.part == k].tolist()) for k, p in enumerate(body.layout.parts)}
    for part, own in by_part.items():
        if part.startswith("left_"):
            assert own == by_part[part.replace("left_", "right_")]
    assert not by_part["left_thigh"] & by_part["left_shank"]


def test_nothing_is_known_at_first(coarse_flesh: Flesh, standing: np.ndarray) -> None:
    colours = dressed(coarse_flesh, standing)
    assert np.abs(colours.appearance.log_ratio).max() < 1e-6
    assert np.abs(colours.log_ratio(standing[None])).max() < 1e-6


def test_what_was_learnt_prefers_the_pose_it_was_learnt_from(
    coarse_flesh: Flesh, standing: np.ndarray
) -> None:
    appearance = dressed(coarse_flesh, standing).learnt(standing, all_parts(coarse_flesh))
    colours = dressed(coarse_flesh, standing, appearance)
    good, bad = colours.log_ratio(np.stack([standing, moved_arm(coarse_flesh, standing)]))
    assert good > 0
    assert good > bad + 0.02


def test_parts_that_are_not_trusted_teach_nothing(coarse_flesh: Flesh, standing: np.ndarray) -> None:
    colours = dressed(coarse_flesh, standing)
    arms = [k for k, p in enumerate(coarse_flesh.body.layout.parts) if "arm" in p]
    trusted = all_parts(coarse_flesh)
    trusted[arms] = False
    learnt = colours.learnt(standing, trusted)
    zones = colours.appearance.zones
    of_arms = np.unique(zones.first[np.isin(coarse_flesh.body.cones.part, arms)])
    assert learnt.counts[of_arms].sum() == 0
    assert learnt.counts.sum() > 0
    assert colours.appearance.counts.sum() == 0, "the old appearance stays as it was"


def test_a_mirrored_body_looks_the_same(coarse_flesh: Flesh, standing: np.ndarray) -> None:
    """Zones are shared by both sides: what the right arm teaches holds for the left."""
    appearance = dressed(coarse_flesh, standing).learnt(standing, all_parts(coarse_flesh))
    colours = dressed(coarse_flesh, standing, appearance)
    names = coarse_flesh.body.layout.names
    right, left = standing.copy(), standing.copy()
    right[names.index("right_shoulder_x")] -= 1.2
    left[names.index("left_shoulder_x")] += 1.2
    values = colours.log_ratio(np.stack([right, left]))
    assert values[0] == pytest.approx(values[1], abs=0.01)


def test_limb_by_limb_is_the_same_as_the_whole(coarse_flesh: Flesh, standing: np.ndarray) -> None:
    appearance = dressed(coarse_flesh, standing).learnt(standing, all_parts(coarse_flesh))
    colours = dressed(coarse_flesh, standing, appearance)
    layout = coarse_flesh.body.layout
    limb = [k for k, p in enumerate(layout.parts) if p in ("right_upper_arm", "right_forearm")]
    columns = np.flatnonzero(np.isin(layout.part_of_column, limb))
    particles = np.tile(standing, (37, 1))
    rng = np.random.default_rng(1)
    particles[:, columns] = rng.uniform(layout.lower[columns], layout.upper[columns], (37, len(columns)))
    expected = colours.log_ratio(particles) - colours.log_ratio(standing[None])
    np.testing.assert_allclose(colours.limb_log_ratio(standing, particles, limb), expected, atol=1e-5)


def test_kernels_agree_with_their_python(
    coarse_flesh: Flesh, standing: np.ndarray, monkeypatch: pytest.MonkeyPatch
) -> None:
    appearance = dressed(coarse_flesh, standing).learnt(standing, all_parts(coarse_flesh))
    whole = dressed(coarse_flesh, standing, appearance)
    colours = replace(whole, points=whole.points[::40], bins=whole.bins[::40])
    particles = np.stack([standing, moved_arm(coarse_flesh, standing)])
    limb = [
        coarse_flesh.body.layout.parts.index("right_upper_arm"),
        coarse_flesh.body.layout.parts.index("right_forearm"),
    ]
    compiled = colours.log_ratio(particles), colours.limb_log_ratio(standing, particles, limb)
    module = "mocap.likelihood.appearance."
    monkeypatch.setattr(kernels, "nearest_cone", kernels.nearest_cone.py_func)
    monkeypatch.setattr(module + "zones_of_points", kernels.zones_of_points.py_func)
    monkeypatch.setattr(module + "limb_values", kernels.limb_values.py_func)
    slow = colours.log_ratio(particles), colours.limb_log_ratio(standing, particles, limb)
    for a, b in zip(compiled, slow, strict=True):
        np.testing.assert_allclose(a, b, atol=1e-9)


def test_no_visible_voxel_says_nothing(coarse_flesh: Flesh, standing: np.ndarray) -> None:
    empty = ColourProblem(
        coarse_flesh.body, np.zeros((0, 3)), np.zeros(0, dtype=np.int64), new_appearance(coarse_flesh.body)
    )
    assert empty.log_ratio(standing[None]).tolist() == [0.0]
    assert empty.limb_log_ratio(standing, standing[None], [1]).tolist() == [0.0]
    assert empty.learnt(standing, all_parts(coarse_flesh)).counts.sum() == 0
