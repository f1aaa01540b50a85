"""The size of a person from refined poses: where a cost is lowest, and bodies of another size than the model."""

from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from flesh_voxels import make_flesh, rasterise
from marker_world import marching

from mocap.body import candidate_states, landmarks_of, load_body_model, neutral_state, scale_body
from mocap.body.initial import DEFAULT_HEIGHT_M, HeightEstimate
from mocap.body.stretch import covered_kinds, lengths_of, resize_body, segment_kinds, stretch_body
from mocap.data import LANDMARKS
from mocap.pipeline.config import LikelihoodConfig, PoseConfig
from mocap.pipeline.pose_settings import make_tools
from mocap.pose import person
from mocap.pose.size import _lowest, fit_size
from mocap.pose.volume import PersonHull, VolumeEvidence, VolumeObservation, VolumeTools, estimate_height
from mocap.volume import surface_voxels

HEIGHT_M = 1.7
VOXEL_M = 0.03
FLESH = make_flesh("anthropometric", HEIGHT_M, VOXEL_M)


def tools() -> VolumeTools:
    return make_tools(
        FLESH.grid, 12.5, HEIGHT_M, "anthropometric", PoseConfig(outline_weight=0), LikelihoodConfig(), 1
    )


@pytest.mark.parametrize("where", [-0.11, -0.02, 0.0, 0.013, 0.05, 0.12])
def test_the_lowest_place_of_a_parabola_is_found(where: float) -> None:
    asked = []

    def cost(x: float) -> float:
        asked.append(x)
        return 3.0 + 40.0 * (x - where) ** 2

    found, value = _lowest(cost, 0.0, 0.03, furthest=5)
    assert found == pytest.approx(where, abs=1e-9)
    assert value <= 3.0 + 40.0 * 0.015**2 + 1e-9
    assert len(asked) == len(set(asked))


@pytest.mark.parametrize("slope", [-1.0, 1.0])
def test_the_search_ends(slope: float) -> None:
    found, _ = _lowest(lambda x: slope * x, 1.0, 0.03, furthest=4)
    assert found == pytest.approx(1.0 - slope * 0.12)
    flat, _ = _lowest(lambda x: 2.0, 0.5, 0.03, furthest=5)
    assert abs(flat - 0.5) <= 0.15


def test_a_resized_body_is_a_similar_one() -> None:
    body = resize_body(FLESH.body, 1.07, 1.07)
    assert body.height_m == pytest.approx(1.07 * HEIGHT_M)
    same = stretch_body(FLESH.body, np.full((len(body.joints), 3), 1.07))
    for key, value in lengths_of(same).items():
        np.testing.assert_allclose(lengths_of(body)[key], value)
    thin = resize_body(FLESH.body, 1.07, 0.9)
    np.testing.assert_allclose(thin.cones.radii, 0.9 * FLESH.body.cones.radii)
    np.testing.assert_array_equal(thin.offset, body.offset)
    state = neutral_state(FLESH.body)[None]
    state[:, :3] = 0
    np.testing.assert_allclose(landmarks_of(body, state), 1.07 * landmarks_of(FLESH.body, state))
    thick = resize_body(FLESH.body, 1.07, of_kinds(left_knee=1.2))
    is_shank = np.isin(
        FLESH.body.cones.joint, [FLESH.body.joints.index(f"{s}_knee") for s in ("left", "right")]
    )
    np.testing.assert_allclose(thick.cones.radii[is_shank], 1.2 * FLESH.body.cones.radii[is_shank])
    np.testing.assert_array_equal(thick.cones.radii[~is_shank], FLESH.body.cones.radii[~is_shank])
    np.testing.assert_array_equal(thick.cones.start, body.cones.start)
    for bad in ((0.0, 1.0), (1.0, -1.0), (np.nan, 1.0), (1.0, of_kinds(left_knee=0.0))):
        with pytest.raises(ValueError, match="positive factors"):
            resize_body(FLESH.body, *bad)


