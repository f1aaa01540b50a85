"""The tracking stage on hulls of boxes: owners, persons who return, coarser voxels, and what is stored."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from marker_world import ring

from mocap.data import Tracks, VoxelGrid
from mocap.errors import MocapError
from mocap.io.store import StageStore
from mocap.pipeline.config import load_config
from mocap.pipeline.stage import Job
from mocap.pipeline.stages.track import TRACK, sides_between, track_report
from mocap.pipeline.tracking import every_frame, tracker_settings
from mocap.pipeline.walk import run_stage
from mocap.products.tracks import stored_tracks, track_row
from mocap.tracking import track_step
from mocap.volume import surface_voxels

GRID = VoxelGrid(np.array([-1.5, -1.0, 0.0]), (60, 40, 36), 0.05)
RED, BLUE = (200, 40, 30), (30, 50, 190)
FPS = 10.0
RIG = ring(4)
ENTRY = [[(x, 0.0, RED)] for x in np.linspace(-1.4, 0.4, 14)]
CLIP = ENTRY + ENTRY[::-1] + [[]] * 20 + ENTRY


def hull(people):
    """Voxels and colours of upright boxes of 30 x 30 x 170 cm."""
    centers = GRID.centers(np.arange(GRID.n_voxels, dtype=np.int32))
    rgb = np.zeros((GRID.n_voxels, 3), dtype=np.uint8)
    full = np.zeros(GRID.n_voxels, dtype=bool)
    for x, y, colour in people:
        mine = (np.abs(centers[:, 0] - x) < 0.16) & (np.abs(centers[:, 1] - y) < 0.16) & (centers[:, 2] < 1.7)
        full |= mine
        rgb[mine] = colour
    return np.flatnonzero(full).astype(np.int32), rgb[full]


@pytest.fixture
def stage(tmp_path):
    """Runs the stage on a clip: (tracks, owners of every frame, store)."""

    def run(clip, *settings, seed=0):
        store = StageStore(tmp_path / f"store-{len(list(tmp_path.iterdir()))}.zarr")
        attrs = {
            "origin_m": GRID.origin.tolist(),
            "shape": list(GRID.shape),
            "voxel_size_m": GRID.voxel_size_m,
        }
        with store.writer("carve", "k", attrs) as out:
            for frame, people in enumerate(clip):
                voxels, rgb = hull(people)
                is_surface = surface_voxels(voxels, GRID)
                out.append(
                    frame, voxels=voxels, is_surface=is_surface, n_views=is_surface.astype(np.uint8), rgb=rgb
                )
        session = SimpleNamespace(frames=range(len(clip)), fps=FPS, has_empty_scene=True, rig=RIG)
        config = load_config(settings=settings)
        run_stage(TRACK, Job(session, config, store, "k", seed=seed))
        tracks = stored_tracks(store, FPS)
        owners = {f: arrays["owner"] for f, arrays in store.reader("track-owners")}
        return tracks, owners, store

    return run


@pytest.mark.parametrize("tracker", ["naive", "particle", "sparse"])
def test_owner_of_a_person_who_returns_is_his_number_from_the_first_frame_on(stage, tracker):
    """He is recognised some frames after he came in; poses need the owner of those frames as well."""
    tracks, owners, _ = stage(CLIP, f"tracking.tracker={tracker}", "tracking.lost_frames=5")
    assert tracks.persons == (1,)
    assert tracks.frame[tracks.frame >= 30].min() == 48
    for frame in tracks.frame:
        assert set(np.unique(owners[frame])) == {1}
    assert list(owners) == list(range(len(CLIP)))


def test_without_recognition_he_is_somebody_else(stage):
    tracks, owners, _ = stage(CLIP, "tracking.reid_s=0", "tracking.lost_frames=5")
    assert tracks.persons == (1, 2)
    assert set(np.unique(owners[len(CLIP) - 1])) == {2}


@pytest.mark.parametrize("size", [0.05, 0.1, 0.15])
def test_every_fine_voxel_has_its_owner_on_coarser_voxels(stage, size):
    clip = [[(-0.8 + 0.02 * i, -0.4, RED), (0.8, 0.4, BLUE)] for i in range(8)]
    tracks, owners, _ = stage(clip, f"tracking.voxel_size_m={size}")
    assert tracks.persons == (1, 2)
    for frame, people in enumerate(clip):
        x = GRID.centers(hull(people)[0])[:, 0]
        numbers = [set(owners[frame][side].tolist()) for side in (x < 0, x > 0)]
        assert sorted(len(n) for n in numbers) == [1, 1]
        assert set.union(*numbers) == {1, 2}


def test_finer_voxels_than_the_volume_are_refused(stage):
    with pytest.raises(MocapError, match=r"tracking\.voxel_size_m is 0\.02"):
        stage(ENTRY[:3], "tracking.voxel_size_m=0.02")


def test_tracks_are_read_as_they_were_written(tmp_path):
    rng = np.random.default_rng(5)
    frame = np.array([3, 3, 4, 6])
    tracks = Tracks(
        frame,
        np.array([1, 2, 1, 2]),
        frame / FPS,
        rng.normal(size=(4, 3)),
        rng.normal(size=(4, 3, 3)),
        np.array([True, True, False, True]),
    )
    store = StageStore(tmp_path / "store.zarr")
    with store.writer("track", "k", {}) as out:
        for f in range(3, 7):
            out.append(f, **track_row(tracks, f))
    read = stored_tracks(store, FPS)
    for name in ("frame", "person", "time_s", "xyz", "covariance", "observed"):
        np.testing.assert_array_equal(getattr(read, name), getattr(tracks, name), err_msg=name)


def test_who_is_not_seen_for_two_frames_is_not_observed_in_them(stage):
    tracks, _, _ = stage([*ENTRY[8:], [], [], *ENTRY[8:][::-1]])
    assert np.count_nonzero(~tracks.observed) == 2


def test_tracks_without_covariance_are_read_as_well(stage):
    """The marker pipeline stores positions alone."""
    _, _, store = stage(ENTRY[:3])
    with store.writer("track", "k2", {}) as out:
        out.append(0, person=np.zeros(0, dtype=np.int64), xyz=np.zeros((0, 3)))
        out.append(1, person=np.array([1]), xyz=np.array([[0.1, 0.2, 0.9]]))
    tracks = stored_tracks(store, FPS)
    assert (tracks.covariance, tracks.observed, tracks.std) == (None, None, None)
    assert tracks.frame.tolist() == [1]


def test_expected_persons_and_published_reach_the_tracker():
    config = load_config(
        settings=("tracking.expected_persons=3", "tracking.tracker=sparse", "tracking.published=true")
    )
    s = tracker_settings(config.tracking, GRID, FPS, 100)
    assert (s.expected_persons, s.tracker, s.estimate, s.motion) == (3, "sparse", "filter", "none")
    assert (s.fps, s.voxel_size_m, s.confirm_frames) == (FPS, 0.05, 3)
    plain = tracker_settings(load_config().tracking, GRID, FPS, 4)
    assert (plain.tracker, plain.estimate, plain.confirm_frames) == ("naive", "voxels", 2)
    assert plain.lying_frames is None
    known = tracker_settings(load_config().tracking, GRID, FPS, 100, is_room_known=True)
    assert known.lying_frames == round(2 * FPS)
    assert tracker_settings(load_config().tracking, GRID, FPS, 12, is_room_known=True).lying_frames == 6


def test_the_tracker_knows_the_cameras(stage, monkeypatch):
    asked = []

    def step(state, voxels, settings, *, rng):
        asked.append(settings)
        return track_step(state, voxels, settings, rng=rng)

    monkeypatch.setattr("mocap.pipeline.stages.track.track_step", step)
    stage(CLIP[:2])
    assert [settings.rig for settings in asked] == [RIG] * 2
    config = load_config(settings=("tracking.published=true",))
    assert tracker_settings(config.tracking, GRID, FPS, 100, rig=RIG).rig is None


def test_nobody_in_the_room(stage):
    tracks, owners, store = stage([[]] * 5)
    assert len(tracks) == 0
    assert len(stored_tracks(store, FPS)) == 0
    assert all(len(o) == 0 for o in owners.values())


def test_same_seed_same_owners(stage):
    clip = [[(-0.3, 0.0, RED), (0.02 * i, 0.1, BLUE)] for i in range(8)]
    settings = ("tracking.tracker=sparse", "tracking.published=true")
    a, b, c = (stage(clip, *settings, seed=seed)[0] for seed in (4, 4, 5))
    np.testing.assert_array_equal(a.xyz, b.xyz)
    assert a.xyz.shape != c.xyz.shape or np.any(a.xyz != c.xyz)


def test_frames_of_an_absence_are_held_and_not_cut_out():
    frames, values = np.array([3, 4, 7]), np.arange(6.0).reshape(3, 2)
    whole = every_frame(frames, values)
    np.testing.assert_array_equal(whole[[0, 1, 4]], values)
    assert np.isnan(whole[2:4]).all()
    assert len(whole) == 5
    np.testing.assert_array_equal(every_frame(frames[:2], values[:2]), values[:2])
    assert every_frame(frames[:0], values[:0]).shape == (0, 2)


def test_who_reaches_through_a_wall_of_the_room_is_named(stage):
    """He goes from the middle to the wall at x = 1.5 and stays there for six of eleven frames."""
    clip = [[(x, 0.0, RED)] for x in (*np.linspace(0.9, 1.3, 5), *[1.4] * 6)]
    _, _, store = stage(clip)
    session = SimpleNamespace(frames=range(len(clip)), fps=FPS)
    (warning,) = track_report(Job(session, load_config(), store, "k")).warnings
    assert warning.startswith(
        "person 1: the volume ends at the border of the room (x = 1.50 m in 6 of 11 frames): what is beyond it is not"
    )
    assert "Remedy: a larger room, room_bounds_m in session.toml" in warning


def test_who_comes_in_through_a_wall_is_not(stage):
    clip = [[(x, 0.0, RED)] for x in (1.4, 1.4, *np.linspace(1.3, 0.3, 11))]
    _, _, store = stage(clip)
    session = SimpleNamespace(frames=range(len(clip)), fps=FPS)
    assert track_report(Job(session, load_config(), store, "k")).warnings == ()


@pytest.fixture
def warned(tmp_path):
    """What the stage says of stored places (P, 3) m, voxels and owners (N,) of each frame; persons are 1, 2, ..."""

    def warnings(frames):
        store = StageStore(tmp_path / "store.zarr")
        grid = {
            "origin_m": GRID.origin.tolist(),
            "shape": list(GRID.shape),
            "voxel_size_m": GRID.voxel_size_m,
        }
        with (
            store.writer("track", "k", {}) as tracks,
            store.writer("carve", "k", grid) as hulls,
            store.writer("track-owners", "k", {}) as owners,
        ):
            for frame, (places, voxels, owner) in enumerate(frames):
                tracks.append(frame, person=np.arange(len(places)) + 1, xyz=np.array(places))
                hulls.append(frame, voxels=np.array(voxels, dtype=np.int32))
                owners.append(frame, owner=np.array(owner, dtype=np.uint16))
        session = SimpleNamespace(frames=range(len(frames)), fps=FPS)
        return track_report(Job(session, load_config(), store, "k")).warnings

    return warnings


@pytest.mark.parametrize(
    ("gap_m", "n_after", "is_told"), [(0.5, 10, True), (1.1, 10, False), (0.5, 9, False)]
)
def test_who_is_lost_beside_somebody_is_named(warned, gap_m, n_after, is_told):
    """At 10 frames per second: two persons in five frames, and one of them in some more."""
    places = [[0.0, 0.0, 1.0], [gap_m, 0.0, 1.0]]
    warnings = warned([(places, [], [])] * 5 + [(places[:1], [], [])] * n_after)
    assert len(warnings) == is_told
    if is_told:
        assert warnings[0].startswith(
            "person 2 is followed up to frame 4 only, where he is beside person 1: unless he"
        )


def test_persons_who_touch_are_named_with_their_frames(warned):
    """A third one stands alone; what is nobody's between two does not join them."""
    places = [[x, 0.0, 1.0] for x in (-0.6, 0.0, 1.0)]

    def frame(gap_m, owner_between=0):
        centers = GRID.centers(np.arange(GRID.n_voxels, dtype=np.int32))
        owner = np.zeros(len(centers))
        x, is_body = centers[:, 0], (np.abs(centers[:, 1]) < 0.16) & (centers[:, 2] < 1.7)
        owner[is_body & (np.abs(x + 0.3) < 0.16)] = 1
        owner[is_body & (np.abs(x - gap_m) < 0.16)] = 2
        owner[is_body & (np.abs(x - 1.0) < 0.16)] = 3
        voxels = np.flatnonzero(owner + (is_body & (np.abs(x) < 0.3)))
        return places, voxels, owner[voxels]

    near, apart = frame(0.0), frame(0.15)
    (warning,) = warned([apart, near, near, apart, near])
    assert warning.startswith(
        "persons 1 and 2 are one volume in frames 1-2, 4: an arm that reaches over to the other"
    )


