"""What no camera can judge: unknown voxels cost nothing, hidden landmarks are not observed and grow uncertain."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
from flesh_voxels import make_flesh
from outline_world import make_rig
from test_pose_estimate import BODY, series_of

from mocap.body import landmarks_of, neutral_state
from mocap.body.initial import HeightEstimate
from mocap.data import LANDMARKS, VoxelGrid
from mocap.io.session import Session
from mocap.pipeline.config import LikelihoodConfig, PoseConfig
from mocap.pipeline.pose_settings import make_tools
from mocap.pipeline.stages.pose import PersonViews
from mocap.pose.deviation import FrameSeries, landmark_covariances
from mocap.pose.method import DeviationSettings, EvidenceSettings
from mocap.pose.result import warnings_of_volumes
from mocap.pose.volume import PersonHull, VolumeEvidence, pack_volume
from mocap.volume import no_occluders, surface_voxels

VOXEL_M = 0.04
FLESH = make_flesh("anthropometric", 1.74, VOXEL_M)
ANKLE = LANDMARKS.index("right_ankle")


def state() -> np.ndarray:
    found = neutral_state(FLESH.body)
    found[2] += 0.05
    return found


def without_shank(*, is_unknown: bool) -> PersonHull:
    """The body's voxels without the right lower leg, which is empty or unknown."""
    whole = FLESH.hull(state(), margin_m=VOXEL_M)
    centers = FLESH.grid.centers(whole.voxels)
    knee, hip = landmarks_of(FLESH.body, state()[None])[0][
        [LANDMARKS.index("right_knee"), LANDMARKS.index("pelvis")]
    ]
    is_shank = (centers[:, 2] < knee[2]) & ((centers[:, :2] - hip[:2]) @ (knee[:2] - hip[:2]) > 0)
    left, gone = whole.voxels[~is_shank], whole.voxels[is_shank]
    assert 50 < len(gone) < 0.2 * len(whole.voxels)
    unknown = gone if is_unknown else np.zeros(0, dtype=np.int32)
    return PersonHull(left, surface_voxels(left, FLESH.grid, unknown), unknown=unknown)


def evidence(hull: PersonHull) -> VolumeEvidence:
    tools = make_tools(FLESH.grid, 30.0, 1.74, "anthropometric", PoseConfig(), LikelihoodConfig(), 1)
    return tools.frame(hull)


def test_a_leg_in_the_unknown_costs_nothing() -> None:
    whole, empty, unknown = (
        float(evidence(hull).evidence([state()])[0])
        for hull in (
            FLESH.hull(state(), margin_m=VOXEL_M),
            without_shank(is_unknown=False),
            without_shank(is_unknown=True),
        )
    )
    assert empty < whole - 20.0
    assert unknown > whole - 3.0


def test_legs_that_nobody_sees_carry_the_body() -> None:
    """Nothing is seen below the waist, and the hull above is wide enough for bent legs."""
    whole, grid = FLESH.hull(state(), margin_m=4 * VOXEL_M), FLESH.grid
    everywhere = np.arange(grid.n_voxels, dtype=np.int32)
    waist = state()[2] - 0.05
    low = everywhere[grid.centers(everywhere)[:, 2] < waist]
    seen = np.setdiff1d(whole.voxels, low)
    behind = evidence(PersonHull(seen, surface_voxels(seen, grid, low), unknown=low))
    floating = evidence(PersonHull(seen, surface_voxels(seen, grid)))
    assert behind.hides_legs
    assert not floating.hides_legs
    assert not evidence(whole).hides_legs
    bent, names = state(), list(FLESH.body.layout.names)
    for side in ("left", "right"):
        bent[names.index(f"{side}_hip_y")] -= 1.6
        bent[names.index(f"{side}_knee_y")] += 2.0
    ankle = landmarks_of(FLESH.body, np.stack([state(), bent]))[:, ANKLE, 2]
    assert ankle[1] > ankle[0] + 0.2
    free = np.full(FLESH.body.layout.n_columns, np.inf)
    usual = replace(behind.residuals, usual_std=free)
    n, per_m2 = behind.surface.n_points, 90_000.0
    pull = [
        per_m2 / n * (fit.normal_equations(bent)[0] - fit.normal_equations(state())[0])
        for fit in (behind.residuals, usual)
    ]
    assert pull[0] > pull[1] + 30.0


