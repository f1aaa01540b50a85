"""Configuration and random generators by address."""

import dataclasses
import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from docs.make_configuration import words_of
from mocap.errors import MocapError
from mocap.pipeline.config import Config, PoseConfig, config_hash, load_config, presets
from mocap.rng import rng_for


@pytest.mark.parametrize("name", presets())
def test_every_preset_loads(name: str) -> None:
    assert isinstance(load_config(name), Config)


def test_presets_say_what_they_are_for() -> None:
    assert {"default", "realtime", "reference", "thesis_body"} <= set(presets())
    reference = load_config("reference").pose
    assert (reference.n_layers, reference.n_particles) == (6, 600)  # CF 6.7.2
    assert not reference.refine
    assert not reference.look_again
    assert load_config("thesis_body").body.model == "thesis"
    quick = load_config("realtime")
    assert load_config().pose.search_every_frames == "auto"
    assert load_config("best").pose.search_every_frames == 1
    assert quick.method.follow.rarely_frames == 3 > load_config().method.follow.rarely_frames
    less = (
        "pose.texture_weight=0",
        "pose.texture_every_frames=1",
        "output.formats=report",
        "segmentation.grey_outlines=false",
    )
    assert load_config("default", ("method.follow.rarely_frames=3", *less)) == quick  # and nothing else
    best, all_of_it = load_config("best"), ("pose.search_every_frames=1", "pose.texture_every_frames=1")
    assert load_config("default", all_of_it) == best


def test_table_6_2_is_the_default() -> None:
    likelihood = Config().likelihood
    assert likelihood.variance_out == likelihood.variance_double == 0.01
    assert likelihood.variance_empty == likelihood.variance_surface == 0.1


@pytest.mark.parametrize(
    ("setting", "section", "key", "value"),
    [
        ("pose.n_particles=80", "pose", "n_particles", 80),
        ("pose.filter=sir", "pose", "filter", "sir"),
        ('pose.filter="sir"', "pose", "filter", "sir"),
        (" pose.refine = false ", "pose", "refine", False),
        ("volume.n_faulty_views=auto", "volume", "n_faulty_views", "auto"),
        ("volume.n_faulty_views=2", "volume", "n_faulty_views", 2),
        (
            "volume.room_bounds_m=[[0, 0, 0], [3, 4.5, 2]]",
            "volume",
            "room_bounds_m",
            ((0, 0, 0), (3, 4.5, 2)),
        ),
        ("body.height_m=1.81", "body", "height_m", 1.81),
        ("body.model=bodies/my=own.toml", "body", "model", "bodies/my=own.toml"),
        ('output.formats=["bvh"]', "output", "formats", ("bvh",)),
    ],
)
def test_settings_reach_their_key(setting: str, section: str, key: str, value: object) -> None:
    assert getattr(getattr(load_config("default", (setting,)), section), key) == value


def test_later_settings_win_and_presets_are_overridden() -> None:
    config = load_config("reference", ("pose.n_layers=3", "pose.n_layers=9", "pose.refine=true"))
    assert config.pose.n_layers == 9
    assert config.pose.refine
    assert config.pose.n_particles == 600


@pytest.mark.parametrize(
    ("setting", "message"),
    [
        ("pose.n_partcles=5", "pose.n_partcles: unknown key"),
        ("pse.n_particles=5", "pse: unknown key"),
        ("pose.n_layers=0", "pose.n_layers"),
        ("pose.n_layers=many", "pose.n_layers"),
        ("pose.survival_rate=1.0", "pose.survival_rate"),
        ("volume.voxel_size_m=2", "volume.voxel_size_m"),
        ("volume.voxel_size_m=nan", "volume.voxel_size_m"),
        ("likelihood.variance_out=0", "likelihood.variance_out"),
        ('output.formats=["dae"]', "output.formats.0"),
        ("pose.n_layers", "section.key=value"),
        ("n_layers=5", "section.key=value"),
        ("pose.=5", "section.key=value"),
        ("pose.filter.kind=5", "pose.filter"),
    ],
)
def test_a_bad_setting_names_its_dotted_path(setting: str, message: str) -> None:
    with pytest.raises(MocapError, match=re.escape(message)):
        load_config("default", (setting,))


def test_an_unknown_key_lists_the_allowed_ones() -> None:
    with pytest.raises(MocapError, match="n_particles") as error:
        load_config("default", ("pose.n_partcles=5",))
    assert "allowed here" in str(error.value)
    with pytest.raises(MocapError, match="segmentation, volume, tracking"):
        load_config("default", ("pse.n_particles=5",))