def test_clothes_cover_all_but_head_hands_and_feet() -> None:
    whole = scale_body(load_body_model("whole"), HEIGHT_M)
    kinds, is_covered = segment_kinds(whole), covered_kinds(whole)
    bare = {joint for joint, kind in zip(whole.joints, kinds, strict=True) if not is_covered[kind]}
    ends = ("wrist", "ankle", "mtp")
    assert bare == {"neck", *(f"{side}_{end}" for side in ("left", "right") for end in ends)}


def problems(
    factor: float, girth: float | np.ndarray, change: Callable[[np.ndarray], None] | None = None
) -> tuple[list, list]:
    """Frames of a person `factor` longer and `girth` wider than the model, and poses that are a little off."""
    own = resize_body(FLESH.body, factor, girth)
    states = marching(own, 12, 12.5)[::3]
    if change is not None:
        change(states)
    t = tools().without_floor  # a march in place sinks by 2 cm
    frames = [t.frame(rasterise(own, FLESH.grid, s, margin_m=VOXEL_M)) for s in states]
    starts = [s + 0.01 * np.random.default_rng(5).standard_normal(len(s)) for s in states]
    return frames, [np.clip(s, FLESH.body.layout.lower, FLESH.body.layout.upper) for s in starts]


# Measured on the cases below: the factor is off by 0.7 to 1.0 %, half a voxel over the height of the head, and the
# girth by up to 0.06, of which its prior has a part.
SLACK, GIRTH_SLACK = 0.013, 0.08


@pytest.mark.parametrize(
    ("factor", "girth"),
    [
        pytest.param(1.0, 1.0, marks=pytest.mark.slow),
        pytest.param(1.06, 1.06, marks=pytest.mark.slow),
        (1.05, 0.92),
    ],
)
def test_a_larger_person_is_found_larger_whatever_his_girth(factor: float, girth: float) -> None:
    fit = fit_size(*problems(factor, girth))
    assert fit.factor == pytest.approx(factor, abs=SLACK)
    assert fit.girth == pytest.approx(girth, abs=GIRTH_SLACK)
    assert fit.n_frames == 4
    assert tools().resized(fit.factor).body.height_m == pytest.approx(fit.factor * HEIGHT_M)


def of_kinds(**factors: float) -> np.ndarray:
    """Factors of the radii of each kind of segment, (G,); 1 of those that are not named, by a joint of theirs."""
    out = np.ones(len(covered_kinds(FLESH.body)))
    for joint, factor in factors.items():
        out[segment_kinds(FLESH.body)[FLESH.body.joints.index(joint)]] = factor
    return out


STOUT = of_kinds(root=1.25, waist=1.2, left_hip=1.3, left_knee=1.3)


def test_who_is_stout_has_girths_of_his_own() -> None:
    """And he is not taller for it.  Arms, a voxel thin here, are drawn to the common girth; the head is not."""
    fit = fit_size(*problems(1.0, STOUT))
    assert fit.factor == pytest.approx(1.0, abs=SLACK)
    wide, arms = STOUT > 1.0, of_kinds(left_shoulder=2.0, left_elbow=2.0) > 1.0
    np.testing.assert_allclose(fit.radii[wide], STOUT[wide], atol=0.03)
    np.testing.assert_allclose(fit.radii[~(wide | arms)], 1.0, atol=0.03)
    assert fit.radii[arms].max() < fit.radii[wide].min() - 0.03


def test_of_a_stated_height_girths_alone_are_fitted() -> None:
    frames, states = problems(1.0, STOUT)
    fit = fit_size(frames, states, is_given=True)
    assert fit.factor == 1.0
    assert fit.radii[STOUT > 1.0].min() > 1.1