def stored_hull(grid: VoxelGrid, voxels: np.ndarray, unknown: np.ndarray) -> PersonHull:
    """What the stage makes of stored voxels of one person."""
    session = SimpleNamespace(rig=make_rig())
    rows = {
        "voxels": voxels.astype(np.uint32),
        "unknown": unknown.astype(np.uint32),
        "is_surface": np.ones(len(voxels), dtype=np.uint8),
        "used": np.ones(len(session.rig), dtype=np.bool_),
    }
    views = PersonViews(cast(Session, session), grid, no_occluders())
    found = views.hull(rows, np.ones(len(voxels), dtype=np.uint8), 1, dict)
    assert found is not None
    return replace(found, outlines=None, rays=None)  # of masks and pictures, of which there are none


def test_legs_that_masks_have_lost_are_unknown() -> None:
    """Nothing hides them: the masks of all cameras end at the hips, and below them is the floor."""
    grid, whole = FLESH.grid, FLESH.hull(state(), margin_m=VOXEL_M).voxels
    hips = landmarks_of(FLESH.body, state()[None])[0][LANDMARKS.index("pelvis"), 2]
    none, beside = np.zeros(0, dtype=np.int32), np.array([3, 5], dtype=np.int32)
    trunk = whole[grid.centers(whole)[:, 2] > hips]
    torn, complete = stored_hull(grid, trunk, beside), stored_hull(grid, whole, none)
    assert not complete.unknown.size
    assert np.isin(np.setdiff1d(whole, trunk), torn.unknown).mean() > 0.97
    assert np.isin(beside, torn.unknown).all()
    assert np.all(np.diff(torn.unknown) > 0)
    empty = PersonHull(trunk, surface_voxels(trunk, grid))
    lost, kept = (float(evidence(hull).evidence([state()])[0]) for hull in (empty, torn))
    assert kept > lost + 50.0
    assert evidence(torn).hides_legs
    fit = evidence(torn).fit(state())
    assert not fit.observed[[ANKLE, LANDMARKS.index("left_knee")]].any()
    assert fit.unseen_std[ANKLE] > 0.1


def test_legs_that_lie_in_each_other_are_not_observed_among_furniture() -> None:
    names = list(FLESH.body.layout.names)
    left, right = (LANDMARKS.index(f"{side}_ankle") for side in ("left", "right"))

    def together(turn: float) -> np.ndarray:
        found = state()
        found[names.index("left_hip_x")], found[names.index("right_hip_x")] = turn, -turn
        return found

    def gap(pose: np.ndarray) -> float:
        ankles = landmarks_of(FLESH.body, pose[None])[0]
        return float(np.linalg.norm(ankles[left] - ankles[right]))

    pose = min((together(turn) for turn in np.linspace(-0.3, 0.3, 61)), key=gap)
    assert gap(pose) < 0.03
    hull = FLESH.hull(pose, margin_m=VOXEL_M)
    for is_among_things in (False, True):
        observed = evidence(replace(hull, is_among_things=is_among_things)).fit(pose).observed
        is_seen = not is_among_things
        assert observed[[left, right]].tolist() == [is_seen, is_seen]
        assert observed[LANDMARKS.index("head")]
    apart = evidence(replace(FLESH.hull(state(), margin_m=VOXEL_M), is_among_things=True))
    assert apart.fit(state()).observed[[left, right]].all()


def test_of_somebody_cut_off_below_the_knees_knees_are_observed_and_ankles_are_not() -> None:
    """Most of a shank may be seen without its end."""
    whole = FLESH.hull(state(), margin_m=VOXEL_M)
    places = landmarks_of(FLESH.body, state()[None])[0]
    ankle, knee = (places[LANDMARKS.index(f"right_{name}"), 2] for name in ("ankle", "knee"))
    kept = whole.voxels[FLESH.grid.centers(whole.voxels)[:, 2] > ankle + 0.3 * (knee - ankle)]
    cut = evidence(PersonHull(kept, surface_voxels(kept, FLESH.grid)))
    shank = FLESH.body.landmark_parts[ANKLE]
    assert cut.part_scores(state()).occupied[0][shank] > 0.5
    unseen = {LANDMARKS[m] for m in np.flatnonzero(~cut.fit(state()).observed)}
    assert unseen == {"left_ankle", "right_ankle"}
    assert evidence(whole).fit(state()).observed.all()


