"""The page that adds evidence: its code runs, and does what the page says."""

from __future__ import annotations

import re
import sys
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

PAGE = Path(__file__).resolve().parents[2] / "docs" / "add-evidence.md"
CODE = re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), flags=re.DOTALL)


@cache
def ran() -> dict[str, Any]:
    """The names of the page after its code has run."""
    module = ModuleType("points_page")
    sys.modules[module.__name__] = module  # dataclasses look up the module of their annotations
    for block in CODE:
        exec(compile(block, str(PAGE), "exec"), vars(module))
    return vars(module)


def test_the_page_has_a_file_and_a_use_of_it() -> None:
    assert len(CODE) == 2


def test_the_pose_is_followed_and_what_is_not_seen_is_said() -> None:
    page = ran()
    poses, wrist, error = page["poses"], page["wrist"], page["error"]
    hidden = [0, 3, 6, 7, 9]
    assert [p.row for p in poses if not p.observed[wrist]] == hidden
    assert not poses[7].observed.any()
    assert poses[7].blind_std > 0 == poses[6].blind_std
    seen = np.delete(error, 7, axis=0)
    assert seen.mean() < 0.012, "points of 10 mm are averaged over the body"
    assert seen[:, wrist].max() < 0.08, "a wrist that is not seen is held by the rest of the arm"


def test_unknown_is_not_absent() -> None:
    """A point that nobody sees has no say: no nats, no information, whatever the pose."""
    page = ran()
    body, truth = page["body"], page["truth"]
    places = page["landmarks_of"](body, truth[:1])[0]
    places[page["wrist"]] = np.nan
    problem = page["PointProblem"](body, places, 0.01)
    bent = truth[0].copy()
    bent[body.layout.names.index("left_elbow_z")] -= 0.5
    np.testing.assert_allclose(problem.log_likelihood(np.stack([truth[0], bent])).sum(axis=1), 0.0, atol=1e-9)
    elbow = body.layout.names.index("left_elbow_z")
    assert problem.normal_equations(truth[0])[1][elbow, elbow] == 0.0