def test_sides_between_two_persons_are_counted_as_by_hand():
    rng = np.random.default_rng(3)
    grid = VoxelGrid(np.zeros(3), (9, 8, 7), 0.1)
    owner = rng.integers(0, 3, grid.n_voxels)
    one, other = (np.flatnonzero(owner == p).astype(np.int32) for p in (1, 2))
    subs = grid.subscripts(one)
    expected = 0
    for step in np.concatenate([np.eye(3, dtype=int), -np.eye(3, dtype=int)]):
        beside = subs + step
        inside = ((beside >= 0) & (beside < np.array(grid.shape))).all(axis=1)
        expected += np.isin(grid.linear(beside[inside]), other).sum()
    assert sides_between(one, other, grid) == sides_between(other, one, grid) == expected > 100
    assert sides_between(one[subs[:, 0] < 3], other[grid.subscripts(other)[:, 0] > 4], grid) == 0


def test_who_reaches_through_the_ceiling_is_named(warned):
    centers = GRID.centers(np.arange(GRID.n_voxels, dtype=np.int32))
    voxels = np.flatnonzero((np.abs(centers[:, :2]) < 0.1).all(axis=1))
    (warning,) = warned([([[0.0, 0.0, 1.0]], voxels, np.ones(len(voxels)))] * 4)
    assert warning.startswith(
        "person 1: the volume ends at the border of the room (z = 1.80 m in 4 of 4 frames)"
    )
