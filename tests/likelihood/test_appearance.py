"""Colours of the body: zones, what is learnt of them, and what they say of a pose."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from flesh_voxels import Flesh
from painted_body import rays_at

from mocap.body import cones_of, load_body_model, neutral_state, scale_body
from mocap.body.flesh import cone_distances
from mocap.likelihood.colours import (
    Appearance,
    ColourProblem,
    PixelRays,
    colour_bins_of_pixels,
    new_appearance,
)
from mocap.likelihood.colours import _kernels as kernels
from mocap.likelihood.colours.appearance import N_COLOURS, body_zones

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


def cones_seen(flesh: Flesh, state: np.ndarray, rays: PixelRays) -> np.ndarray:
    """The cone that every ray enters first, -1 for none: found by marching along the rays in steps of 4 mm."""
    start, end = cones_of(flesh.body, state)
    depth = np.arange(1.5, 4.5, 0.004)
    seen = np.full(len(rays), -1)
    for i in range(len(rays)):
        along = rays.origins[rays.camera[i]] + depth[:, None] * rays.directions[i]
        distance = cone_distances(along, start, end, flesh.body.cones.radii, True)
        entered = np.flatnonzero((distance <= 0).any(axis=1))
        if len(entered):
            seen[i] = distance[entered[0]].argmin()
    return seen


def dressed(flesh: Flesh, state: np.ndarray, appearance: Appearance | None = None) -> ColourProblem:
    """What cameras see of the body: skin below the elbow and above the neck, a shirt, trousers."""
    rays = rays_at(flesh, state, seed=3)
    seen = cones_seen(flesh, state, rays)
    rays = rays.taken(seen >= 0)
    parts = flesh.body.layout.parts
    names = [parts[p] for p in flesh.body.cones.part[seen[seen >= 0]]]
    rgb = np.array(
        [
            SKIN
            if "forearm" in name or name == "head"
            else TROUSERS
            if "thigh" in name or "shank" in name
            else SHIRT
            for name in names
        ],
        dtype=np.uint8,
    )
    known = new_appearance(flesh.body) if appearance is None else appearance
    return ColourProblem(flesh.body, replace(rays, rgb=rgb), known)


def all_parts(flesh: Flesh) -> np.ndarray:
    return np.ones(flesh.body.layout.n_parts, dtype=np.bool_)


def moved_arm(flesh: Flesh, state: np.ndarray) -> np.ndarray:
    moved = state.copy()
    moved[flesh.body.layout.names.index("right_shoulder_x")] -= 1.2
    return moved


def test_bins_tell_clothes_from_skin_and_stay_in_range() -> None:
    rng = np.random.default_rng(0)
    rgb = rng.integers(0, 256, (500, 3)).astype(np.uint8)
    bins = colour_bins_of_pixels(rgb)
    assert bins.shape == (500,)
    assert bins.min() >= 0
    assert bins.max() < N_COLOURS
    apart = colour_bins_of_pixels(np.array([SHIRT, TROUSERS, SKIN], dtype=np.uint8))
    assert len(set(apart.tolist())) == 3
    assert len(colour_bins_of_pixels(np.zeros((0, 3), dtype=np.uint8))) == 0


@pytest.mark.parametrize("name", ["anthropometric", "girdle", "thesis", "whole"])
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


def test_a_limb_before_the_trunk_teaches_nothing(coarse_flesh: Flesh, standing: np.ndarray) -> None:
    """It may be a mistake: only what is seen against the background counts, and the trunk."""
    names = coarse_flesh.body.layout.names
    before = standing.copy()
    for name, value in (("right_shoulder_x", 0.9), ("right_shoulder_z", 1.2), ("right_elbow_z", 1.7)):
        before[names.index(name)] = value
    colours = dressed(coarse_flesh, standing)  # the arm is elsewhere in truth
    wrong = colours.learnt(before, all_parts(coarse_flesh))
    right = colours.learnt(standing, all_parts(coarse_flesh))
    zones, cones = colours.appearance.zones, coarse_flesh.body.cones
    forearm = np.flatnonzero(cones.part == coarse_flesh.body.layout.parts.index("right_forearm"))
    own = np.unique(np.concatenate([np.arange(zones.first[k], zones.first[k] + zones.n[k]) for k in forearm]))
    shirt = colour_bins_of_pixels(np.array([SHIRT], dtype=np.uint8))[0]
    assert right.counts[own].sum() > 20
    assert wrong.counts[own, shirt].sum() <= 0.05 * right.counts[own].sum()


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
    columns = layout.columns_of(limb)
    particles = np.tile(standing, (37, 1))
    rng = np.random.default_rng(1)
    particles[:, columns] = rng.uniform(layout.lower[columns], layout.upper[columns], (37, len(columns)))
    expected = colours.log_ratio(particles) - colours.log_ratio(standing[None])
    np.testing.assert_allclose(colours.limb_log_ratio(standing, limb)(particles), expected, atol=1e-5)


def test_kernels_agree_with_their_python(
    coarse_flesh: Flesh, standing: np.ndarray, monkeypatch: pytest.MonkeyPatch
) -> None:
    appearance = dressed(coarse_flesh, standing).learnt(standing, all_parts(coarse_flesh))
    whole = dressed(coarse_flesh, standing, appearance)
    colours = replace(whole, rays=whole.rays.every(8))
    particles = np.stack([standing, moved_arm(coarse_flesh, standing)])
    limb = [
        coarse_flesh.body.layout.parts.index("right_upper_arm"),
        coarse_flesh.body.layout.parts.index("right_forearm"),
    ]
    compiled = colours.log_ratio(particles), colours.limb_log_ratio(standing, limb)(particles)
    module = "mocap.likelihood.colours.appearance."
    plain = kernels.see_cones.py_func
    monkeypatch.setattr(kernels, "see_cones", plain)
    monkeypatch.setattr(module + "see_cones", plain)
    monkeypatch.setattr(module + "limb_values", kernels.limb_values.py_func)
    slow = colours.log_ratio(particles), colours.limb_log_ratio(standing, limb)(particles)
    for a, b in zip(compiled, slow, strict=True):
        np.testing.assert_allclose(a, b, atol=1e-9)


def test_rays_see_the_cone_that_they_enter_first(coarse_flesh: Flesh, standing: np.ndarray) -> None:
    """Against marching along the rays; caps and oblique cones are entered a little deeper than computed."""
    rays = rays_at(coarse_flesh, standing, seed=3)
    seen = cones_seen(coarse_flesh, standing, rays)
    colours = ColourProblem(coarse_flesh.body, rays, new_appearance(coarse_flesh.body))
    found = colours._seen(rays, cones_of(coarse_flesh.body, standing))
    zone, depth, miss = found.zone, found.depth, found.miss
    zones, cones = colours.appearance.zones, coarse_flesh.body.cones
    hit = seen >= 0
    assert 0.5 < hit.mean() < 1.0
    assert ((miss <= 0) == hit).mean() > 0.99
    both = hit & (miss <= 0)
    assert np.isfinite(depth[both]).all()
    offset = zone[both] - zones.first[seen[both]]
    same_zone = (offset >= 0) & (offset < zones.n[seen[both]])
    assert same_zone.mean() > 0.9
    body_part = np.array([cones.part[np.flatnonzero(zones.first <= z)[-1]] for z in zone[both]])
    assert len(np.unique(body_part)) > 3
    assert (zone[~hit & (miss > 0) & (miss >= 0.05)] == -1).all()


def test_an_arm_before_the_trunk_is_seen(coarse_flesh: Flesh, standing: np.ndarray) -> None:
    """Where neither hull nor outline show an arm, its colour does."""
    names = coarse_flesh.body.layout.names
    before = standing.copy()
    for name, value in (("right_shoulder_x", 0.9), ("right_shoulder_z", 1.2), ("right_elbow_z", 1.7)):
        before[names.index(name)] = value
    appearance = dressed(coarse_flesh, standing).learnt(standing, all_parts(coarse_flesh))
    colours = dressed(coarse_flesh, before, appearance)
    hidden = before.copy()
    hidden[names.index("right_shoulder_z")] = 0.0
    hidden[names.index("right_elbow_z")] = 0.1
    good, bad = colours.log_ratio(np.stack([before, hidden]))
    assert good > bad + 0.02


def test_no_visible_pixel_says_nothing(coarse_flesh: Flesh, standing: np.ndarray) -> None:
    none = PixelRays(
        np.zeros((4, 3)), np.zeros(0, dtype=np.int64), np.zeros((0, 3)), np.zeros((0, 3), dtype=np.uint8)
    )
    empty = ColourProblem(coarse_flesh.body, none, new_appearance(coarse_flesh.body))
    assert empty.log_ratio(standing[None]).tolist() == [0.0]
    assert empty.limb_log_ratio(standing, [1])(standing[None]).tolist() == [0.0]
    assert empty.learnt(standing, all_parts(coarse_flesh)).counts.sum() == 0


def test_colours_that_were_never_seen_are_weighed_as_all_others(
    coarse_flesh: Flesh, standing: np.ndarray
) -> None:
    """Against the formula over all colours at once."""
    known = dressed(coarse_flesh, standing).learnt(standing, all_parts(coarse_flesh))
    assert 0 < np.count_nonzero(known.counts.sum(axis=0)) < 50
    body = known.counts.sum(axis=0, dtype=np.float64) + 1e-3
    body /= body.sum()
    of_zone = known.counts.sum(axis=1, keepdims=True, dtype=np.float64)
    zone = (known.counts + 100.0 * body) / (of_zone + 100.0)
    np.testing.assert_allclose(known.log_ratio, np.log(0.95 * zone / body + 0.05), atol=1e-6)