def test_configuration_files(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text('[pose]\nfilter = "sir"\n', "utf-8")
    assert load_config(str(path)).pose.filter == "sir"
    path.write_text("[pose\n", "utf-8")
    with pytest.raises(MocapError, match="not a TOML file") as error:
        load_config(str(path))
    assert error.value.path == path
    with pytest.raises(MocapError, match=r"default, live, realtime, reference, .*thesis_body"):
        load_config("nonsense")


def test_the_configuration_cannot_be_changed() -> None:
    with pytest.raises(ValueError, match="frozen"):
        Config().pose.n_layers = 3  # type: ignore[misc]


def test_hash_knows_every_value_and_nothing_else() -> None:
    pose = PoseConfig()
    assert config_hash(pose) == config_hash(PoseConfig())
    assert config_hash(pose, "a", 1) == config_hash(PoseConfig(), "a", 1)
    others = [
        config_hash(pose.model_copy(update={"n_layers": 5})),
        config_hash(pose, None),
        config_hash(pose, 1),
        config_hash(pose, "1"),
        config_hash(Config()),
    ]
    assert len({config_hash(pose), *others}) == 6


def test_every_key_has_a_docstring_or_a_unit() -> None:
    """House rule: a docstring under each field, or a name that says all."""
    sections = {n: f for n, f in Config.model_fields.items() if isinstance(f.annotation, type)}
    missing = [
        f"{section}.{name}"
        for section, field in sections.items()
        for name in getattr(field.annotation, "model_fields", {})
        if name not in words_of(field.annotation) and not name.endswith(("_m", "_deg", "_s"))
    ]
    missing += [n for n in Config.model_fields if n not in sections and n not in words_of(Config)]
    assert not [m for m in missing if m not in ("pose.resampling", "output.formats", "output.report_cameras")]


def test_every_number_of_the_method_has_a_docstring_and_can_be_set() -> None:
    config = load_config()
    for room in dataclasses.fields(config.method):
        section = getattr(config.method, room.name)
        words = words_of(type(section))
        assert [f.name for f in dataclasses.fields(section) if f.name not in words] == [], room.name
        for field in dataclasses.fields(section):
            value = getattr(section, field.name)
            if isinstance(value, float):
                path = f"method.{room.name}.{field.name}"
                changed = load_config("default", (f"{path}={value + 1}",)).method
                assert getattr(getattr(changed, room.name), field.name) == value + 1


@pytest.mark.parametrize(
    "setting", ["method.limb_search.turn=2", "method.limb=2", "method.start.n_copies=two"]
)
def test_a_wrong_number_of_the_method_is_refused_by_its_path(setting: str) -> None:
    with pytest.raises(MocapError, match=setting.partition("=")[0].replace(".", r"\.")) as error:
        load_config("default", (setting,))
    words = "docs/configuration.md" if setting.endswith("two") else "allowed here"
    assert words in error.value.remedy


def test_the_observation_is_set_without_a_section() -> None:
    assert load_config().observation == "auto"
    assert load_config("default", ("observation=markers",)).observation == "markers"
    with pytest.raises(MocapError, match="observation"):
        load_config("default", ("observation=sound",))
    with pytest.raises(MocapError, match="cannot read the setting"):
        load_config("default", ("n_layers=3",))


ADDRESS = st.tuples(
    st.integers(0, 2**31),
    st.sampled_from(["pose", "first-pose", "trial"]),
    st.integers(0, 40),
    st.integers(0, 9999),
)


@given(a=ADDRESS, b=ADDRESS)
def test_addresses_are_independent_and_repeat(a: tuple, b: tuple) -> None:
    draw = [rng_for(*address).random(4) for address in (a, b, a)]
    np.testing.assert_array_equal(draw[0], draw[2])
    assert (a == b) == bool(np.array_equal(draw[0], draw[1]))


def test_neighbouring_frames_are_not_correlated() -> None:
    """First draws of 4000 frames look uniform: mean within four standard errors, no lag-one correlation."""
    first = np.array([rng_for(0, "pose", 1, f).random() for f in range(4000)])
    assert first.mean() == pytest.approx(0.5, abs=4 / np.sqrt(12 * 4000))
    assert abs(np.corrcoef(first[:-1], first[1:])[0, 1]) < 4 / np.sqrt(4000)


def test_errors_say_what_where_and_what_to_do() -> None:
    error = MocapError("no picture.", remedy="copy it again.", path="a/b.mp4", camera="cam_3", frame=17)
    assert str(error) == "no picture (file a/b.mp4, camera cam_3, frame 17). Remedy: copy it again."
    assert str(MocapError("nothing")) == "nothing."