def test_unknown_voxels_are_marked_in_the_crop_and_nowhere_else() -> None:
    hull = without_shank(is_unknown=True)
    plain = pack_volume(FLESH.grid, replace(hull, unknown=hull.unknown[:0]), 1.0)
    far = FLESH.grid.linear(np.array([[0, 0, 0]]))
    marked = pack_volume(
        FLESH.grid, replace(hull, unknown=np.union1d(hull.unknown, far).astype(np.int32)), 1.0
    )
    inside = np.argwhere(marked.crop != plain.crop) + marked.lower_subscript
    np.testing.assert_array_equal(FLESH.grid.linear(inside), hull.unknown)
    assert np.all(marked.crop[marked.crop != plain.crop] >= 128 + 64)


def test_no_surface_where_the_unknown_begins() -> None:
    grid = VoxelGrid(np.zeros(3), (5, 6, 7), 0.1)
    box = np.array([[x, y, z] for x in range(1, 4) for y in range(1, 4) for z in range(1, 6)])
    voxels = grid.linear(box[box[:, 2] < 4])
    unknown = grid.linear(box[box[:, 2] >= 4])
    np.testing.assert_array_equal(surface_voxels(voxels, grid, unknown[:0]), surface_voxels(voxels, grid))
    is_surface = surface_voxels(voxels, grid, unknown)
    top_middle = grid.linear(np.array([[2, 2, 3]]))[0]
    assert not is_surface[np.searchsorted(voxels, top_middle)]
    assert surface_voxels(voxels, grid)[np.searchsorted(voxels, top_middle)]


def cut_at(upper_m: tuple[float, float, float]) -> tuple[PersonHull, VoxelGrid]:
    """The body's voxels in a room with another upper corner, m, and that room."""
    whole = FLESH.hull(state(), margin_m=VOXEL_M)
    n = np.floor((np.array(upper_m) - FLESH.grid.origin) / VOXEL_M).astype(int)
    room = VoxelGrid(FLESH.grid.origin, tuple(np.minimum(n, FLESH.grid.shape).tolist()), VOXEL_M)
    subs = FLESH.grid.subscripts(whole.voxels)
    voxels = np.sort(room.linear(subs[(subs < np.array(room.shape)).all(axis=1)]))
    return PersonHull(voxels, surface_voxels(voxels, room, beyond_is_empty=False)), room


@pytest.mark.parametrize("upper_m", [(9.0, 9.0, 1.2), (9.0, 0.05, 9.0)], ids=["ceiling", "wall"])
def test_who_reaches_out_of_the_room_goes_on_beyond(upper_m: tuple[float, float, float]) -> None:
    hull, room = cut_at(upper_m)
    assert room.at_walls(hull.voxels).any()
    tools = make_tools(room, 30.0, 1.74, "anthropometric", PoseConfig(), LikelihoodConfig(), 1)
    inside = room.is_below_ceiling(landmarks_of(FLESH.body, state()[None])[0])
    assert not inside.all()
    cut, seen_by_all = (
        tools.frame(hull),
        tools.frame(replace(hull, n_judges=lambda points: np.full(len(points), 7))),
    )
    for one in (cut, seen_by_all):
        np.testing.assert_array_equal(one.fit(state()).judged, inside)
    # Its parts beyond are neither empty nor surface: as good as within, but for the cut's own rim.
    away = state()
    away[:3] -= 0.1 * (np.array(upper_m) < 9.0)
    assert cut.evidence([state()])[0] > cut.evidence([away])[0]
    whole = evidence(FLESH.hull(state(), margin_m=VOXEL_M)).part_scores(state()).occupied[0]
    np.testing.assert_allclose(cut.part_scores(state()).occupied[0], whole, atol=0.02)


