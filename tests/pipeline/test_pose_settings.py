"""From configuration to settings: budgets, scalable bodies, limbs, and flags of lost limbs at the landmarks."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from flesh_voxels import make_flesh

from mocap.body import load_body_model, neutral_state
from mocap.data import LANDMARKS
from mocap.errors import MocapError
from mocap.filters import FILTERS, FilterBudget, FilterInfo, FilterSettings, ParticleState, filter_settings
from mocap.filters.ddma import DdmaSettings, DdmaState, ShbmDdmaSettings
from mocap.filters.shbm import ShbmSettings
from mocap.pipeline.config import LikelihoodConfig, PoseConfig, load_config
from mocap.pipeline.pose_settings import filter_budget, make_tools, stated_height_m
from mocap.pose.follow import follow_pose
from mocap.pose.person import VolumeClip
from mocap.pose.volume import VolumeObservation

FLESH = make_flesh("anthropometric", 1.74, 0.04)
LAYOUT = FLESH.body.layout
STD = 0.5 * FLESH.body.max_speed / 25


def settings_of(pose: PoseConfig) -> FilterSettings:
    return filter_settings(filter_budget(pose, LAYOUT), LAYOUT, STD)


def settings(**keys: object) -> object:
    return settings_of(PoseConfig(**keys))  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("setting", "of_body", "of_session", "stated"),
    [(1.6, 1.7, 1.8, 1.6), (None, 1.7, 1.8, 1.7), (None, None, 1.8, 1.8), (None, None, None, None)],
)
def test_the_height_that_is_stated_nearest_to_the_run_counts(
    setting: float | None, of_body: float | None, of_session: float | None, stated: float | None
) -> None:
    config = load_config()
    config = config.model_copy(update={"body": config.body.model_copy(update={"height_m": setting})})
    model = load_body_model("anthropometric").model_copy(update={"height_m": of_body})
    session = SimpleNamespace(person_height_m=of_session)
    assert stated_height_m(config, model, session) == stated  # type: ignore[arg-type]


def test_the_preset_is_the_published_run() -> None:
    """CF Eq. 7.29: 300, 500 and 300 particles, two layers each."""
    pose = load_config("reference_shbm").pose
    own = settings_of(pose)
    assert isinstance(own, ShbmSettings)
    assert own.level_particles == (300, 500, 300)
    assert own.n_layers == (2, 2, 2)
    assert (own.survival_rate, own.structural_rate) == (0.5, 0.8)
    assert own.hierarchy is not None
    assert own.hierarchy.name == "model2"
    assert not pose.refine
    assert not pose.look_again


def test_budget_follows_the_hierarchy() -> None:
    """Model 2 scores fewer parts in its second level, so that it gets more particles for as many evaluations."""
    particles = {}
    for name in ("model1", "model2", "model1_printed"):
        own = settings(filter="shbm-apf", n_layers=4, n_particles=550, hierarchy=name)
        assert isinstance(own, ShbmSettings)
        share = {"model1": (0.1, 1.0, 1.0), "model2": (0.1, 0.6, 1.0), "model1_printed": (0.1, 1.0, 1.0)}[
            name
        ]
        cost = 2 * np.dot(own.level_particles, share)
        assert cost == pytest.approx(2200, abs=6)
        particles[name] = own.level_particles
    assert particles["model2"] > particles["model1"]
    assert particles["model1"][1] / particles["model1"][0] == pytest.approx(13 / 6, rel=0.01)
    assert particles["model1_printed"][1] / particles["model1_printed"][0] == pytest.approx(10 / 6, rel=0.01)


def test_keys_reach_the_settings() -> None:
    own = settings(
        filter="shbm-ddma-pf",
        level_particles=(10, 20, 30),
        level_layers=3,
        structural_rate=0.7,
        survival_rate=0.4,
        crossing="direct",
        limb_evidence="own",
        limbs="whole_limbs",
    )
    assert isinstance(own, ShbmDdmaSettings)
    assert own.shbm.level_particles == (10, 20, 30)
    assert own.shbm.n_layers == (3, 3, 3)
    assert (own.shbm.survival_rate, own.shbm.structural_rate, own.shbm.crossing) == (0.4, 0.7, "direct")
    assert own.limbs.own_data
    assert own.limbs.lost_spread_share is not None
    assert own.limbs.limbs is not None
    assert all(len(limb.units) == 1 for limb in own.limbs.limbs)
    published = settings(filter="ddma-pf")
    assert isinstance(published, DdmaSettings)
    assert published.limbs.lost_std_rad == pytest.approx(np.deg2rad(15))
    assert (published.limbs.lost_occupancy, published.limbs.found_occupancy) == (0.05, 0.7)
    assert not published.limbs.own_data


def test_other_filters_are_as_before() -> None:
    own = settings(filter="apf", n_layers=3, n_particles=70)
    same = filter_settings(FilterBudget("apf", n_particles=70, n_layers=3), LAYOUT, STD)
    assert type(own) is type(same)
    assert own.n_particles == same.n_particles  # type: ignore[attr-defined]


def test_what_does_not_fit_is_said(tmp_path: Path) -> None:
    alien = tmp_path / "alien.toml"
    alien.write_text('name = "alien"\n[[level]]\nname = "H1"\ncolumns = ["tail_x"]\nparts = ["torso"]\n')
    with pytest.raises(MocapError, match=r"pose\.hierarchy.*unknown column 'tail_x'"):
        settings(filter="shbm-apf", hierarchy=str(alien))
    with pytest.raises(MocapError, match="scalable body"):
        settings(filter="shbm-apf", hierarchy="model7")
    with pytest.raises(MocapError, match=r"level_particles has 2 numbers, the hierarchy model2 has 3 levels"):
        settings(filter="shbm-apf", level_particles=(10, 20))
    wings = tmp_path / "wings.toml"
    wings.write_text('name = "wings"\n[[limb]]\nname = "wing"\nunits = [["wing"]]\n')
    with pytest.raises(MocapError, match=r"pose\.limbs.*unknown part 'wing'"):
        settings(filter="ddma-pf", limbs=str(wings))


@pytest.mark.parametrize("feeds_back", [False, True])
def test_lost_parts_reach_the_landmarks_and_states_keep_their_kind(
    monkeypatch: pytest.MonkeyPatch, feeds_back: bool
) -> None:
    """A filter that sits at the truth and says from frame 2 on that the right shank is lost."""
    truth = neutral_state(FLESH.body)
    shank = LAYOUT.parts.index("right_shank")
    seen: list[tuple[int, ...]] = []

    def step(problem: Any, state: ParticleState, own: Any, *, rng: Any) -> tuple[ParticleState, FilterInfo]:
        if isinstance(state, DdmaState):
            seen.append(state.n_units)
        is_there = np.ones(LAYOUT.n_parts, dtype=np.bool_)
        is_there[shank] = len(seen) < 2
        info = FilterInfo(
            estimate=truth,
            best=truth,
            best_log_likelihood=0.0,
            beta=np.ones(1),
            ess=np.ones(1),
            n_evaluations=1,
            is_degenerate=False,
            observed_parts=is_there,
        )
        return DdmaState(np.tile(truth, (7, 1)), np.full(7, 1 / 7), (len(seen),)), info

    monkeypatch.setitem(FILTERS, "apf", replace(FILTERS["apf"], step=step))
    pose = PoseConfig(
        filter="apf", refine=feeds_back, look_again=False, follow_track=True, outline_weight=0.0
    )
    tools = make_tools(FLESH.grid, 12.5, 1.74, "anthropometric", pose, LikelihoodConfig(), 1)
    hull = FLESH.hull(truth, margin_m=0.02)
    clip = VolumeClip(1, np.arange(4), np.zeros((4, 3)), VolumeObservation(tools, lambda f: hull))
    found = list(follow_pose(clip, range(4), truth, seed=0, stage="pose"))
    ankle = LANDMARKS.index("right_ankle")
    assert [bool(frame.observed[ankle]) for frame in found] == [True, True, False, False]
    assert all(frame.observed[LANDMARKS.index("left_ankle")] for frame in found)
    assert seen == [(0,), (1,), (2,)], (
        "what the filter remembers lives on when particles are moved or fed back"
    )
