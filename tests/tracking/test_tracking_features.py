"""Blob features in closed form, and the person verdict on the shapes it must tell apart."""

from dataclasses import fields

import numpy as np
import pytest

from mocap.tracking import (
    PERSON_TREE,
    BlobFeatures,
    Split,
    blob_features,
    is_person,
    person_tree,
    read_person_tree,
)


def box(lower, upper, side):
    """Voxel centres (N, 3) that fill an axis-parallel box."""
    axes = [np.arange(a + side / 2, b, side) for a, b in zip(lower, upper, strict=True)]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)


def features(weight=80.0, top=1.75, height=1.75, box_max=0.7, box_min=0.4):
    return BlobFeatures(weight, top - height / 2, top, height, box_max, box_min)


@pytest.mark.parametrize("side", [0.02, 0.05, 0.1])
def test_features_of_a_box_are_exact_at_every_voxel_size(side):
    f = blob_features(box((1.0, -0.4, 0.2), (1.4, 0.2, 1.8), side), side)
    assert f.weight_kg == pytest.approx(0.4 * 0.6 * 1.6 * 1000 * 1.1)
    assert f.centroid_z_m == pytest.approx(1.0)
    assert f.top_m == pytest.approx(1.8)
    assert f.bottom_m == pytest.approx(0.2)
    assert f.height_m == pytest.approx(1.6)
    assert (f.box_max_m, f.box_min_m) == (pytest.approx(0.6), pytest.approx(0.4))


def test_empty_blob_is_a_value_and_no_person():
    f = blob_features(np.zeros((0, 3)), 0.02)
    assert f.weight_kg == 0.0
    assert np.isnan(f.top_m)
    assert not is_person(f)


def test_wrong_arguments_are_named():
    with pytest.raises(ValueError, match="centers"):
        blob_features(np.zeros((4, 2)), 0.02)
    with pytest.raises(ValueError, match="voxel_size_m"):
        blob_features(np.zeros((4, 3)), 0.0)


PERSONS = {
    "standing man": features(),
    "arms out": features(95.0, 1.85, 1.85, 1.95, 0.5),
    "T-pose of a tall man, fat hull": features(140.0, 2.0, 2.0, 2.3, 0.6),
    "dancer, 99 litres, 1.64 m": features(99 * 1.1, 1.64, 1.64, 1.5, 0.9),
    "dancer, one faulty view": features(125 * 1.1, 1.66, 1.66, 1.6, 1.0),
    "sitting man + chair, 210 litres": features(210 * 1.1, 1.39, 1.39, 0.95, 0.8),
    "the same with tolerant carving": features(380 * 1.1, 1.5, 1.5, 1.6, 1.4),
    "crouching woman": features(60.0, 0.75, 0.75, 0.8, 0.5),
    "broken hull, 43 litres": features(43 * 1.1, 1.7, 1.2, 0.5, 0.3),
    "seated behind a table": features(45.0, 1.3, 0.55, 0.6, 0.35),
    "reaching up": features(75.0, 2.25, 2.25, 0.6, 0.35),
    "child": features(22.0, 1.1, 1.1, 0.4, 0.22),
}
OTHERS = {
    "speck": features(0.1, 1.0, 0.06, 0.06, 0.06),
    "ghost": features(8.0, 1.4, 0.7, 0.3, 0.3),
    "ghost between two persons": features(31.0, 1.5, 1.02, 0.56, 0.48),
    "shadow on the floor": features(40.0, 0.1, 0.1, 1.8, 0.6),
    "bag": features(25.0, 0.45, 0.45, 0.5, 0.3),
    "everything is foreground": features(20000.0, 2.2, 2.2, 5.0, 4.0),
    "curtain": features(60.0, 2.2, 2.2, 2.0, 0.06),
    "pole": features(30.0, 2.2, 2.2, 0.12, 0.12),
    "row of chairs": features(150.0, 0.95, 0.95, 3.2, 0.6),
    "floating under the ceiling": features(30.0, 2.2, 0.3, 1.0, 1.0),
}


@pytest.mark.parametrize("name", PERSONS)
def test_persons_are_accepted(name):
    assert is_person(PERSONS[name])


@pytest.mark.parametrize("name", OTHERS)
def test_other_things_are_rejected(name):
    assert not is_person(OTHERS[name])


def test_tree_is_data_over_named_features():
    names = {f.name for f in fields(BlobFeatures)} | {"bottom_m"}

    def check(node):
        if isinstance(node, Split):
            assert node.feature in names
            check(node.below)
            check(node.above)

    check(PERSON_TREE)
    light_is_person = Split("weight_kg", 10.0, True, False)
    assert is_person(features(weight=9.9), light_is_person)
    assert not is_person(features(weight=10.0), light_is_person)


FILE = """
[[node]]
feature = "weight_kg"
threshold = 12
below = false
above = 2

[[node]]
feature = "bottom_m"
threshold = 0.4
below = true
above = false

[[node]]
feature = "top_m"
threshold = 0.8
below = false
above = 1
"""


def test_tree_is_read_from_a_file(tmp_path):
    path = tmp_path / "tree.toml"
    path.write_text(FILE.replace("above = 1\n", "above = true\n"))
    assert read_person_tree(path) == Split("weight_kg", 12.0, False, Split("top_m", 0.8, False, True))
    assert person_tree("wide") is PERSON_TREE


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("above = 1\n", "above = 0\n", "node 2 leads to 0"),
        ("above = 1\n", "above = 7\n", "node 2 leads to 7"),
        ("above = 1\n", "above = 'yes'\n", "node 2 leads to 'yes'"),
        ('"top_m"', '"hat_m"', "feature is 'hat_m'"),
        ("threshold = 0.8", "threshold = 'high'", "threshold is 'high'"),
        ("threshold = 0.8", "threshold = nan", "threshold is nan"),
    ],
)
def test_bad_tree_files_are_named(tmp_path, old, new, message):
    path = tmp_path / "tree.toml"
    path.write_text(FILE.replace(old, new))
    with pytest.raises(ValueError, match=message):
        read_person_tree(path)
    path.write_text("")
    with pytest.raises(ValueError, match="no node"):
        read_person_tree(path)
    with pytest.raises(ValueError, match="wide, trained"):
        person_tree("narrow")


def test_trained_tree_comes_with_the_package():
    tree = person_tree("trained")
    assert isinstance(tree, Split)
    assert is_person(features(), tree)
    assert not is_person(OTHERS["speck"], tree)
