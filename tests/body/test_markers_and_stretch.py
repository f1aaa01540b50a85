"""Marker sets as data, and bodies with other proportions."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from mocap.body import landmarks_of, load_body_model, neutral_state, scale_body
from mocap.body.markers import load_marker_set, marker_positions, marker_sets, place_markers
from mocap.body.stretch import lengths_of, segment_groups, standing_height, stretch_body, with_lengths
from mocap.data import LANDMARKS
from mocap.errors import MocapError

HEIGHT_M = 1.74


def body_of(name: str = "anthropometric"):  # type: ignore[no-untyped-def]
    return scale_body(load_body_model(name), HEIGHT_M)


@pytest.mark.parametrize("model", ["anthropometric", "girdle", "thesis", "whole"])
def test_the_set_of_twenty_fits_the_bodies_and_is_a_mirror_image(model: str) -> None:
    assert "markers_20" in marker_sets()
    body = body_of(model)
    markers = place_markers(load_marker_set("markers_20"), body)
    assert len(markers) == 20
    at = dict(zip(markers.names, marker_positions(body, markers, neutral_state(body)[None])[0], strict=True))
    for name, place in at.items():
        if name.startswith("left_"):
            np.testing.assert_allclose(at[name.replace("left_", "right_")], place * [1, -1, 1], atol=1e-9)
    assert at["head"][2] == max(p[2] for p in at.values())


def test_offsets_grow_with_the_person() -> None:
    small, tall = (scale_body(load_body_model("anthropometric"), h) for h in (1.5, 1.8))
    found = load_marker_set("markers_20")
    np.testing.assert_allclose(
        place_markers(found, tall).offset, place_markers(found, small).offset * 1.8 / 1.5, atol=1e-12
    )


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("name = 'x'\nmarker = []\n", "there is no marker"),
        ("name = 'x'\n[[marker]]\nname = 'a'\njoint = 'root'\npart = 'torso'\n", "marker.0.offset"),
        (
            "name = 'x'\n[[marker]]\nname = 'a'\njoint = 'root'\npart = 'torso'\noffset = [0, 0, 0]\nslack = 1\n",
            "marker.0.slack",
        ),
        (
            "name = 'x'\n"
            + "[[marker]]\nname = 'a'\njoint = 'root'\npart = 'torso'\noffset = [0, 0, 0]\n" * 2,
            "marker a is defined twice",
        ),
        ("name = [", "not a TOML file"),
    ],
)
def test_bad_marker_sets_are_refused(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "set.toml"
    path.write_text(text)
    with pytest.raises(MocapError, match=message.replace(".", r"\.")) as caught:
        load_marker_set(path)
    assert caught.value.remedy


def test_a_set_that_is_not_there_and_one_of_another_body(tmp_path: Path) -> None:
    with pytest.raises(MocapError, match="the marker set cannot be read"):
        load_marker_set(tmp_path / "none.toml")
    path = tmp_path / "set.toml"
    path.write_text(
        "name = 'x'\n[[marker]]\nname = 'a'\njoint = 'tail'\npart = 'torso'\noffset = [0, 0, 0]\n"
    )
    with pytest.raises(MocapError, match="joint 'tail'"):
        place_markers(load_marker_set(path), body_of())


def test_a_uniform_stretch_is_another_height() -> None:
    body = body_of()
    stretched = stretch_body(body, np.full((len(body.joints), 3), 1.1))
    other = scale_body(load_body_model("anthropometric"), 1.1 * HEIGHT_M)
    for name, value in lengths_of(other).items():
        np.testing.assert_allclose(lengths_of(stretched)[name], value, atol=1e-12)
    assert stretched.height_m == pytest.approx(other.height_m)


def test_stretching_one_segment_moves_what_hangs_on_it_and_nothing_else() -> None:
    body = body_of()
    j = body.joints.index("left_hip")
    stretch = np.ones((len(body.joints), 3))
    stretch[j, 2] = 1.2
    longer = stretch_body(body, stretch)
    state = neutral_state(body)
    moved = landmarks_of(longer, state[None])[0] - landmarks_of(body, state[None])[0]
    thigh = np.linalg.norm(body.offset[body.joints.index("left_knee")])
    for k, name in enumerate(LANDMARKS):
        expected = [0, 0, -0.2 * thigh] if name in ("left_knee", "left_ankle") else [0, 0, 0]
        np.testing.assert_allclose(moved[k], expected, atol=1e-9)


def test_groups_are_pairs_of_sides() -> None:
    body = body_of()
    group = dict(zip(body.joints, segment_groups(body), strict=True))
    assert group["left_elbow"] == group["right_elbow"]
    assert group["left_elbow"] != group["left_shoulder"]


def test_lengths_survive_a_round_trip_and_are_checked() -> None:
    body = body_of()
    rng = np.random.default_rng(1)
    stretched = stretch_body(body, rng.uniform(0.9, 1.1, (len(body.joints), 3)))
    again = with_lengths(body, lengths_of(stretched))
    np.testing.assert_array_equal(again.offset, stretched.offset)
    np.testing.assert_array_equal(again.cones.radii, stretched.cones.radii)
    with pytest.raises(ValueError, match="lengths have shapes"):
        with_lengths(body, {**lengths_of(body), "offset_m": [[0.0, 0.0, 0.0]]})
    with pytest.raises(ValueError, match="stretch must be positive"):
        stretch_body(body, np.zeros((len(body.joints), 3)))


def test_standing_height_grows_with_the_height() -> None:
    body = body_of()
    assert standing_height(body) == pytest.approx(HEIGHT_M, abs=0.03)
