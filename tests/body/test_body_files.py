"""A person's body written as a body file and read back: the same body, and the same file again."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mocap.body import body_presets, body_toml, load_body_model, model_of, scale_body
from mocap.body.model import Body
from mocap.body.stretch import lengths_of, segment_groups, stretch_body
from mocap.errors import MocapError

# Half of the last digit that is written: of a fraction (1e-6), and of the height (0.1 mm) over a metre's length.
SLACK_M = 0.5e-6 * 2.2 + 0.5e-4


def stretched(name: str, seed: int) -> Body:
    body = scale_body(load_body_model(name), 1.7312345)
    group = segment_groups(body)
    factors = np.exp(0.08 * np.random.default_rng(seed).standard_normal((group.max() + 1, 3)))
    return stretch_body(body, factors[group])


def assert_same_lengths(a: Body, b: Body, atol: float) -> None:
    for key, value in lengths_of(a).items():
        np.testing.assert_allclose(lengths_of(b)[key], value, atol=atol, rtol=0, err_msg=key)


@pytest.mark.parametrize("name", body_presets())
def test_a_preset_is_read_back_as_it_is(name: str, tmp_path: Path) -> None:
    model = load_body_model(name)
    path = tmp_path / "body.toml"
    path.write_text(body_toml(model))
    assert load_body_model(path) == model


@pytest.mark.parametrize("name", body_presets())
@pytest.mark.parametrize("seed", [0, 1])
def test_a_persons_body_comes_back(name: str, seed: int, tmp_path: Path) -> None:
    model, body = load_body_model(name), stretched(name, seed)
    path = tmp_path / "body.toml"
    path.write_text(body_toml(model_of(body, model), "two\nlines"))
    read = load_body_model(path)
    assert read.height_m == pytest.approx(body.height_m, abs=0.5e-4)
    again = scale_body(read, read.height_m)
    assert_same_lengths(body, again, SLACK_M)
    assert again.layout.names == body.layout.names
    np.testing.assert_array_equal(again.layout.lower, body.layout.lower)
    np.testing.assert_array_equal(again.max_speed, body.max_speed)
    np.testing.assert_array_equal(again.cones.part, body.cones.part)
    assert body_toml(model_of(again, read), "two\nlines") == path.read_text()


@settings(max_examples=25, deadline=None)
@given(st.floats(0.4, 2.5))
def test_writing_again_changes_nothing_at_any_height(height_m: float) -> None:
    model = load_body_model("anthropometric")
    first = model_of(scale_body(model, height_m), model)
    second = model_of(scale_body(first, first.height_m), first)
    assert body_toml(first) == body_toml(second)


def test_names_with_quotes_and_breaks_survive(tmp_path: Path) -> None:
    model = load_body_model("thesis").model_copy(update={"name": 'a "b" \\ ü', "source": "line\nline\x7f\t"})
    path = tmp_path / "body.toml"
    path.write_text(body_toml(model), encoding="utf-8")
    assert load_body_model(path) == model


def test_another_model_is_refused() -> None:
    body = scale_body(load_body_model("anthropometric"), 1.7)
    other = load_body_model("thesis")
    with pytest.raises(ValueError, match="does not come from the model"):
        model_of(body, other.model_copy(update={"part": other.part[:-1]}))


@pytest.mark.parametrize("height", ["0", "-1.7", "nan", '"tall"', "170"])
def test_a_senseless_height_is_refused_with_its_key(height: str, tmp_path: Path) -> None:
    path = tmp_path / "body.toml"
    path.write_text(f"height_m = {height}\n" + body_toml(load_body_model("thesis")))
    with pytest.raises(MocapError, match="height_m"):
        load_body_model(path)
