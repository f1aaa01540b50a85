"""The scalable bodies that come with the package, on the bodies that come with it, and bad files of others."""

from pathlib import Path

import pytest

from mocap.body import (
    hierarchy_presets,
    limb_presets,
    load_body_model,
    load_hierarchy,
    load_limbs,
    scale_body,
)
from mocap.data.hierarchy import depth_hierarchy, levels_on, limbs_on
from mocap.errors import MocapError

BODIES = ("anthropometric", "girdle", "thesis", "whole")


def test_presets_are_what_is_documented() -> None:
    assert hierarchy_presets() == ("model1", "model1_printed", "model2", "model2_printed")
    assert limb_presets() == ("limbs", "whole_limbs")


@pytest.mark.parametrize("body_name", BODIES)
@pytest.mark.parametrize("name", hierarchy_presets())
def test_subdivisions_have_the_printed_and_the_complete_numbers(body_name: str, name: str) -> None:
    """Reading guide 14: 6/16/24 as printed, 6/19/27 with the waist. Shoulder girdle, feet and hands rest."""
    layout = scale_body(load_body_model(body_name), 1.7).layout
    levels = levels_on(load_hierarchy(name), layout)
    assert levels.dimensions == ((6, 10, 8) if name.endswith("printed") else (6, 13, 8))
    assert [len(level.parts) for level in levels.levels] == [1, 10 if "model1" in name else 6, 10]
    left_out = {n for n, has in zip(layout.names, levels.levels[-1].has, strict=True) if not has}
    resting = {
        n
        for n in layout.names
        if any(j in n for j in ("clavicle", "ankle", "mtp", "wrist", "forearm", "thorax"))
    }
    assert left_out == resting | ({"waist_x", "waist_y", "waist_z"} if name.endswith("printed") else set())
    assert not levels.pinned.any(), "limbs of coarse models are straight"


def test_models_differ_in_the_parts_of_the_second_level_only() -> None:
    one, two = load_hierarchy("model1"), load_hierarchy("model2")
    assert [level.columns for level in one.levels] == [level.columns for level in two.levels]
    assert [level.parts for level in one.levels][::2] == [level.parts for level in two.levels][::2]
    assert not {"right_forearm", "left_shank"} & set(two.levels[1].parts)


def test_model_2_scores_what_the_depth_of_the_tree_says() -> None:
    layout = scale_body(load_body_model("thesis"), 1.7).layout
    depth = levels_on(depth_hierarchy(layout), layout)
    model = levels_on(load_hierarchy("model2"), layout)
    assert [level.parts for level in depth.levels] == [level.parts for level in model.levels]


@pytest.mark.parametrize("body_name", BODIES)
def test_limbs_fit_the_bodies(body_name: str) -> None:
    layout = scale_body(load_body_model(body_name), 1.7).layout
    legs = {limb.name: limb for limb in limbs_on(load_limbs("limbs"), layout)}
    assert set(legs) == {"right_arm", "left_arm", "right_leg", "left_leg"}
    assert [len(limb.parts) for limb in legs.values()] == [1, 1, 2, 2]
    foot = ["left_ankle_y", "left_ankle_x", "left_mtp_y"] if body_name == "whole" else []
    assert [layout.names[c] for c in legs["left_leg"].columns[1]] == ["left_knee_y", *foot]
    assert all(len(limb.parts) == 1 for limb in limbs_on(load_limbs("whole_limbs"), layout))


def test_a_file_of_ones_own(tmp_path: Path) -> None:
    path = tmp_path / "snake.toml"
    path.write_text(
        'name = "snake"\npinned = { bend = 0.5 }\n[[level]]\nname = "H1"\ncolumns = ["root_x"]\nparts = ["head"]\n'
    )
    snake = load_hierarchy(path)
    assert snake.name == "snake"
    assert snake.levels[0].columns == ("root_x",)
    assert snake.pinned == {"bend": 0.5}


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("name = ", "not a TOML file"),
        ('name = "x"\nlevel = []\n', "scalable body: level"),
        ('name = "x"\ncolour = 3\n[[level]]\nname = "a"\ncolumns = ["a"]\nparts = ["b"]\n', "colour"),
        ('name = "x"\n[[level]]\nname = "a"\ncolumns = []\nparts = ["b"]\n', r"level\.0\.columns"),
        (
            'name = "x"\npinned = { a = nan }\n[[level]]\nname = "a"\ncolumns = ["a"]\nparts = ["b"]\n',
            "pinned",
        ),
    ],
)
def test_a_bad_file_is_named_with_its_key(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "bad.toml"
    path.write_text(text)
    with pytest.raises(MocapError, match=message) as caught:
        load_hierarchy(path)
    assert caught.value.path == path


def test_a_missing_file_names_the_presets() -> None:
    with pytest.raises(MocapError) as caught:
        load_limbs("nothing.toml")
    assert "whole_limbs" in str(caught.value.remedy)
    with pytest.raises(MocapError, match="limb"):
        load_limbs("model1.toml") if Path("model1.toml").exists() else load_hierarchy("limbs")