def test_the_room_goes_on_where_a_hull_reaches_its_walls_and_not_under_its_floor() -> None:
    room = VoxelGrid(np.zeros(3), (5, 5, 5), 0.1)
    full = np.arange(room.n_voxels, dtype=np.int32)
    corner = full[room.subscripts(full).max(axis=1) < 3]  # reaches the lower walls alone
    reach_m = EvidenceSettings.hidden_reach_m
    for voxels, upper_m in ((full, 0.5 + reach_m), (corner, 0.5)):
        volume = pack_volume(room, PersonHull(voxels, surface_voxels(voxels, room)), 1.0)
        np.testing.assert_allclose(volume.box.room_lower, [-reach_m, -reach_m, 0.0])
        np.testing.assert_allclose(volume.box.room_upper, [upper_m] * 3)
        x, y, z = (-volume.lower_subscript).tolist()
        assert (volume.crop[x : x + 5, y : y + 5, :z] < 128).all()
        assert (volume.crop[1:x, 1:-1, z:-1] >= 128 + 64).all()


def test_no_surface_where_the_room_ends() -> None:
    room = VoxelGrid(np.zeros(3), (5, 5, 5), 0.1)
    full = np.arange(room.n_voxels, dtype=np.int32)
    assert surface_voxels(full, room).sum() == 5**3 - 3**3
    is_surface = surface_voxels(full, room, beyond_is_empty=False)
    np.testing.assert_array_equal(is_surface, room.subscripts(full)[:, 2] == 0)  # the floor is there
    np.testing.assert_array_equal(stored_hull(room, full, full[:0]).is_surface, is_surface)


@pytest.mark.parametrize(("n_cameras", "is_seen"), [(0, False), (1, False), (2, True)])
def test_a_landmark_is_observed_only_when_two_cameras_can_judge_it(n_cameras: int, is_seen: bool) -> None:
    low = landmarks_of(FLESH.body, state()[None])[0, ANKLE, 2] + 0.05

    def n_judges(points: np.ndarray) -> np.ndarray:
        return np.where(points[:, 2] < low, n_cameras, 4)

    fit = evidence(replace(FLESH.hull(state(), margin_m=VOXEL_M), n_judges=n_judges)).fit(state())
    assert fit.judged[ANKLE] == fit.observed[ANKLE] == is_seen
    above = landmarks_of(FLESH.body, state()[None])[0, :, 2] >= low
    assert fit.judged[above].all()
    assert fit.observed[above].all()


def test_hidden_landmarks_are_named_with_their_frames() -> None:
    states = np.tile(neutral_state(BODY), (3, 1))
    hidden = np.zeros((3, len(LANDMARKS)))
    hidden[1:, ANKLE] = 0.1, 0.25

    def told(series: FrameSeries) -> list[str]:
        return warnings_of_volumes(
            4,
            n_blind=0,
            series=series,
            frames=np.array([20, 21, 22]),
            height=HeightEstimate(1.7, True),
            is_facing_open=False,
            crowded_share=0.4,
        )

    seen = np.ones((3, len(LANDMARKS)), dtype=np.bool_)
    assert told(series_of(states, observed=seen)) == []
    (warning,) = told(series_of(states, observed=seen, hidden_std=hidden))
    assert warning.startswith(
        "person 4: right_ankle are hidden from all cameras or all but one, outside their pictures or the room, or lost "
        "from masks so that the volume hangs in the air, in frames 21-22:"
    )
    (warning,) = told(series_of(states, observed=seen, hidden_std=hidden, doubtful=hidden > 0))
    assert warning.startswith("person 4: right_ankle may be elsewhere in frames 21-22:")


def test_hidden_landmarks_have_larger_deviations() -> None:
    states = np.tile(neutral_state(BODY), (3, 1))
    hidden = np.zeros((3, len(LANDMARKS)))
    hidden[1:, ANKLE] = 0.1, 0.25
    plain = landmark_covariances(BODY, series_of(states), DeviationSettings())
    wider = landmark_covariances(BODY, series_of(states, hidden_std=hidden), DeviationSettings())
    np.testing.assert_allclose(wider - plain, (hidden**2)[..., None, None] * np.eye(3), atol=1e-12)