@pytest.mark.parametrize(("n_cameras", "has_own"), [(1, False), (2, False), (3, True)])
def test_two_cameras_tell_nothing_of_girths(
    n_cameras: int, has_own: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(VolumeEvidence, "n_cameras", n_cameras)
    fit = fit_size(*problems(1.0, STOUT))
    assert bool(np.ptp(fit.radii) > 0.1) is has_own


def test_a_usual_girth_stays_as_it_is() -> None:
    """Radii grow with the lengths; a stated height leaves the body as it is, to the byte."""
    frames, states = problems(1.03, 1.03)
    fit = fit_size(frames, states)
    np.testing.assert_array_equal(fit.radii, np.full(len(fit.radii), fit.factor))
    state = neutral_state(FLESH.body)
    state[2] += 0.05
    clip = quick_clip(state, rasterise(FLESH.body, FLESH.grid, state, margin_m=VOXEL_M))
    given = HeightEstimate(HEIGHT_M, is_measured=True, is_given=True)
    start = person.start_person(clip, given, seed=0, is_size_fitted=True)
    assert start.height == given
    for key, value in lengths_of(FLESH.body).items():
        np.testing.assert_array_equal(lengths_of(start.tools.body)[key], value)


@pytest.mark.slow
def test_only_a_head_that_was_seen_is_a_lower_bound() -> None:
    """A person 6 % smaller than a usual height is found smaller; than a head that was seen up there, hardly."""
    frames, states = problems(0.94, 0.94)
    free = fit_size(frames, states, is_head_seen=False)
    bound = fit_size(frames, states)
    assert free.factor == pytest.approx(0.94, abs=0.02)
    assert free.factor < bound.factor - 0.005


def test_without_frames_there_is_no_size() -> None:
    with pytest.raises(ValueError, match="frames is empty"):
        fit_size([], [])


def quick_clip(state: np.ndarray, hull: PersonHull) -> person.VolumeClip:
    """Two frames of somebody in a pose (D,), for a short search."""
    quick = PoseConfig(n_start_frames=1, n_first_poses=1, n_layers=2, n_particles=40, look_again=False)
    made = make_tools(FLESH.grid, 12.5, HEIGHT_M, "anthropometric", quick, LikelihoodConfig(), 1)
    places = np.tile(state[:3], (2, 1))
    return person.VolumeClip(1, np.arange(2), places, VolumeObservation(made, lambda _: hull))


@pytest.mark.parametrize("with_cupboard", [False, True])
def test_no_size_is_fitted_and_outlines_say_little_where_the_volume_holds_more_than_the_person(
    with_cupboard: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A larger body would explain the furniture as well, and its outlines are not the person's."""
    fitted = []

    def sized(clip: person.VolumeClip, height: object, first: object, *, seed: int) -> tuple[object, ...]:
        fitted.append(clip)
        return clip.observation.tools, height, first

    monkeypatch.setattr(person, "_sized", sized)
    state = neutral_state(FLESH.body)
    state[2] += 0.05
    hull = rasterise(FLESH.body, FLESH.grid, state, margin_m=VOXEL_M)
    if with_cupboard:
        low = np.floor((np.array([0.3, -0.8, 0.1]) - FLESH.grid.origin) / VOXEL_M).astype(int)
        subs = np.stack(np.meshgrid(*(np.arange(a, a + 40) for a in low), indexing="ij"), axis=-1).reshape(
            -1, 3
        )
        voxels = np.union1d(hull.voxels, FLESH.grid.linear(subs)).astype(np.int32)
        hull = PersonHull(voxels, surface_voxels(voxels, FLESH.grid))
    clip = quick_clip(state, hull)
    height = HeightEstimate(HEIGHT_M, is_measured=True)
    start = person.start_person(clip, height, seed=0, is_size_fitted=True)
    assert bool(fitted) is not with_cupboard
    assert start.tools.settings.outline_weight == (0.3 if with_cupboard else 8.0)


def test_the_settled_pose_says_whether_the_volume_holds_more(monkeypatch: pytest.MonkeyPatch) -> None:
    """A rough pose leaves much unexplained, whoever it is of.  What is settled with all of the outlines, and found to
    explain them badly, is settled again with little of them."""
    settled: list[tuple[float, list[person.FirstPose]]] = []
    asked = []
    settle = person.settle_first_poses

    def told(search: person.PoseSearch, *args: object, **others: object) -> list[person.FirstPose]:
        settled.append((search.settings.outline_weight, settle(search, *args, **others)))  # type: ignore[arg-type]
        return settled[-1][1]

    def is_crowded(_: object, state: np.ndarray) -> bool:
        asked.append(state)
        return True

    monkeypatch.setattr(person, "settle_first_poses", told)
    monkeypatch.setattr(VolumeEvidence, "is_crowded", is_crowded)
    state = neutral_state(FLESH.body)
    hull = rasterise(FLESH.body, FLESH.grid, state, margin_m=VOXEL_M)
    clip = quick_clip(state, hull)
    start = person.start_person(clip, HeightEstimate(HEIGHT_M, is_measured=True), seed=0)
    (full, first), (gentle, second) = settled
    assert (full, gentle) == (8.0, 0.3)
    assert len(asked) == 1
    np.testing.assert_array_equal(asked[0], first[0].state)
    assert start.first in second


def test_first_poses_and_sizes_are_looked_for_without_the_floor(monkeypatch: pytest.MonkeyPatch) -> None:
    gains = {}

    def spied(name: str) -> None:
        real = getattr(person, name)

        def told(clip: person.VolumeClip, *args: object, **others: object) -> object:
            gains[name] = clip.observation.tools.surface_fit.floor_gain
            return real(clip, *args, **others)

        monkeypatch.setattr(person, name, told)

    for name in ("_most_promising", "choose_hypothesis", "_sized"):
        spied(name)
    state = neutral_state(FLESH.body)
    hull = rasterise(FLESH.body, FLESH.grid, state, margin_m=VOXEL_M)
    clip = quick_clip(state, hull)
    height = HeightEstimate(HEIGHT_M, is_measured=True)
    start = person.start_person(clip, height, seed=0, is_size_fitted=True)
    assert gains == {"_most_promising": 0.0, "choose_hypothesis": 0.0, "_sized": 0.0}
    assert start.tools.surface_fit == clip.observation.tools.surface_fit
    assert start.tools.surface_fit.floor_gain > 0
    assert start.tools.body.height_m != HEIGHT_M  # and the body is the one that was fitted


@pytest.mark.parametrize(("height_m", "pose"), [(1.2, "stand"), (1.72, "sit")])
def test_poses_tell_a_child_who_stands_from_somebody_who_sits(height_m: float, pose: str) -> None:
    """The volume of either ends at 1.2 to 1.3 m."""
    flesh = make_flesh("anthropometric", height_m, VOXEL_M)
    standing = flesh.grid.centers(flesh.hull(neutral_state(flesh.body)).voxels)
    states, labels = candidate_states(flesh.body, standing, np.zeros(1))
    state = states[labels.index(pose)]
    hull = rasterise(flesh.body, flesh.grid, state, margin_m=VOXEL_M)
    bottom = flesh.grid.centers(hull.voxels)[:, 2].min()
    state[2] -= bottom - 0.5 * VOXEL_M
    hull = rasterise(flesh.body, flesh.grid, state, margin_m=VOXEL_M)
    estimate = estimate_height(flesh.grid, lambda _: hull, range(2))
    assert not estimate.is_measured
    assert estimate.low_m is not None
    assert 1.15 < estimate.low_m < 1.4
    quick = PoseConfig(n_start_frames=1, n_first_poses=3, n_layers=3, n_particles=80)
    made = make_tools(flesh.grid, 12.5, estimate.height_m, "anthropometric", quick, LikelihoodConfig(), 1)
    clip = person.VolumeClip(
        1, np.arange(2), np.tile(state[:3], (2, 1)), VolumeObservation(made, lambda _: hull)
    )
    start = person.start_person(clip, estimate, seed=0)
    assert start.height.is_measured == (pose == "stand")
    assert start.tools.body.height_m == pytest.approx(height_m, abs=0.05)


@pytest.mark.parametrize(
    ("gain", "low_m", "walked_m", "pelvis_share", "is_child"),
    [
        (61.0, 1.2, 0.0, 0.44, True),
        (59.0, 1.2, 0.0, 0.44, False),
        (99.0, None, 0.0, 0.44, False),
        (1.0, 1.2, 0.1, 0.44, True),  # who walks does not sit
        (-1.0, 1.2, 0.1, 0.44, False),
        (1.0, 1.2, 0.0, 0.46, True),  # nor does who stands
        (-1.0, 1.2, 0.0, 0.46, False),
    ],
)
def test_who_stands_must_explain_a_low_volume_clearly_better_than_who_sits(
    gain: float,
    low_m: float | None,
    walked_m: float,
    pelvis_share: float,
    is_child: bool,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    tried = []

    def started(clip: person.VolumeClip, height: HeightEstimate, **_: Any) -> Any:
        tried.append((height, clip.observation.tools.body.height_m))
        value = -100.0 + (gain if height.is_measured else 0.0)
        first = SimpleNamespace(log_likelihood=value, frame=0, state=pose)
        return SimpleNamespace(height=height, first=first, tools=clip.observation.tools)

    monkeypatch.setattr(person, "_started", started)
    state = neutral_state(FLESH.body)
    pose = state.copy()
    pelvis_m = landmarks_of(FLESH.body, pose[None])[0, LANDMARKS.index("pelvis"), 2]
    pose[2] += pelvis_share * HEIGHT_M - pelvis_m
    clip = quick_clip(state, rasterise(FLESH.body, FLESH.grid, state))
    assert clip.xyz is not None
    clip.xyz[1, 0] += walked_m
    start = person.start_person(clip, HeightEstimate(DEFAULT_HEIGHT_M, False, low_m), seed=0)
    usual, child = HeightEstimate(DEFAULT_HEIGHT_M, False), HeightEstimate(1.2, True)
    assert start.height == (child if is_child else usual)
    assert [height for height, _ in tried] == ([usual] if low_m is None else [usual, child])
    assert [size for _, size in tried] == pytest.approx([HEIGHT_M, 1.2][: len(tried)])


@pytest.mark.parametrize(("judged", "is_small"), [(-41.0, False), (-39.0, True)])
def test_who_is_taken_for_crowded_is_judged_by_the_same_outlines(
    judged: float, is_small: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A pose that leaves much unexplained has its outlines count for less, and looks better by it."""
    weights = []

    def started(clip: person.VolumeClip, height: HeightEstimate, **_: Any) -> Any:
        own = clip.observation.tools
        if height.is_measured:
            own = replace(own, settings=replace(own.settings, outline_weight=0.3))
        first = SimpleNamespace(log_likelihood=-10.0 if height.is_measured else -100.0, frame=1, state=state)
        return SimpleNamespace(height=height, first=first, tools=own)

    def search_at(clip: person.VolumeClip, row: int) -> Any:
        own = clip.observation.tools
        weights.append((own.settings.outline_weight, own.surface_fit.floor_gain, own.body.height_m, row))
        return SimpleNamespace(judge=lambda states: np.array([judged]))

    monkeypatch.setattr(person, "_started", started)
    monkeypatch.setattr(person, "_search_at", search_at)
    state = neutral_state(FLESH.body)
    state[2] -= 0.4  # nobody stands like this
    clip = quick_clip(state, rasterise(FLESH.body, FLESH.grid, state))
    usual = clip.observation.tools.settings.outline_weight
    start = person.start_person(clip, HeightEstimate(DEFAULT_HEIGHT_M, False, 1.5), seed=0)
    assert start.height.is_measured == is_small
    assert weights == [(usual, 0.0, pytest.approx(1.5), 1)]
    assert usual != 0.3
