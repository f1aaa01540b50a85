"""Worlds of the tracking comparison: each differs from the table's in what its name says."""

from __future__ import annotations

import numpy as np
import pytest

from eval import tracking_page
from eval.tracking import walkers
from eval.tracking.hulls import HullClip
from eval.tracking.walkers import CLOTHES, Dirt, carved_clip, crossing_clip, ellipsoid
from eval.tracking_causes import slowed, surface_lines


def small() -> HullClip:
    whole = crossing_clip(0.5, voxel_m=0.1)
    kept = whole.truth.frame < 3
    truth = type(whole.truth)(*(getattr(whole.truth, f)[kept] for f in ("frame", "person", "time_s", "xyz")))
    return HullClip(whole.name, whole.fps, whole.frames[:3], whole.hulls[:3], truth, None)


def test_a_slow_film_shows_every_frame_again() -> None:
    clip = small()
    slow = slowed(clip, 4)
    assert (slow.fps, len(slow.hulls)) == (4 * clip.fps, 12)
    for frame in range(12):
        assert slow.hulls[frame] is clip.hulls[frame // 4]
        np.testing.assert_array_equal(
            slow.truth.xyz[slow.truth.frame == frame], clip.truth.xyz[clip.truth.frame == frame // 4]
        )
    np.testing.assert_allclose(slow.truth.time_s, slow.truth.frame / slow.fps)


def test_two_persons_cross_and_wear_their_own_colours() -> None:
    clip = crossing_clip(0.3, voxel_m=0.1)
    first, last = (clip.truth.xyz[clip.truth.frame == f] for f in (0, clip.frames[-1]))
    assert np.all(np.sign(first[:, 0]) == -np.sign(last[:, 0]))
    np.testing.assert_allclose(np.diff(first[:, 1]), -0.3)
    for k in range(2):
        hull = clip.hulls[0]
        near = np.linalg.norm(hull.grid.centers(hull.voxels)[:, :2] - first[k, :2], axis=1) < 0.25
        assert near.any()
        assert np.all(hull.rgb[near] == CLOTHES[k])


def test_carved_hulls_hold_the_persons_and_what_spoils_them(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(walkers, "_HALF_WAY_M", 0.3)
    clean, torn, trolley = (
        carved_clip(0.8, 0.1, dirt, 1) for dirt in (Dirt(), Dirt(is_torn=True), Dirt(has_trolley=True))
    )
    assert len(clean.hulls) == len(clean.frames) == 10
    for frame, hull in enumerate(clean.hulls):
        places = clean.truth.xyz[clean.truth.frame == frame]
        inner = np.union1d(*(ellipsoid(hull.grid, p, 0.8 * np.array(walkers._PERSON_SEMI_M)) for p in places))
        assert np.isin(inner, hull.voxels).all()
        missing = np.isin(inner, torn.hulls[frame].voxels, invert=True).mean()
        assert 0.0 <= missing < 0.9
        extra = np.setdiff1d(trolley.hulls[frame].voxels, hull.voxels)
        assert len(extra) > 0
    assert any(
        np.isin(h.voxels, t.voxels, invert=True).any() for h, t in zip(clean.hulls, torn.hulls, strict=True)
    )
    rgb = np.concatenate([h.rgb for h in trolley.hulls]).astype(int)
    grey = np.abs(rgb - walkers._GREY).max(axis=1) < 60
    assert 0.1 < grey.mean() < 0.9


def test_the_surface_needs_more_voxels_than_the_interior(monkeypatch: pytest.MonkeyPatch) -> None:
    """CF Figure 4.7: the surface is the more sensitive one, and all voxels give the centroid."""
    monkeypatch.setattr("eval.tracking_causes._N_DRAWS", 30)
    lines = surface_lines()
    for line in lines[:-1]:
        assert float(line["surface_mm"]) > float(line["interior_mm"]) > 0.0
    assert float(lines[-1]["surface_mm"]) < 0.01


def test_the_sections_are_made_of_the_committed_files() -> None:
    text = "\n".join([*tracking_page.causes(), *tracking_page.crossing(), *tracking_page.share_of_voxels()])
    for words in ("slow, 2 cm", "CF Figure 4.12", "CF Figure 4.7", "| SS-Color |"):
        assert words in text
