"""The conditions of the marker filter: each is one thing, and worlds are what they say."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from test_markers_table import clip, known_person

from eval.markers_conditions import CONDITIONS, PERFECT, SOURCE, joint_markers, magnified, with_kept
from eval.markers_table_6_3 import TABLE_DETECTOR, TABLE_FILTER, make_clip, observations, run_cell
from mocap.body import landmarks_of, load_body_model, neutral_state, scale_body
from mocap.body.markers import marker_positions


def test_joint_markers_are_the_landmarks() -> None:
    body = scale_body(load_body_model("anthropometric"), 1.7)
    states = neutral_state(body) + 0.1 * np.random.default_rng(0).normal(size=(3, body.layout.n_columns))
    np.testing.assert_allclose(
        marker_positions(body, joint_markers(body), states), landmarks_of(body, states), atol=1e-12
    )


def test_magnified_pictures_show_the_same_rays() -> None:
    one = clip()
    two = magnified(one, 2.0)
    for a, b, uv in zip(one.views.rig, two.views.rig, two.uv, strict=True):
        assert b.size == (2 * a.size[0], 2 * a.size[1])
        seen = one.landmarks[0]
        np.testing.assert_allclose(b.project(seen)[0], 2.0 * a.project(seen)[0], atol=1e-9)
        assert uv.shape == one.uv[0].shape
    count = sum(len(o.uv) for o in observations(two, PERFECT, 0))
    assert count == sum(len(o.uv) for o in observations(one, PERFECT, 0))


def test_a_condition_changes_what_its_name_says() -> None:
    table = CONDITIONS["table"]
    assert (table.detector, table.filter, table.gate_px) == (TABLE_DETECTOR, TABLE_FILTER, 20.0)
    assert replace(SOURCE, in_joints=False, knows_body=False) == table
    for name, one in CONDITIONS.items():
        base = table if name.startswith("table") else SOURCE
        changed = [f for f in vars(one) if getattr(one, f) != getattr(base, f)]
        assert len(changed) == name.count(","), name


def test_settings_reach_the_filter() -> None:
    quick = replace(TABLE_FILTER, n_particles=40)
    plain, narrow = (
        run_cell(clip(), known_person(), TABLE_DETECTOR, quick, 0, settings)
        for settings in ((), ("markers.gate_px=5.0", "pose.noise_scale=0.25"))
    )
    assert plain["mean_error_mm"] != narrow["mean_error_mm"]


def test_a_finer_film_shows_the_same_motion_and_what_hides_nothing_is_seen_everywhere() -> None:
    plain = make_clip("walk", 2, in_joints=True)
    fine = make_clip("walk", 2, in_joints=True, hides=False, times_fps=2)
    assert (fine.fps, len(fine.landmarks)) == (2 * plain.fps, 4)
    np.testing.assert_allclose(fine.landmarks[::2], plain.landmarks, atol=1e-3)
    assert not all(seen.all() for seen in plain.visible)
    assert all(seen.all() for seen in fine.visible)


def test_conditions_that_are_not_run_stay_as_they_are() -> None:
    """A later call replaces its own lines, keeps the others, and forgets conditions that are no more."""
    before = [
        {"condition": name, "action": action, "seed": "0", "mmta_percent": "1"}
        for action in ("jog", "walk")
        for name in ("source", "table", "of yesterday")
    ]
    new = [{"condition": "source", "action": "jog", "seed": 0, "mmta_percent": 2}]
    rows = with_kept(new, before)
    assert [(r["action"], r["condition"], str(r["mmta_percent"])) for r in rows] == [
        ("walk", "table", "1"),
        ("walk", "source", "1"),
        ("jog", "table", "1"),
        ("jog", "source", "2"),
    ]
