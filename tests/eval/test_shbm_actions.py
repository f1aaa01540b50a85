"""The filters of CF Table 7.1 and Figure 8.1: what they are and what they spend."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from eval.shbm_actions import EVALUATIONS, FILTERS, method_of
from eval.shbm_against_apf import filters
from mocap.body import load_body_model, scale_body
from mocap.filters.apf import apf_step
from mocap.filters.shbm import shbm_step

BODY = scale_body(load_body_model("anthropometric"), 1.7)
CLIP = SimpleNamespace(std=np.full(BODY.layout.n_columns, 0.1))


@pytest.mark.parametrize("name", FILTERS)
def test_a_filter_spends_what_its_name_says(name: str) -> None:
    step, settings = method_of(CLIP, name)  # type: ignore[arg-type]
    which, _, count = name.rpartition(" ")
    expected = 3600 if count == "6x600" else int(count)
    if which == "apf":
        assert step is apf_step
        spent = settings.n_layers * settings.n_particles
    else:
        assert step is shbm_step
        spent = sum(n * k for n, k in zip(settings.level_particles, settings.n_layers, strict=True))
    assert spent == pytest.approx(expected, abs=4)


def test_with_the_published_number_they_are_those_of_the_other_comparison() -> None:
    """So that its tables can be read side by side."""
    assert 2200 in EVALUATIONS
    others = filters(CLIP)  # type: ignore[arg-type]
    for name, other in (
        ("apf 2200", "apf"),
        ("apf 6x600", "apf 6x600"),
        ("shbm model2 2200", "shbm model2 mirror"),
    ):
        step, settings = method_of(CLIP, name)  # type: ignore[arg-type]
        assert step is others[other][0]
        np.testing.assert_equal(
            vars(settings) | {"hierarchy": None}, vars(others[other][1]) | {"hierarchy": None}
        )
    assert (
        method_of(CLIP, "shbm model1 2200")[1].hierarchy != method_of(CLIP, "shbm model2 2200")[1].hierarchy
    )  # type: ignore[arg-type]
